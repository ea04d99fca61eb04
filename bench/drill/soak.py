"""Long flights with a fault every ten seconds: what grows of memory, files and descriptors, and whether too much."""

import itertools
import json
import os
import random
import shutil
import signal
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

import flip

ROLES = ("plant", "outer", "inner", "mixer", "record")
EVERY_S = 10.0
TIMEOUT_S = 90.0
STAY = {"plant": "plant", "record": "recorder", "fly": "supervisor"}
# A blackboard has 64 slots, and a killed writer keeps its own: in this time a role is killed 54 times.
FLIGHT_S = 7200.0
# What may be more at the end of a flight than after its first round of faults: what rises in every round, and in all.
GROWTH_MOST = {"own memory of the plant [KiB]": (512, 2048), "own memory of the recorder [KiB]": (1024, 8192),
               "own memory of the supervisor [KiB]": (512, 2048), "descriptors": (8, 16), "segments": (2, 4),
               "shared memory [KiB]": (256, 512), "files below the root": (8, 64), "files of the flight": (2, 4),
               "threads": (2, 2)}


class Wrong(Exception):
    """The flight did not come out as expected."""


def demand(holds, words):
    if not holds:
        raise Wrong(words)


def wait_until(what, look):
    until = time.monotonic() + TIMEOUT_S
    while not (found := look()):
        demand(time.monotonic() < until, f"waited in vain for {what}")
        time.sleep(0.02)
    return found


class Flight:
    """A flight of its own instance, that hovers far above the ground."""

    def __init__(self, executable, seconds):
        # Short, because sockets live below it.
        self.executable, self.directory = str(executable), Path(tempfile.mkdtemp(prefix="ibd", dir="/tmp"))
        self.instance, self.root, self.out = f"soak-{os.getpid()}", self.directory / "r", self.directory / "out"
        self.environment = {**os.environ, "IRONBIRD_ROOT": str(self.root)}
        sky = self.directory / "sky.toml"
        sky.write_text("[flight]\nground_z_m = -100.0\nposition_error_max_m = 90.0\n")
        self.said = self.directory / "said"
        self.process = self.start("fly", "--rt", "off", "--config", sky, "--trajectory", "hover", "--duration", f"{seconds:.0f}s",
                                  "--on-death", "restart", "--log", "off", "--out", self.out, said=self.said,
                                  preexec_fn=lambda: os.setpriority(os.PRIO_PROCESS, 0, 0))

    def start(self, *words, said=os.devnull, **options):
        words = [words[0], *(() if words[0] == "clean" else ("--instance", self.instance)), *map(str, words[1:])]
        with open(said, "wb") as file:
            return subprocess.Popen([self.executable, *words], stdout=file, stderr=file, env=self.environment,
                                    cwd=self.directory, **options)

    def run(self, code, *words):
        found = self.start(*words).wait(TIMEOUT_S)
        demand(found == code, f"{' '.join(words)}: exit code {found}, expected {code}")

    def report(self):
        try:
            return json.loads((self.out / "latest/report.json").read_text())
        except (OSError, ValueError):
            return None

    def pid(self, role):
        """The process in a role: the one that its lock names, if it lives."""
        try:
            pid = int((self.root / self.instance / f"{role}.lock").read_text())
            state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
        except (OSError, ValueError, IndexError):
            return None
        return None if state in "ZX" else pid

    def send(self, role, number):
        pid = wait_until(role, lambda: self.pid(role))
        os.kill(pid, number)
        return pid

    def segments(self):
        return list(Path("/dev/shm").glob(f"*_{self.instance}.*"))

    def end(self):
        code = self.process.wait(TIMEOUT_S)
        ending = self.report()["run"]["ending"]
        demand(code in (0, 3) and ending == "completed", f"exit code {code}: {ending}")
        wait_until("shared memory to be removed", lambda: not self.segments())

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        subprocess.run([self.executable, "clean"], env=self.environment, capture_output=True, check=False)
        shutil.rmtree(self.directory, ignore_errors=True)


def kill(flight, role, number=signal.SIGKILL):
    dead = flight.send(role, number)
    wait_until(f"another {role}", lambda: (pid := flight.pid(role)) and pid != dead)


def pause(flight, role):
    pid = flight.send(role, signal.SIGSTOP)
    time.sleep(0.01)
    try:
        os.kill(pid, signal.SIGCONT)
    except ProcessLookupError:
        demand(role != "plant", "the pause of the plant took so long that it was treated as a hang")


