"""Processes that are killed, stopped, paused or stepped aside in flight."""

import os
import random
import signal
import time

from rig import ROLES, STAGES, demand, wait_until

RESTART = ("--on-death", "restart")
# Of each role one in 2.1 s: five in ten seconds are borne.
APART_S = 0.72
# Of one role: a board has 64 sheets, and a killed writer keeps its own.
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


def spares(make, n, number=signal.SIGKILL):
    """Strikes spares in turns while they wait: no death of the flight, another one waits; one that is stopped is not
    waited for by the stage that dies then."""
    left = n
    while left > 0:
        kills = min(left, KILLS_PER_FLIGHT)
        left -= kills
        with make(trials=kills) as rig:
            flight = rig.take_off(*RESTART, duration=f"{kills * 2.5 + 2.5:.1f}s")
            deaths = 0
            for kill in range(kills):
                begin = time.monotonic()
                role = STAGES[kill % len(STAGES)]
                spare = rig.await_spare(role)
                os.kill(spare, number)
                if number == signal.SIGSTOP:
                    dead = rig.strike(role)
                    demand(rig.await_pid(role, other_than=dead) != spare, "a stopped process has the place")
                    deaths += 1
                rig.await_spare(role, other_than=spare)
                time.sleep(max(0.0, begin + APART_S - time.monotonic()))
            flight.send(signal.SIGINT)
            flight.end().expect(130)
            found = rig.report()["deaths"]
            demand(len(found) == deaths, f"{deaths} deaths, {len(found)} in the report")
            rig.demand_nothing_left()
            for _ in range(kills):
                yield {}


def recorder(make, n):
    """Kills the recorder: the flight goes on, and another one records the rest."""
    draw = random.Random(n)
    for _ in range(n):
        with make() as rig:
            flight = rig.take_off(*RESTART, duration="3s")
            time.sleep(0.5 + draw.random() * 0.3)
            dead = rig.strike("record")
            rig.await_pid("record", other_than=dead)
            result = rig.end_completed(flight, 0).result()
            ticks = rig.report()["ticks"]
            demand(ticks["run"] + ticks["skipped"] == 3001, f"ticks: {ticks}")
            rig.demand_nothing_left()
            yield {"messages in no record": int(result["lost"])}


def ends_the_flight(make, n, role, number=signal.SIGKILL):
    """Strikes a process without which no flight goes on: the others land, nothing is left, the next one flies."""
    draw = random.Random(n)
    for _ in range(n):
        with make() as rig:
            flight = rig.take_off(*RESTART, duration="60s")
            # Parameters are in force from 200 ms before the first tick.
            time.sleep(0.5 + draw.random() * 0.3)
            begin = time.monotonic()
            if role == "fly":
                flight.send(number)
                flight.end()
            else:
                rig.strike(role, number)
                demand(flight.end().expect(1).result()["status"] == "ABORTED", "not ABORTED")
            rig.demand_nothing_left(10)
            took_s = time.monotonic() - begin
            rig.demand_next_flight()
            yield {"s to the end": round(took_s, 2)}


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


def while_starting(make, n, role):
    """Kills a role while all start: the launcher ends and names it, and the next flight flies."""
    draw = random.Random(n)
    for _ in range(n):
        with make() as rig:
            flight = rig.fly(duration="60s")
            pid = rig.await_pid(role)
            time.sleep(draw.random() * 0.02)
            os.kill(pid, signal.SIGKILL)
            name = "recorder" if role == "record" else f"{role} process"
            flight.end().expect(1).says(name)
            rig.demand_nothing_left()
            rig.demand_next_flight()
            yield {}


def while_landing(make, n, role):
    """Ends a flight and kills a role on its way down: everybody ends, and nothing is left."""
    draw = random.Random(n)
    for _ in range(n):
        with make() as rig:
            flight = rig.take_off(duration="60s")
            pid = rig.await_pid(role)
            flight.send(signal.SIGINT)
            time.sleep(draw.random() * 0.01)
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                pass
            begin = time.monotonic()
            flight.end(40).expect(1, 130)
            rig.demand_nothing_left()
            yield {"s to the end": round(time.monotonic() - begin, 2)}


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


def stopped_while_starting(make, n):
    """Stops the plant before the flight: the launcher says that it waits, and ends all when it is told to."""
    for _ in range(n):
        with make() as rig:
            flight = rig.fly(*RESTART, duration="60s")
            rig.strike("plant", signal.SIGSTOP)
            wait_until("the launcher to say that it waits", lambda: "still waiting" in flight.said(), 30)
            begin = time.monotonic()
            flight.send(signal.SIGTERM)
            flight.end(40).expect(1, 130)
            rig.demand_nothing_left()
            rig.demand_next_flight()
            yield {"s to the end": round(time.monotonic() - begin, 2)}


