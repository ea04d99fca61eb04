"""Long flights with a fault every ten seconds: what grows of memory, files and descriptors, and whether too much."""

import itertools
import os
import random
import signal
import statistics
import time
from pathlib import Path

import flip
from rig import ROLES, STAGES, NotBegun, Wrong, demand

EVERY_S = 10.0
STAY = {"plant": "plant", "record": "recorder", "fly": "launcher"}
# A board has 64 sheets, and a killed writer keeps its own: in this time a role is killed 54 times.
FLIGHT_S = 7200.0
# What may be more at the end of a flight than after its first round of faults: what rises in every round, and in all.
GROWTH_MOST = {"own memory of the plant [KiB]": (512, 2048), "own memory of the recorder [KiB]": (1024, 8192),
               "own memory of the launcher [KiB]": (512, 2048), "descriptors": (8, 16), "segments": (2, 4),
               "shared memory [KiB]": (256, 512), "files below the root": (8, 64), "files of the flight": (2, 4),
               "threads": (2, 2)}


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


HANGS = itertools.cycle(STAGES)
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
    ("hang of each in turn", lambda rig: kill(rig, next(HANGS), signal.SIGSTOP)),
    ("pause outer", lambda rig: pause(rig, "outer")),
    ("pause mixer", lambda rig: pause(rig, "mixer")),
    ("swap back", lambda rig: swap(rig)),
    ("clean beside it", lambda rig: rig.run("clean").expect(0)),
    ("second flight", lambda rig: rig.run("fly", "--duration", "1s").expect(5)),
]


def look(rig, launcher):
    """What the flight holds now."""
    pids = {role: rig.pid(role) for role in ROLES} | {"fly": launcher}
    descriptors, memory = 0, {}
    for role, pid in pids.items():
        try:
            descriptors += len(os.listdir(f"/proc/{pid}/fd"))
            if role in STAY:
                status = Path(f"/proc/{pid}/status").read_text()
                memory[f"own memory of the {STAY[role]} [KiB]"] = int(status.split("RssAnon:")[1].split()[0])
        except (OSError, IndexError):
            return None
    segments = rig.segments()
    return {**memory, "descriptors": descriptors, "segments": len(segments), "shared memory [KiB]": sum(path.stat().st_blocks for path in segments) // 2,
            "files below the root": sum(1 for path in rig.root.rglob("*")),
            "files of the flight": sum(1 for path in rig.out.rglob("*")),
            "threads": sum(len(os.listdir(f"/proc/{pid}/task")) for pid in pids.values() if pid)}


def seconds(text):
    try:
        return float(text[:-1]) * {"s": 1, "m": 60, "h": 3600}[text[-1:]]
    except (ValueError, KeyError):
        raise SystemExit(f"--soak {text}: write a number and its unit, as in 2h, 15m or 250s") from None


def flight(make, total_s, draw, told):
    """One flight; what is seen of it is told as it comes, so that a flight that goes wrong has been seen as well."""
    looks, done = told["looks"], told["faults"]
    with make() as rig:
        flown = rig.take_off("--on-death", "restart", "--log", "off", duration=f"{total_s:.0f}s",
                             preexec_fn=lambda: os.setpriority(os.PRIO_PROCESS, 0, 0))
        begin = time.monotonic()
        for number, (name, strike) in enumerate(itertools.cycle(FAULTS), 1):
            due = begin + number * EVERY_S + draw.random()
            if due + EVERY_S > begin + total_s:
                break
            time.sleep(max(0.0, due - time.monotonic()))
            seen = look(rig, flown.pid)
            if seen:
                looks.append((time.monotonic() - begin, seen))
            demand(flown.is_running(), f"the flight ended: {flown.said()[-500:]}")
            strike(rig)
            done[name] = done.get(name, 0) + 1
            # The files of clients that have ended are not the flight's.
            rig.started = [process for process in rig.started if process.is_running()]
        rig.end_completed(flown)
        report = rig.report()
        rig.demand_nothing_left()
        told["ticks"] = report["ticks"]["run"] + report["ticks"]["skipped"]
        told.update(told_of(report["deaths"]))


def told_of(deaths):
    """How many there were, and what they cost. A successor that died before its first message is within the death that it was to make good."""
    alone = [death for death in deaths if death["within"] is None]
    return {"deaths": len(deaths), "silent": len(deaths) - len(alone), "away": sum(death["back_after_ms"] is None for death in alone),
            "lost": sorted(death["ticks_lost"] or 0 for death in alone)}


