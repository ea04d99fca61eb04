"""Messages that are lost, late, wrong, forged or damaged; floods of requests; observers that crash or never read."""

import csv
import io
import itertools
import json
import random
import signal
import time

import flip
from rig import demand

TOPICS = {"state": "position_w_m", "setpoint": "thrust_n", "wrench": "thrust_n", "rotor_speeds": "speed_rad_s"}
LOCKSTEP = ("--pace", "lockstep", "--duration", "3s", "--trajectory", "hover")
FRESH, HELD, FALLBACK, IDLE = "0", "1", "2", "3"


def forged(make, n, kind):
    """Bad messages into slots in use of all four topics, from a process that holds the publisher (`forge`)."""
    with make(trials=n) as rig:
        rig.root.mkdir()
        command = [rig.executable_of("forge"), kind, str(n), str(rig.root)]
        ended = rig.launch(command).end(600).expect(0)
        lines = [json.loads(line) for line in ended.out.splitlines()]
        demand(len(lines) == 4, f"{len(lines)} topics")
        for line in lines:
            counted = line["rejected"][line["reason"]]
            demand(line["accepted"] == 0, f"{line['topic']}: {line['accepted']} of {line['offered']} accepted")
            demand(counted == line["offered"], f"{line['topic']}: {counted} of {line['offered']} refused as {line['reason']}")
            demand(line["good"] == line["sent_good"], f"{line['topic']}: good messages lost: {line}")
        for line in lines:
            yield {"_times": line["offered"], "accepted": line["accepted"]}


def exported(rig, topic):
    return csv.DictReader(io.StringIO(rig.run("export", "--topic", topic).expect(0).out))


def modes(rig, topic):
    return [row["mode"] for row in exported(rig, topic)]


def missing(make, n, topic):
    """Takes all messages of a topic away for 1.5 s: held, then the fallback, then idle, each when it is due."""
    shown, due = {
        # Which topic shows it, and the mode after so many ticks without.
        "state": ("wrench", {50: (HELD,), 500: (FALLBACK,), 1100: (IDLE,)}),
        "setpoint": ("wrench", {50: (HELD,), 150: (FALLBACK,)}),
        "wrench": ("rotor_speeds", {2: (HELD,), 10: (FALLBACK,), 1100: (IDLE,)}),
    }[topic]
    for _ in range(n):
        with make() as rig:
            sky = rig.settings("[flight]\nground_z_m = -100.0\n")
            rig.end_completed(rig.start("fly", *LOCKSTEP, "--config", sky, "--fault", f"{topic}.drop=1@tick1000..tick2500"))
            said = modes(rig, shown)
            for ticks, expected in due.items():
                mode = said[1000 + ticks]
                demand(mode in expected, f"{shown} is in mode {mode} after {ticks} ticks without {topic}, not {expected}")
            demand(said[2600] in (FRESH, HELD), f"mode {said[2600]} 100 ticks after the end of it")
            rig.demand_nothing_left()
            yield {}


def flipped(make, n):
    """Flips bits in the slots of a flight in the air, from outside, while they are in use; at least n reach a port."""
    caught = 0
    while caught < n:
        with make() as rig:
            flight = rig.take_off(duration="14s")
            flips = flip.flip(rig, seconds=8.0, every_s=0.01)
            rig.end_completed(flight)
            report = rig.report()
            roles = {**report["roles"], "record": report["recorder"]}
            counts = {role: said["rejected"] for role, said in roles.items()}
            found = sum(count["checksum"] for count in counts.values())
            other = sum(sum(count.values()) for count in counts.values()) - found
            demand(flips > 0 and found > 0, f"{flips} bits flipped, {found} noticed")
            demand(other == 0, f"refused for another reason than the check word: {counts}")
            strange = carried_on(rig)
            demand(strange == 0, f"{strange} messages carry on what was flipped")
            rig.demand_nothing_left()
            caught += found
            yield {"_times": found, "flips": flips, "carried on": strange}


def carried_on(rig):
    """Messages whose envelope says what no undamaged one of a flight without swaps does."""
    count = 0
    for topic in TOPICS:
        epochs = [int(row["envelope.parameter_epoch"]) for row in exported(rig, topic)]
        demand(len(epochs) > 1000, f"{len(epochs)} messages of {topic} in the export")
        count += sum(epoch != 0 for epoch in epochs)
    return count