def not_needed(make, n, role):
    """Stops a process that the loops do not need, for 2 s: they do not notice, and nobody is killed."""
    for _ in range(n):
        with make() as rig:
            flight = rig.take_off(*RESTART, duration="4s")
            pid = flight.pid if role == "fly" else rig.await_pid(role)
            os.kill(pid, signal.SIGSTOP)
            time.sleep(2)
            os.kill(pid, signal.SIGCONT)
            result = rig.end_completed(flight).result()
            demand(not rig.report()["deaths"], f"killed: {rig.report()['deaths']}")
            demand(result["lost"] == "0", f"{result['lost']} messages lost")
            rig.demand_replay()
            rig.demand_nothing_left()
            yield {}


ROWS = [
    *({"name": f"kill.{role}", "fault": f"{role} killed in flight", "injector": in_a_row,
       "arguments": {"roles": role}, "expected": "restarted and joins; completed; replay identical or rejected for its gap",
       "n": 20, "short": 2} for role in STAGES),
    {"name": "kill.turns", "fault": "outer, inner and mixer killed in turn", "injector": in_a_row,
     "arguments": {"roles": "outer+inner+mixer"},
     "expected": "each restarted and joins; completed; replay identical or rejected for its gap", "n": 1000, "short": 6},
    {"name": "kill.spare", "fault": "a waiting hot standby killed", "injector": spares,
     "expected": "not counted as a failure; another standby waits", "n": 20, "short": 2},
    {"name": "hang.spare", "fault": "a standby stopped, then its stage killed", "injector": spares,
     "arguments": {"number": signal.SIGSTOP}, "expected": "a new process takes over; another standby waits",
     "n": 10},
    {"name": "kill.record", "fault": "recorder killed in flight", "injector": recorder,
     "expected": "flight continues; another recorder writes the rest", "n": 20},
    {"name": "kill.plant", "fault": "plant killed in flight", "injector": ends_the_flight,
     "arguments": {"role": "plant"}, "expected": "ABORTED, plant named; others end; next flight works", "n": 20},
    {"name": "kill.launcher", "fault": "launcher killed in flight", "injector": ends_the_flight,
     "arguments": {"role": "fly"}, "expected": "roles end and tidy up; next flight works", "n": 20},
    {"name": "kill.all.flying", "fault": "all killed in flight", "injector": everything,
     "arguments": {"latest_s": 2.0, "earliest_s": 0.8}, "expected": "next flight works without a clean",
     "n": 100, "short": 2},
    {"name": "kill.all.starting", "fault": "all killed during start", "injector": everything,
     "arguments": {"latest_s": 0.6}, "expected": "next flight works without a clean", "n": 100, "short": 3},
    *({"name": f"kill.{role}.starting", "fault": f"{role} killed during start", "injector": while_starting,
       "arguments": {"role": role}, "expected": "launcher ends and names it; next flight works", "n": 10,
       "short": int(role == "inner")} for role in ROLES),
    *({"name": f"kill.{role}.landing", "fault": f"{role} killed during the end", "injector": while_landing,
       "arguments": {"role": role}, "expected": "all end within 40 s", "n": 10,
       "short": int(role == "mixer")} for role in ROLES),
    {"name": "crash.loop", "fault": "a role crashes after each restart", "injector": crash_loop,
     "expected": "five restarts; the sixth failure ends the flight with the reason", "n": 5, "guards": ("restart_limit",)},
    *({"name": f"hang.{role}", "fault": f"{role} stopped", "injector": in_a_row,
       "arguments": {"roles": role, "number": signal.SIGSTOP},
       "expected": "detected as hung, killed, restarted; replay identical", "n": 10,
       "short": int(role == "inner"), "guards": ("heartbeat",) if role == "inner" else ()} for role in STAGES),
    {"name": "hang.plant", "fault": "plant stopped", "injector": ends_the_flight,
     "arguments": {"role": "plant", "number": signal.SIGSTOP}, "expected": "killed, ABORTED; others end; next flight works",
     "n": 5},
    {"name": "hang.plant.starting", "fault": "plant stopped during start", "injector": stopped_while_starting,
     "expected": "launcher says that it waits and for what; ends all on a signal; next flight works", "n": 5},
    {"name": "hang.record", "fault": "recorder stopped for 2 s", "injector": not_needed, "arguments": {"role": "record"},
     "expected": "completed, nothing lost or killed; replay identical", "n": 5},
    {"name": "hang.launcher", "fault": "launcher stopped for 2 s", "injector": not_needed, "arguments": {"role": "fly"},
     "expected": "completed, nothing lost or killed; replay identical", "n": 5},
    *({"name": f"pause.{role}", "fault": f"{role} stopped for 20 ms", "injector": pause,
       "arguments": {"role": role, "ms": 20}, "expected": "not killed; completed; replay identical", "n": 20,
       "short": 3} for role in (*STAGES, "plant", "record")),
    {"name": "pause.all", "fault": "all stopped for 200 ms", "injector": pause,
     "arguments": {"role": "all", "ms": 200}, "expected": "none detected as hung; completed; replay identical",
     "n": 10, "short": 2},
]
