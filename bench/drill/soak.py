"""One long flight with a fault every ten seconds: what grows of memory, files and descriptors."""

import itertools
import os
import random
import signal
import time
from pathlib import Path

import flip
from rig import ROLES, demand

EVERY_S = 10.0
# What starting and the first faults take is no growth.
WARM_UP = 0.2
STAY = ("plant", "record", "fly")


def kill(rig, role, number=signal.SIGKILL):
    dead = rig.strike(role, number)
    rig.await_pid(role, other_than=dead)


def pause(rig, role):
    pid = rig.strike(role, signal.SIGSTOP)
    time.sleep(0.01)
    try:
        os.kill(pid, signal.SIGCONT)
    except ProcessLookupError:
        demand(role != "plant", "the pause of the plant took so long that it was taken for a hang")


def swap(rig, clients=1):
    asked = [rig.start("inject", f"mass_kg={0.51 + i / 100}") for i in range(clients)]
    for client in asked:
        client.end().expect(0)


def client_killed(rig, *words):
    client = rig.start(*words)
    time.sleep(0.02 if words[0] == "inject" else 0.5)
    client.send(signal.SIGKILL)
    client.end()


def watch_stops(rig):
    client = rig.start("watch")
    time.sleep(0.3)
    client.send(signal.SIGSTOP)
    time.sleep(1)
    client.send(signal.SIGKILL)
    client.end()


FAULTS = [
    ("kill outer", lambda rig: kill(rig, "outer")),
    ("pause plant", lambda rig: pause(rig, "plant")),
    ("swap", swap),
    ("kill inner", lambda rig: kill(rig, "inner")),
    ("client killed", lambda rig: client_killed(rig, "inject", "mass_kg=0.53")),
    ("flip bits", lambda rig: flip.flip(rig, 1.0, 0.05)),
    ("kill mixer", lambda rig: kill(rig, "mixer")),
    ("pause record", lambda rig: pause(rig, "record")),
    ("watch killed", lambda rig: client_killed(rig, "watch")),
    ("eight clients", lambda rig: swap(rig, 8)),
    ("watch stopped", watch_stops),
    ("pause inner", lambda rig: pause(rig, "inner")),
    ("hang outer", lambda rig: kill(rig, "outer", signal.SIGSTOP)),
    ("pause outer", lambda rig: pause(rig, "outer")),
    ("pause mixer", lambda rig: pause(rig, "mixer")),
    ("swap back", lambda rig: swap(rig)),
    ("clean beside it", lambda rig: rig.run("clean").expect(0)),
    ("second flight", lambda rig: rig.run("fly", "--duration", "1s").expect(5)),
]


def look(rig, launcher):
    """What the flight holds now."""
    pids = {role: rig.pid(role) for role in ROLES} | {"fly": launcher}
    descriptors = memory = 0
    for role, pid in pids.items():
        try:
            descriptors += len(os.listdir(f"/proc/{pid}/fd"))
            if role in STAY:
                status = Path(f"/proc/{pid}/status").read_text()
                memory += int(status.split("RssAnon:")[1].split()[0])
        except (OSError, IndexError):
            return None
    segments = rig.segments()
    return {"own memory of plant, recorder and launcher [KiB]": memory, "descriptors": descriptors,
            "segments": len(segments), "shared memory [KiB]": sum(path.stat().st_blocks for path in segments) // 2,
            "files below the root": sum(1 for path in rig.root.rglob("*")),
            "files of the flight": sum(1 for path in rig.out.rglob("*")),
            "threads": sum(len(os.listdir(f"/proc/{pid}/task")) for pid in pids.values() if pid)}


def slope_per_hour(points):
    count = len(points)
    middle_x, middle_y = (sum(values) / count for values in zip(*points))
    spread = sum((x - middle_x) ** 2 for x, _ in points)
    return 3600 * sum((x - middle_x) * (y - middle_y) for x, y in points) / spread if spread else 0.0


def seconds(text):
    return float(text[:-1]) * {"s": 1, "m": 60, "h": 3600}[text[-1]]


def soak(make, duration):
    total_s, draw = seconds(duration), random.Random(7)
    if os.geteuid() == 0:
        # A pause that a busy machine makes longer than 80 ms is a hang, and a plant's hang the end of the flight.
        os.nice(-15)
    looks, done = [], {}
    with make() as rig:
        flight = rig.take_off("--on-death", "restart", "--log", "off", duration=f"{total_s:.0f}s",
                              preexec_fn=lambda: os.setpriority(os.PRIO_PROCESS, 0, 0))
        begin = time.monotonic()
        for number, (name, strike) in enumerate(itertools.cycle(FAULTS), 1):
            due = begin + number * EVERY_S + draw.random()
            if due + EVERY_S > begin + total_s:
                break
            time.sleep(max(0.0, due - time.monotonic()))
            seen = look(rig, flight.pid)
            if seen:
                looks.append((time.monotonic() - begin, seen))
            demand(flight.is_running(), f"the flight ended: {flight.said()[-500:]}")
            strike(rig)
            done[name] = done.get(name, 0) + 1
            # The files of clients that have ended are not the flight's.
            rig.started = [process for process in rig.started if process.is_running()]
        flight.end(120).expect(0, 3)
        report = rig.report()
        demand(report["run"]["ending"] == "completed", report["run"]["ending"])
        rig.demand_nothing_left()
        ticks = report["ticks"]
    warm = [(at, seen) for at, seen in looks if at >= WARM_UP * total_s]
    rows = ["| what | after warm-up | at the end | most | growth per hour |", "|---|---|---|---|---|"]
    growth = {}
    for what in warm[0][1]:
        series = [(at, seen[what]) for at, seen in warm]
        growth[what] = slope_per_hour(series)
        values = [value for _, value in series]
        rows.append(f"| {what} | {values[0]} | {values[-1]} | {max(values)} | {growth[what]:+.1f} |")
    faults = sum(done.values())
    text = (f"## One long flight\n\n`bench/drill/run --soak {duration}`: {ticks['run'] + ticks['skipped']} ticks, a fault every "
            f"{EVERY_S:.0f} s, {faults} in all of {len(done)} kinds, {len(report['deaths'])} deaths in the report, "
            f"{sum(1 for death in report['deaths'] if death['back_after_ms'] is None)} of them not back; completed, nothing left.\n"
            "The growth is the slope of a straight line through all looks after the first fifth.\n\n" + "\n".join(rows) + "\n")
    print(text)
    return {"text": text, "faults": done, "looks": [(round(at), seen) for at, seen in looks], "growth": growth, "failed": 0}