def swap(flight, clients=1):
    for client in [flight.start("inject", f"mass_kg={0.51 + i / 100}") for i in range(clients)]:
        demand(client.wait(TIMEOUT_S) == 0, "a parameter change failed")


def client(flight, words, after_s, *signals):
    process = flight.start(*words)
    for number in signals:
        time.sleep(after_s)
        process.send_signal(number)
    process.wait()


HANGS = itertools.cycle(("outer", "inner", "mixer"))
FAULTS = [
    ("kill outer", lambda flight: kill(flight, "outer")),
    ("pause plant", lambda flight: pause(flight, "plant")),
    ("swap", swap),
    ("kill inner", lambda flight: kill(flight, "inner")),
    ("client killed", lambda flight: client(flight, ("inject", "mass_kg=0.53"), 0.02, signal.SIGKILL)),
    ("flip bits", lambda flight: flip.flip(flight.instance, flight.report()["run"]["run_id"], 1.0, 0.05)),
    ("kill mixer", lambda flight: kill(flight, "mixer")),
    ("pause record", lambda flight: pause(flight, "record")),
    ("watch killed", lambda flight: client(flight, ("watch",), 0.5, signal.SIGKILL)),
    ("eight clients", lambda flight: swap(flight, 8)),
    ("watch stopped", lambda flight: client(flight, ("watch",), 0.5, signal.SIGSTOP, signal.SIGKILL)),
    ("pause inner", lambda flight: pause(flight, "inner")),
    ("hang of each in turn", lambda flight: kill(flight, next(HANGS), signal.SIGSTOP)),
    ("pause outer", lambda flight: pause(flight, "outer")),
    ("pause mixer", lambda flight: pause(flight, "mixer")),
    ("swap back", swap),
    ("clean beside it", lambda flight: flight.run(0, "clean")),
    ("second flight", lambda flight: flight.run(5, "fly", "--duration", "1s")),
]


def look(flight):
    """What the flight holds now; None while a process is replaced."""
    pids = {role: flight.pid(role) for role in ROLES} | {"fly": flight.process.pid}
    seen = {"descriptors": 0, "threads": 0}
    try:
        for role, pid in pids.items():
            seen["descriptors"] += len(os.listdir(f"/proc/{pid}/fd"))
            seen["threads"] += len(os.listdir(f"/proc/{pid}/task"))
            if role in STAY:
                status = Path(f"/proc/{pid}/status").read_text()
                seen[f"own memory of the {STAY[role]} [KiB]"] = int(status.split("RssAnon:")[1].split()[0])
        segments = flight.segments()
        return seen | {"segments": len(segments), "shared memory [KiB]": sum(path.stat().st_blocks for path in segments) // 2,
                       "files below the root": sum(1 for _ in flight.root.rglob("*")),
                       "files of the flight": sum(1 for _ in flight.out.rglob("*"))}
    except (OSError, IndexError):
        return None


def seconds(text):
    try:
        return float(text[:-1]) * {"s": 1, "m": 60, "h": 3600}[text[-1:]]
    except (ValueError, KeyError):
        raise SystemExit(f"--soak {text}: write a number and its unit, as in 2h, 15m or 250s") from None


def fly(flight, total_s, draw, found):
    """Flies with faults. What is seen is added to `found` at once, so that it is there if the flight fails."""
    wait_until("the first report", flight.report)
    begin = time.monotonic()
    for number, (name, fault) in enumerate(itertools.cycle(FAULTS), 1):
        due = begin + number * EVERY_S + draw.random()
        if due + EVERY_S > begin + total_s:
            break
        time.sleep(max(0.0, due - time.monotonic()))
        seen = look(flight)
        if seen:
            found["looks"].append((time.monotonic() - begin, seen))
        demand(flight.process.poll() is None, f"the flight ended: {flight.said.read_text(errors='replace')[-500:]}")
        fault(flight)
        found["faults"][name] = found["faults"].get(name, 0) + 1
    flight.end()
    report = flight.report()
    found["ticks"] = report["ticks"]["run"] + report["ticks"]["skipped"]
    # A successor that failed before its first message is part of the failure that it was to repair.
    alone = [death for death in report["deaths"] if death["within"] is None]
    found |= {"deaths": len(report["deaths"]), "silent": len(report["deaths"]) - len(alone),
              "away": sum(death["back_after_ms"] is None for death in alone),
              "lost": sorted(death["ticks_lost"] or 0 for death in alone)}
    return found


