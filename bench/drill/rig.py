"""A rig for one trial of the drill: own root, own output, own instance, own processes, and what is left of them."""

import json
import os
import re
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
ROLES = ("plant", "outer", "inner", "mixer", "record")
STAGES = ("outer", "inner", "mixer")
# Who sends a topic.
SENDERS = {"setpoint": "outer", "wrench": "inner", "rotor_speeds": "mixer"}
PATIENCE_S = 90.0
# What a launcher says last whose roles have not all come.
WAITS = "plant.log says for which"


class Wrong(Exception):
    """A trial did not come out as it is expected to."""

    # How many trials the flight stands for in which it happened.
    trials = 1


class Broken(Wrong):
    """What no busy machine explains: it is not tried again."""


class NotBegun(Exception):
    """The flight did not get to fly, as on a machine that is too busy to start it: the fault was not tried."""


class NotHere(Exception):
    """A trial needs what this machine, or this user, does not have."""


def need(program):
    if not shutil.which(program):
        raise NotHere(f"there is no {program}")


def need_root():
    if os.geteuid() != 0:
        raise NotHere("only root may do this")


def demand(holds, words):
    if not holds:
        raise Wrong(words)


class Ended:
    def __init__(self, code, out, err):
        self.code, self.out, self.err = code, out, err

    def __str__(self):
        return f"code {self.code}: {(self.err or self.out).strip()[-400:]}"

    def expect(self, *codes):
        demand(self.code in codes, f"exit code {self.code}, expected {' or '.join(map(str, codes))}: {self}")
        return self

    def says(self, words):
        demand(squeezed(words) in squeezed(self.out + self.err), f"`{words}` is not said: {self}")
        return self

    def result(self):
        lines = [line for line in self.out.splitlines() if line.startswith("RESULT ")]
        demand(lines, f"no result: {self}")
        return dict(pair.split("=", 1) for pair in lines[-1].split(" ")[1:] if "=" in pair)


def squeezed(text):
    return re.sub(r"[\s│]", "", text)


class Process:
    """A process of the rig, with what it says in files."""

    def __init__(self, child, out, err):
        self.child, self.out, self.err, self.pid = child, out, err, child.pid

    def is_running(self):
        return self.child.poll() is None

    def send(self, number):
        if self.is_running():
            os.kill(self.pid, number)

    def end(self, patience_s=PATIENCE_S):
        try:
            code = self.child.wait(patience_s)
        except subprocess.TimeoutExpired:
            if self.said().rstrip().endswith(WAITS):
                raise NotBegun(f"{self.said()[-200:]}") from None
            raise Wrong(f"does not end within {patience_s} s: {self.said()[-300:]}") from None
        return Ended(code, self.out.read_text(errors="replace"), self.said())

    def said(self):
        return self.err.read_text(errors="replace")


def wait_until(what, look, patience_s=PATIENCE_S, every_s=0.01):
    until = time.monotonic() + patience_s
    while True:
        found = look()
        if found:
            return found
        demand(time.monotonic() < until, f"waited in vain for {what}")
        time.sleep(every_s)