def grown(looks):
    """What each quantity grew by since each fault was there once: what it rises by in every round, and in all."""
    # The first death of each role costs the others some descriptors, which later ones use again.
    round_s = len(FAULTS) * EVERY_S
    rounds = {}
    for at, seen in looks:
        rounds.setdefault(int(at // round_s), []).append(seen)
    # The last round is seldom whole; the least of a round is without what its own faults need for a while.
    whole = [rounds[number] for number in sorted(rounds) if number and len(rounds[number]) >= len(FAULTS) // 2]
    demand(len(whole) >= 3, f"{len(whole)} rounds after that of all faults; a soak takes at least {4 * round_s:.0f}s")
    growth = {}
    for what in GROWTH_MOST:
        least = [min(seen[what] for seen in seen_of) for seen_of in whole]
        steady = statistics.median(later - earlier for earlier, later in zip(least, least[1:])) * (len(least) - 1)
        growth[what] = (steady, least[-1] - least[0])
    return growth


def lost_words(lost):
    return f"median {statistics.median(lost):g}, most {max(lost)}" if lost else "none"


def soak(make, build, duration):
    """Flies a build for so long, in flights of at most FLIGHT_S; each is judged by its end and by what grew."""
    left_s, draw = seconds(duration), random.Random(7)
    if os.geteuid() == 0:
        # A pause that a busy machine makes longer than 80 ms is a hang, and a plant's hang the end of the flight.
        os.nice(-15)
    flights, wrong = [], []
    while left_s >= 4 * len(FAULTS) * EVERY_S or not flights:
        flight_s = min(left_s, FLIGHT_S)
        left_s -= flight_s
        told = {"looks": [], "faults": {}, "ticks": 0, "deaths": 0, "silent": 0, "away": 0, "lost": [], "growth": {}}
        flights.append(told)
        try:
            flight(make, flight_s, draw, told)
            told["growth"] = grown(told["looks"])
            found = [f"{what} grew by {more:g} {how}; {most} are allowed" for what, grew in told["growth"].items()
                     for how, more, most in zip(("in every round, together", "in all"), grew, GROWTH_MOST[what]) if more > most]
            if told["away"]:
                found.append(f"{told['away']} of {told['deaths']} dead processes are not back")
            demand(not found, "; ".join(found))
        except (Wrong, NotBegun, OSError, ValueError, LookupError) as error:
            wrong.append(f"flight {len(flights)}: {error}")
    rows = ["| what | first | last | most | steady growth | limit | total growth | limit |",
            "|---|---|---|---|---|---|---|---|"]
    for what, (steady_most, all_most) in GROWTH_MOST.items():
        series = [seen[what] for told in flights for _, seen in told["looks"]]
        grew = [told["growth"][what] for told in flights if told["growth"]]
        if series and grew:
            steady, in_all = (max(more) for more in zip(*grew))
            rows.append(f"| {what} | {series[0]} | {series[-1]} | {max(series)} | {steady:+g} | {steady_most} | {in_all:+g} | {all_most} |")
    kinds = {name for told in flights for name in told["faults"]}
    text = (f"## Long flights\n\n`bench/drill/run --soak {duration}`: {len(flights)} flight{'s' * (len(flights) > 1)} of at most {FLIGHT_S / 60:.0f} min "
            f"of `{build}`, {sum(told['ticks'] for told in flights)} ticks, a fault every {EVERY_S:.0f} s, "
            f"{sum(sum(told['faults'].values()) for told in flights)} in all of {len(kinds)} of {len(FAULTS)} kinds, "
            f"{sum(told['deaths'] for told in flights)} failures, {sum(told['silent'] for told in flights)} of them of successors "
            f"before their first message; ticks lost per failure: {lost_words([lost for told in flights for lost in told['lost']])}. "
            + (f"**Wrong: {'; '.join(wrong)}.**" if wrong else "All completed, all failed processes were replaced, nothing left.")
            + f"\nA round is {len(FAULTS)} faults, each kind once; the smallest value of a round counts. *Steady growth* is the median rise "
            "from round to round, times the rounds after the first. *Total growth* is the last round less the first one after all kinds. "
            "A soak fails if either exceeds its limit.\n\n"
            + "\n".join(rows) + "\n")
    print(text)
    return {"text": text, "flights": flights, "failed": [f"soak {why}" for why in wrong]}