def grown(looks):
    """The growth of each quantity since each fault was there once: what it rises by in every round, and in all."""
    rounds = {}
    for at, seen in looks:
        rounds.setdefault(int(at // (len(FAULTS) * EVERY_S)), []).append(seen)
    # The last round is seldom whole; the smallest value of a round is without what its own faults need for a while.
    whole = [rounds[number] for number in sorted(rounds) if number and len(rounds[number]) >= len(FAULTS) // 2]
    demand(len(whole) >= 3, f"{len(whole)} rounds after that of all faults; a soak takes at least {4 * len(FAULTS) * EVERY_S:.0f}s")
    growth = {}
    for what in GROWTH_MOST:
        least = [min(seen[what] for seen in seen_of) for seen_of in whole]
        steady = statistics.median(later - earlier for earlier, later in zip(least, least[1:])) * (len(least) - 1)
        growth[what] = (steady, least[-1] - least[0])
    return growth


def soak(executable, build, duration):
    """Flies for so long, in flights of at most FLIGHT_S; each is judged by its end and by what grew."""
    left_s, draw = seconds(duration), random.Random(7)
    if os.geteuid() == 0:
        # A pause that a busy machine makes longer than 80 ms is a hang, and a plant's hang the end of the flight.
        os.nice(-15)
    flights, wrong = [], []
    while left_s >= 4 * len(FAULTS) * EVERY_S or not flights:
        flight_s = min(left_s, FLIGHT_S)
        left_s -= flight_s
        found = {"looks": [], "faults": {}, "ticks": 0, "deaths": 0, "silent": 0, "away": 0, "lost": [], "growth": {}}
        flights.append(found)
        flight = Flight(executable, flight_s)
        try:
            fly(flight, flight_s, draw, found)
            found["growth"] = grown(found["looks"])
            more = [f"{what} grew by {grew:g} {how}; {most} are allowed" for what, both in found["growth"].items()
                    for how, grew, most in zip(("in every round, together", "in all"), both, GROWTH_MOST[what]) if grew > most]
            demand(not found["away"], f"{found['away']} of {found['deaths']} failed processes are not back")
            demand(not more, "; ".join(more))
        except (Wrong, OSError, ValueError, LookupError, subprocess.SubprocessError) as error:
            wrong.append(f"flight {len(flights)}: {error}")
        finally:
            flight.close()
    text = page_section(flights, wrong, build, duration)
    print(text)
    return {"text": text, "flights": flights, "failed": [f"soak {why}" for why in wrong]}


def page_section(flights, wrong, build, duration):
    rows = ["| what | first | last | most | steady growth | limit | total growth | limit |",
            "|---|---|---|---|---|---|---|---|"]
    for what, (steady_most, all_most) in GROWTH_MOST.items():
        series = [seen[what] for found in flights for _, seen in found["looks"]]
        grew = [found["growth"][what] for found in flights if found["growth"]]
        if series and grew:
            steady, total = (max(more) for more in zip(*grew))
            rows.append(f"| {what} | {series[0]} | {series[-1]} | {max(series)} | {steady:+g} | {steady_most} | {total:+g} | {all_most} |")
    ticks, deaths, silent = (sum(found[key] for found in flights) for key in ("ticks", "deaths", "silent"))
    faults = sum(sum(found["faults"].values()) for found in flights)
    lost = [ticks for found in flights for ticks in found["lost"]]
    lost_words = f"median {statistics.median(lost):g}, most {max(lost)}" if lost else "none"
    result = f"**Wrong: {'; '.join(wrong)}.**" if wrong else "All completed, all failed processes were replaced, nothing left."
    return (f"## Long flights\n\n`bench/drill/run --soak {duration}`: {len(flights)} flight{'s' * (len(flights) > 1)} of at most "
            f"{FLIGHT_S / 60:.0f} min of `{build}`, {ticks} ticks, a fault every {EVERY_S:.0f} s, {faults} faults of {len(FAULTS)} kinds, "
            f"{deaths} failures ({silent} of successors that had sent nothing); ticks lost per failure: {lost_words}. {result}\n"
            f"A round is {len(FAULTS)} faults, each kind once; the smallest value of a round counts. *Steady growth* is the median rise "
            "from round to round, times the rounds after the first. *Total growth* is the last round less the first one after all kinds. "
            "A soak fails if either exceeds its limit.\n\n" + "\n".join(rows) + "\n")