class Rig:
    numbers = iter(range(10**9))

    def __init__(self, executable, trials=1):
        self.executable, self.executable_path, self.trials = str(executable), executable, trials
        # Short, because sockets live below it.
        self.directory = Path(tempfile.mkdtemp(prefix="ibd", dir="/tmp"))
        self.instance = f"drill-{os.getpid()}-{next(self.numbers)}"
        self.root, self.out = self.directory / "r", self.directory / "out"
        self.environment = {**os.environ, "IRONBIRD_ROOT": str(self.root)}
        self.started = []

    def __enter__(self):
        return self

    def __exit__(self, _kind, wrong, _trace):
        if isinstance(wrong, Wrong):
            wrong.trials = self.trials
        for pid in self.processes():
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                pass
        for process in self.started:
            process.child.wait()
        if self.leftovers() or self.root.exists():
            wait_until("killed processes to go", lambda: not self.processes(), 10)
            subprocess.run([self.executable, "clean"], env=self.environment, capture_output=True, check=False)
        shutil.rmtree(self.directory, ignore_errors=True)

    # What is started.

    def command(self, *words):
        """`ironbird` with the words, and with this rig's instance and output where the command takes them."""
        words = [str(word) for word in words]
        own = []
        if words[0] in (*ROLES, "fly", "inject", "params", "watch") and "--instance" not in words:
            own += ["--instance", self.instance]
        if words[0] in ("fly", "record", "report", "export", "replay") and "--out" not in words:
            own += ["--out", str(self.out)]
        return [self.executable, words[0], *own, *words[1:]]

    def launch(self, command, **options):
        number = len(self.started)
        out, err = self.directory / f"{number}.out", self.directory / f"{number}.err"
        with open(options.pop("stdout", out), "wb") as stdout, open(options.pop("stderr", err), "wb") as stderr:
            out.touch(), err.touch()
            options = {"env": self.environment, "cwd": self.directory, "stdin": subprocess.DEVNULL, **options}
            child = subprocess.Popen(command, stdout=stdout, stderr=stderr, **options)
        process = Process(child, out, err)
        self.started.append(process)
        return process

    def start(self, *words, **options):
        return self.launch(self.command(*words), **options)

    def run(self, *words, **options):
        return self.start(*words, **options).end()

    def settings(self, text, name="settings.toml"):
        path = self.directory / name
        path.write_text(text)
        return str(path)

    def fly(self, *words, duration="3s", rt="off", **options):
        """A flight that hovers far above the ground, so that a gap costs height and not the flight: rows give it."""
        sky = self.settings("[flight]\nground_z_m = -100.0\nposition_error_max_m = 90.0\n", "sky.toml")
        return self.start("fly", "--rt", rt, "--config", sky, "--trajectory", "hover", "--duration", duration, *words,
                          **options)

    def await_flight(self, flight=None):
        def flies():
            demand(flight is None or flight.is_running(), "the flight ended before it began: "
                   + (flight.said()[-300:] if flight else ""))
            asked = subprocess.run(self.command("params", "--json"), env=self.environment, capture_output=True,
                                   check=False)
            return asked.returncode == 0 and json.loads(asked.stdout)[0]["in_force"] is not None
        try:
            wait_until("the flight to begin", flies, every_s=0.05)
        except Wrong as wrong:
            if flight is None or not flight.is_running():
                raise
            raise NotBegun(str(wrong)) from None
        return flight

    def take_off(self, *words, **options):
        return self.await_flight(self.fly(*words, **options))

    # What is there.

    def pid(self, role):
        """Who plays a role now: the process that its lock names, if it lives."""
        try:
            pid = int((self.root / self.instance / f"{role}.lock").read_text())
            state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
        except (OSError, ValueError, IndexError):
            return None
        return None if state in "ZX" else pid

    def await_pid(self, role, other_than=None):
        return wait_until(f"another {role}", lambda: (pid := self.pid(role)) and pid != other_than and pid)

    def strike(self, role, number=signal.SIGKILL):
        pid = self.await_pid(role)
        os.kill(pid, number)
        return pid

    def processes(self):
        """Living processes that carry the instance's name, or are this rig's own children."""
        own = {process.pid for process in self.started if process.is_running()}
        for entry in Path("/proc").iterdir():
            if entry.name.isdigit():
                try:
                    words = (entry / "cmdline").read_bytes().split(b"\0")
                    state = (entry / "stat").read_text().rsplit(")", 1)[1].split()[0]
                except (OSError, IndexError):
                    continue
                if self.instance.encode() in words and state not in "ZX" and int(entry.name) != os.getpid():
                    own.add(int(entry.name))
        return own

    def segments(self):
        return sorted(path for path in Path("/dev/shm").iterdir() if f"_{self.instance}." in path.name)

    def leftovers(self):
        return [str(path) for path in self.segments()] + [f"process {pid}" for pid in self.processes()]

    def demand_nothing_left(self, patience_s=5.0):
        try:
            wait_until("nothing to be left", lambda: not self.leftovers(), patience_s)
        except Wrong:
            raise Broken(f"left: {', '.join(self.leftovers())[:300]}") from None

    def demand_next_flight(self):
        """The next flight of the same instance flies, without a `clean` in between."""
        self.start("fly", "--rt", "off", "--pace", "lockstep", "--duration", "50ms").end().expect(0)
        self.demand_nothing_left()

    def report(self, run="latest"):
        return json.loads((self.out / run / "report.json").read_text())

    def end_completed(self, flight, *codes):
        """The end of a flight that was flown to its last tick: neither thrown out of the air nor cut short."""
        ended = flight.end().expect(*(codes or (0, 3)))
        ending = self.report()["run"]["ending"]
        demand(ending == "completed", f"the flight did not complete: {ending}")
        return ended

    def demand_replay(self):
        if self.replay_or_gap([]):
            raise Broken("a gap without a death")

    def replay_or_gap(self, deaths):
        """Replays a flight with deaths; 1 where the replay refuses for a message that a dead sender's log lacks.

        A message is handed to its receivers one after the other: one whose sender is killed meanwhile may have reached
        a loop and not the recorder. Such a gap lies between the last message in the log of a process that died and the
        first of its successor; any other is wrong.
        """
        replayed = self.run("replay", "--verify")
        gap = re.search(r"the log has a gap: at tick \d+ the `(\w+)` of tick (\d+) was used", replayed.out + replayed.err)
        if replayed.code == 1 and gap:
            sender, tick = SENDERS.get(gap[1]), int(gap[2])
            if any(death["role"] == sender and death["tick"] < tick <= death["tick"] + (death["ticks_lost"] or 0)
                   for death in deaths):
                return 1
        if replayed.code != 0 or "identical" not in replayed.out + replayed.err:
            raise Broken(f"replay: {replayed}")
        return 0
