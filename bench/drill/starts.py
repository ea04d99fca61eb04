"""Starts in all orders, second ones, signals that ask for the end, terminals and pipes that go away."""

import itertools
import os
import pty
import random
import signal
import subprocess
import time

from rig import ROLES, demand, wait_until

BY_HAND = ("--rt", "off", "--trajectory", "hover")


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


def second_flight(make, n):
    """Starts a flight where one flies: it is turned away, and the first flies on."""
    with make(trials=n) as rig:
        flight = rig.take_off(duration=f"{n * 0.3 + 3:.0f}s")
        for _ in range(n):
            rig.run("fly", "--rt", "off", "--duration", "1s").expect(5).says("already has a running fly")
        demand(rig.end_completed(flight).result()["lost"] == "0", "messages are lost")
        rig.demand_nothing_left()
        for _ in range(n):
            yield {}


def second_role(make, n):
    """Starts each role where it flies already: it is turned away, and the flight goes on."""
    with make(trials=n) as rig:
        flight = rig.take_off(duration=f"{n * 0.3 + 3:.0f}s")
        for role in itertools.islice(itertools.cycle(ROLES), n):
            rig.run(role, "--rt", "off").expect(5).says(f"a running {role}")
        rig.end_completed(flight)
        rig.demand_nothing_left()
        for _ in range(n):
            yield {}


def two_instances(make, n):
    """Flies two instances side by side in lockstep: both are the flight that each is alone, to the bit."""
    for _ in range(n):
        with make() as left, make() as right:
            options = ("--pace", "lockstep", "--duration", "2s")
            flights = [rig.start("fly", *options) for rig in (left, right)]
            for flight in flights:
                flight.end().expect(0)
            said = [rig.run("replay", "--verify").expect(0).out.split("outputs ")[1].split()[0] for rig in (left, right)]
            alone = left.run("simulate", "--duration", "2s").expect(0).result()["outputs"]
            demand(said == [alone, alone], f"outputs {said}, alone {alone}")
            for rig in (left, right):
                rig.demand_nothing_left()
            yield {}


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


def asked_to_end(make, n, name, to="fly"):
    """Sends a signal that asks for the end at a random instant: a landing in order, with a report."""
    draw = random.Random(n)
    for _ in range(n):
        with make() as rig:
            flight = rig.take_off(duration="60s")
            time.sleep(draw.random() * 0.1)
            begin = time.monotonic()
            if to == "fly":
                flight.send(getattr(signal, name))
            else:
                rig.strike(to, getattr(signal, name))
            demand(flight.end().expect(130).result()["status"] == "INTERRUPTED", "not INTERRUPTED")
            rig.demand_nothing_left()
            yield {"s to the end": round(time.monotonic() - begin, 2)}


def deaf(make, n):
    """Starts a flight with signals blocked and ignored: it ends all the same when it is told to."""
    def block():
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM, signal.SIGINT, signal.SIGALRM, signal.SIGCHLD])
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    for number in itertools.islice(itertools.cycle([signal.SIGTERM, signal.SIGINT]), n):
        with make() as rig:
            flight = rig.take_off(duration="60s", preexec_fn=block)
            flight.send(number)
            flight.end().expect(130)
            rig.demand_nothing_left()
            yield {}


def closed_terminal(make, n):
    """Closes the terminal of a flight: it lands in order."""
    for _ in range(n):
        with make() as rig:
            child, terminal = pty.fork()
            if child == 0:
                os.chdir(rig.directory)
                command = rig.command("fly", "--rt", "off", "--duration", "60s")
                os.execve(command[0], command, rig.environment)
            rig.await_flight()
            os.close(terminal)
            begin = time.monotonic()
            wait_until("the flight to end", lambda: os.waitpid(child, os.WNOHANG)[0] == child, 30)
            rig.demand_nothing_left()
            demand(rig.report()["run"]["ending"].startswith("interrupted"), rig.report()["run"]["ending"])
            yield {"s to the end": round(time.monotonic() - begin, 2)}


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


ROWS = [
    {"name": "start.orders", "fault": "roles started by hand in all 120 orders", "injector": orders,
     "expected": "completed", "n": 120, "short": 2},
    {"name": "start.second_flight", "fault": "a second flight of the same instance", "injector": second_flight,
     "expected": "rejected with code 5; the first loses nothing", "n": 20, "short": 2},
    {"name": "start.second_role", "fault": "a second process of a role", "injector": second_role,
     "expected": "rejected with code 5; the flight continues", "n": 20, "short": 5},
    {"name": "start.two_instances", "fault": "two instances at the same time", "injector": two_instances,
     "expected": "bit-identical to each alone", "n": 10},
    {"name": "start.again", "fault": "launcher killed, another started after 0 to 3 s", "injector": again,
     "expected": "it works, or is rejected with code 5 and the next one works", "n": 35},
    {"name": "start.dead_plant", "fault": "a role started beside the blackboard of a dead plant",
     "injector": run_of_a_dead_plant, "expected": "waits for a live plant and flies with it", "n": 5,
     "guards": ("run_check",)},
    *({"name": f"end.{name.lower()}", "fault": f"{name} to the launcher", "injector": asked_to_end,
       "arguments": {"name": name}, "expected": "ends in order: INTERRUPTED, code 130, report", "n": 10,
       "short": int(name == "SIGTERM")} for name in ("SIGTERM", "SIGINT", "SIGHUP", "SIGQUIT")),
    *({"name": f"end.{role}", "fault": f"SIGTERM to {role}", "injector": asked_to_end,
       "arguments": {"name": "SIGTERM", "to": role}, "expected": "all end in order: INTERRUPTED", "n": 5,
       "short": int(role == "mixer")} for role in ROLES),
    {"name": "end.deaf", "fault": "started with signals blocked and ignored, then SIGTERM", "injector": deaf,
     "expected": "ends in order, code 130", "n": 10},
    {"name": "end.terminal", "fault": "terminal closed in flight", "injector": closed_terminal,
     "expected": "ends in order: interrupted", "n": 10},
    {"name": "end.streams", "fault": "standard streams full (/dev/full) or closed", "injector": streams,
     "expected": "completed and recorded", "n": 9, "short": 3},
    {"name": "end.pipe", "fault": "output into a pipe without a reader", "injector": pipe_without_reader,
     "expected": "completed and recorded", "n": 5},
]
