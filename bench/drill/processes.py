"""Processes that are killed, stopped and started again, in numbers and combinations that the fault matrix does not have."""

import itertools
import os
import random
import signal
import subprocess
import time

from rig import ROLES, demand, wait_until

RESTART = ("--on-death", "restart")
BY_HAND = ("--rt", "off", "--trajectory", "hover")
# Of each role one in 2.1 s: five in ten seconds are restarted.
APART_S = 0.72
# Of one role: a blackboard has 64 slots, and a killed writer keeps its own.
KILLS_PER_FLIGHT = 40


def cost(death):
    return {"ticks lost": death["ticks_lost"], "ms back": round(death["back_after_ms"], 1),
            "ms noticed": round(death["noticed_after_ms"], 1), "m error": round(death["position_error_max_m"], 3)}


def in_a_row(make, n, roles, number=signal.SIGKILL):
    """Strikes roles in turns at random instants of one flight; each must come back, and the flight be replayed."""
    draw = random.Random(n)
    roles = roles.split("+")
    apart_s = max(APART_S, 2.15 / len(roles))
    while n > 0:
        kills = min(n, KILLS_PER_FLIGHT * len(roles))
        n -= kills
        with make(trials=kills) as rig:
            flight = rig.take_off(*RESTART, duration=f"{kills * apart_s + 2.5:.1f}s")
            begin = time.monotonic() + 0.3
            for kill in range(kills):
                time.sleep(max(0.0, begin + kill * apart_s + draw.random() * 0.05 - time.monotonic()))
                role = roles[kill % len(roles)]
                dead = rig.strike(role, number)
                rig.await_pid(role, other_than=dead)
            ended = rig.end_completed(flight)
            rig.demand_nothing_left()
            found = rig.report()["deaths"]
            demand(len(found) == kills, f"{kills} deaths, {len(found)} in the report: {ended}")
            for death in found:
                demand(death["back_after_ms"] is not None, f"not back: {death}")
            gaps = rig.replay_or_gap(found)
            for death in found:
                yield cost(death)
            yield {"_times": 0, "replay refused for a gap": gaps}


def everything(make, n, latest_s, earliest_s=0.0):
    """Kills all processes of a flight at once, at a random instant after its start: the next one flies, uncleaned."""
    draw = random.Random(n)
    with make() as rig:
        for _ in range(n):
            rig.fly(duration="60s")
            time.sleep(earliest_s + draw.random() * (latest_s - earliest_s))
            for pid in rig.processes():
                try:
                    os.kill(pid, signal.SIGKILL)
                except ProcessLookupError:
                    pass
            wait_until("killed processes to go", lambda: not rig.processes(), 10)
            begin = time.monotonic()
            rig.demand_next_flight()
            yield {"s next flight": round(time.monotonic() - begin, 2)}


def crash_loop(make, n):
    """Kills a role as often as it comes back: the sixth death within ten seconds ends the flight."""
    for _ in range(n):
        with make() as rig:
            flight = rig.take_off(*RESTART, duration="20s")
            dead, kills = None, 0
            while flight.is_running() and kills < 9:
                pid = rig.pid("inner")
                if pid and pid != dead:
                    time.sleep(0.25)
                    if flight.is_running():
                        os.kill(pid, signal.SIGKILL)
                        dead, kills = pid, kills + 1
                time.sleep(0.01)
            flight.end(30).expect(1).says("it has been started again 5 times within 10 s, which is the most")
            demand(kills == 6, f"{kills} kills")
            rig.demand_nothing_left()
            yield {"deaths": kills}


def pause(make, n, role, ms):
    """Stops a role for a while: it goes on where the clock is, is not killed, and sends no burst."""
    draw = random.Random(n)
    with make(trials=n) as rig:
        flight = rig.take_off(*RESTART, duration=f"{n * 0.4 + 2:.1f}s")
        for _ in range(n):
            time.sleep(0.3 + draw.random() * 0.02)
            pids = [rig.strike(each, signal.SIGSTOP) for each in (ROLES if role == "all" else (role,))]
            if role == "all":
                # The launcher first goes last, as where a machine stands still.
                flight.send(signal.SIGSTOP)
            time.sleep(int(ms) / 1e3)
            for pid in pids:
                os.kill(pid, signal.SIGCONT)
            flight.send(signal.SIGCONT)
        rig.end_completed(flight)
        report = rig.report()
        demand(not report["deaths"], f"killed: {report['deaths']}")
        rig.demand_replay()
        rig.demand_nothing_left()
        skipped = sum(said["ticks_skipped"] for said in report["roles"].values())
        for _ in range(n):
            yield {"ticks skipped in all": skipped} if role != "record" else {}


def orders(make, n):
    """Starts the five roles by hand, in the orders that there are, one after the other: each flies."""
    every = list(itertools.permutations(ROLES))
    random.Random(1).shuffle(every)
    for order in itertools.islice(itertools.cycle(every), n):
        with make() as rig:
            begin = time.monotonic()
            started = [rig.start(role, *BY_HAND, "--duration", "300ms") for role in order]
            for role, process in zip(order, started):
                process.end().expect(0)
            rig.demand_nothing_left()
            yield {"s whole flight": round(time.monotonic() - begin, 2)}