def flood(make, n):
    """Eight clients swap a parameter as fast as they can: each is answered, and the flight flies on."""
    with make(trials=n) as rig:
        flight = rig.take_off(duration=f"{3 + n / 40:.0f}s")
        for _ in range(0, n, 8):
            clients = [rig.start("inject", f"mass_kg={0.50 + i / 100}") for i in range(8)]
            for client in clients:
                client.end().expect(0)
        rig.end_completed(flight)
        rig.demand_nothing_left()
        for _ in range(n):
            yield {}


def killed_clients(make, n):
    """Kills clients at a random instant of their request: the flight flies on, and the next client is answered."""
    draw = random.Random(n)
    with make(trials=n) as rig:
        flight = rig.take_off(duration=f"{3 + n / 10:.0f}s")
        for _ in range(n):
            client = rig.start("inject", "mass_kg=0.53")
            time.sleep(draw.random() * 0.06)
            client.send(signal.SIGKILL)
            client.end()
        rig.run("inject", "mass_kg=0.52").expect(0)
        rig.end_completed(flight)
        rig.demand_nothing_left()
        for _ in range(n):
            yield {}


def observers(make, n, number):
    """Observers that are killed, or stopped and never read, a dozen one after the other: the flight does not notice."""
    with make(trials=n) as rig:
        flight = rig.take_off(duration=f"{3 + n * 0.5:.0f}s")
        stopped = []
        for i in range(n):
            watcher = rig.start("watch")
            time.sleep(0.3)
            demand(watcher.is_running(), f"watch has ended: {watcher.said()[-200:]}")
            watcher.send(number)
            stopped.append(watcher)
            if number == signal.SIGKILL or i % 3 == 2:
                for watcher in stopped:
                    watcher.send(signal.SIGKILL)
                    watcher.end()
                stopped = []
        result = rig.end_completed(flight).result()
        demand(result["lost"] == "0", f"lost: {result}")
        for watcher in stopped:
            watcher.send(signal.SIGKILL)
            watcher.end()
        rig.demand_replay()
        rig.run("clean").expect(0)
        rig.demand_nothing_left()
        for _ in range(n):
            yield {}


KINDS = {
    "flipped_bit": ("one flipped bit", "checksum"), "garbage": ("up to 64 bytes of garbage", "checksum"),
    "other_layout": ("from another build", "layout"), "other_run": ("from another run", "run"),
    "other_settings": ("from other settings", "settings"), "repeated": ("a repeated message", "sequence"),
    "old_sequence": ("an old sequence number", "sequence"), "replaced_sender": ("from a replaced sender", "sequence"),
    "future_tick": ("from a future tick", "tick"), "past_tick": ("from a past tick", "tick"),
    "not_finite": ("NaN or infinity in a field", "non_finite"),
    "implausible": ("an implausible number in a field", "implausible"),
}

ROWS = [
    *({"name": f"forged.{kind}", "fault": words, "injector": forged, "arguments": {"kind": kind},
       "expected": f"none accepted; counted as `{reason}`; all good ones pass", "n": 1_000_000, "short": 20_000,
       "guards": (f"inspection.{reason}",)} for kind, (words, reason) in KINDS.items()),
    {"name": "flipped.live", "fault": "bits flipped in used slots of live shared memory", "injector": flipped,
     "expected": "counted as `checksum`, never used; completed", "n": 5000, "short": 20,
     "guards": ("inspection.checksum",)},
    *({"name": f"missing.{topic}", "fault": f"no `{topic}` for 1.5 s", "injector": missing,
       "arguments": {"topic": topic}, "expected": "held, fallback, idle, each in time; flight resumes",
       "n": 3, "guards": ("stale_windows",)} for topic in ("state", "setpoint", "wrench")),
    {"name": "flood.inject", "fault": "eight clients change parameters without pause", "injector": flood,
     "expected": "each answered; completed", "n": 400, "short": 16},
    {"name": "kill.inject", "fault": "clients killed during their request", "injector": killed_clients,
     "expected": "completed; next client answered", "n": 50, "short": 5},
    {"name": "kill.watch", "fault": "observers killed", "injector": observers, "arguments": {"number": signal.SIGKILL},
     "expected": "nothing lost; completed; replay identical", "n": 20, "short": 2},
    {"name": "stop.watch", "fault": "observers that never read", "injector": observers,
     "arguments": {"number": signal.SIGSTOP}, "expected": "nothing lost; completed; replay identical", "n": 12,
     "short": 2},
]