def run_of_a_dead_plant(make, n):
    """Kills plant and inner of a flight by hand and starts an inner: it waits for a plant that lives, and flies with it."""
    for _ in range(n):
        with make() as rig:
            config = rig.settings("[flight]\nslowdown = 5\n")
            options = (*BY_HAND, "--config", config, "--duration", "2s")
            first = {role: rig.start(role, *options) for role in ROLES}
            rig.await_flight()
            for role in ("plant", "inner"):
                first[role].send(signal.SIGKILL)
                first[role].end()
            inner = rig.start("inner", *options)
            for role in ("outer", "mixer", "record"):
                first[role].end(20)
            demand(inner.is_running(), f"the new inner has ended: {inner.said()[-200:]}")
            crew = [rig.start(role, *options) for role in ("outer", "mixer", "record", "plant")]
            for process in (inner, *crew):
                process.end().expect(0)
            rig.demand_nothing_left()
            yield {}


def again(make, n):
    """Kills a launcher in flight and starts another flight after 0 to 3 s: it flies, or says who is in its place."""
    for i in range(n):
        with make() as rig:
            flight = rig.take_off(duration="60s")
            flight.send(signal.SIGKILL)
            flight.end()
            time.sleep((0.0, 0.02, 0.05, 0.1, 0.3, 1.0, 3.0)[i % 7])
            ended = rig.run("fly", "--rt", "off", "--pace", "lockstep", "--duration", "50ms").expect(0, 5)
            demand(ended.code == 0 or "already has a running" in ended.err, f"{ended}")
            rig.demand_nothing_left()
            rig.demand_next_flight()
            yield {"turned away": int(ended.code == 5)}


def streams(make, n):
    """Flies with standard output full, standard error full, and both closed: the flight is flown and recorded."""
    kinds = [{"stdout": "/dev/full"}, {"stderr": "/dev/full"}, {"preexec_fn": lambda: (os.close(1), os.close(2))}]
    for options in itertools.islice(itertools.cycle(kinds), n):
        with make() as rig:
            rig.fly(duration="500ms", **options).end().expect(0, 1, 3)
            demand(rig.report()["run"]["ending"] == "completed", rig.report()["run"]["ending"])
            rig.demand_nothing_left()
            yield {}


def pipe_without_reader(make, n):
    """Closes the pipe that a flight prints to: the flight is flown and recorded."""
    for _ in range(n):
        with make() as rig:
            read, write = os.pipe()
            command = rig.command("fly", "--rt", "off", "--trajectory", "hover", "--duration", "500ms")
            child = subprocess.Popen(command, stdout=write, stderr=write, env=rig.environment, cwd=rig.directory)
            os.close(write), os.close(read)
            child.wait(60)
            demand(rig.report()["run"]["ending"] == "completed", rig.report()["run"]["ending"])
            rig.demand_nothing_left()
            yield {}


def tilted(make, n):
    """A rotor that gives a tenth of its thrust: the airframe tilts beyond its limit, and the flight ends and says so."""
    for _ in range(n):
        with make() as rig:
            limit = rig.settings("[flight]\nposition_error_max_m = 1000.0\ntilt_max_rad = 0.5\n")
            fault = ("--fault", "rotor_efficiency_1=0.1@1s", "--trajectory", "hover", "--pace", "lockstep")
            rig.start("fly", "--config", limit, *fault, "--duration", "5s").end().expect(3)
            ending = rig.report()["run"]["ending"]
            demand(ending == "left the envelope: tilt beyond its limit", ending)
            rig.demand_nothing_left()
            yield {}


ROWS = [
    {"name": "kill.turns", "fault": "outer, inner and mixer killed in turn", "injector": in_a_row,
     "arguments": {"roles": "outer+inner+mixer"},
     "expected": "each restarted and joins; completed; replay identical or rejected for its gap", "n": 1000, "short": 6},
    {"name": "kill.all.flying", "fault": "all killed in flight", "injector": everything,
     "arguments": {"latest_s": 2.0, "earliest_s": 0.8}, "expected": "next flight works without a clean",
     "n": 100, "short": 2},
    {"name": "kill.all.starting", "fault": "all killed during start", "injector": everything,
     "arguments": {"latest_s": 0.6}, "expected": "next flight works without a clean", "n": 100, "short": 3},
    {"name": "crash.loop", "fault": "a role crashes after each restart", "injector": crash_loop,
     "expected": "five restarts; the sixth failure ends the flight with the reason", "n": 5, "guards": ("restart_limit",)},
    {"name": "pause.all", "fault": "all stopped for 200 ms", "injector": pause,
     "arguments": {"role": "all", "ms": 200}, "expected": "none detected as hung; completed; replay identical",
     "n": 10, "short": 2},
    {"name": "start.orders", "fault": "roles started by hand in all 120 orders", "injector": orders,
     "expected": "completed", "n": 120, "short": 2},
    {"name": "start.again", "fault": "launcher killed, another started after 0 to 3 s", "injector": again,
     "expected": "it works, or is rejected with code 5 and the next one works", "n": 35},
    {"name": "start.dead_plant", "fault": "a role started beside the blackboard of a dead plant",
     "injector": run_of_a_dead_plant, "expected": "waits for a live plant and flies with it", "n": 5,
     "guards": ("run_check",)},
    {"name": "end.streams", "fault": "standard streams full (/dev/full) or closed", "injector": streams,
     "expected": "completed and recorded", "n": 9, "short": 3},
    {"name": "end.pipe", "fault": "output into a pipe without a reader", "injector": pipe_without_reader,
     "expected": "completed and recorded", "n": 5},
    {"name": "airframe.tilted", "fault": "a rotor with a tenth of its thrust", "injector": tilted,
     "expected": "the flight ends and names the envelope limit", "n": 5, "guards": ("envelope",)},
]
