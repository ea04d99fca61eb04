"""Measures several sides in turn and writes tables: shared by bench/tries, bench/peers and bench/firmware."""

import json
import math
import os
import platform
import re
import resource
import statistics
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# Fewer rounds give no interval of 95 %.
ROUNDS_MIN = 6


class Absent(Exception):
    """A side cannot be installed or measured, with the reason."""


def call(command, **options):
    """Runs a program to its end; its output, or Absent with its message."""
    try:
        done = subprocess.run([str(part) for part in command], capture_output=True, text=True, **options)
    except OSError as error:
        raise Absent(f"{command[0]}: {error.strerror}") from error
    if done.returncode != 0:
        words = [line.strip() for line in (done.stderr or done.stdout).splitlines() if line.strip()]
        wrong = [line for line in words if re.search(r"\berror\b", line, re.IGNORECASE)] or words[-1:]
        raise Absent(wrong[0] if wrong else f"{command[0]} ended with code {done.returncode}")
    return done.stdout


def cpu_seconds(command):
    """Processor time of a program with its processes, from start to end [s]; its output."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    said = call(command)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, said


def alternate(sides, rounds):
    """Measures each side once a round, every other round backwards, so that a drift of the machine reaches all alike.

    `sides` are functions by name. Gives each side's results by name, one per round, or the reason where it cannot be measured.
    """
    results = {name: [] for name in sides}
    for i in range(rounds):
        for name in list(sides) if i % 2 == 0 else reversed(sides):
            if isinstance(results[name], str):
                continue
            before = steal()
            try:
                results[name].append({**sides[name](), "steal_percent": stolen(before)})
            except Absent as error:
                results[name] = str(error)
        print(f"round {i + 1} of {rounds}", file=sys.stderr, flush=True)
    return results


def ratios(results, over):
    """Ratios of two sides' numbers, round by round."""
    return [a / b for a, b in zip(results, over) if b > 0]


def interval(values):
    """Between these two order statistics the median lies with at least 95 %."""
    values = sorted(values)
    beyond = [sum(math.comb(len(values), j) for j in range(k + 1)) / 2 ** len(values) for k in range(len(values) // 2)]
    k = sum(1 for share in beyond if 2 * share <= 0.05)
    return (values[k - 1], values[-k]) if k else (math.nan, math.nan)


def spread(values, form=".1f"):
    """Median (least to largest)."""
    return f"{statistics.median(values):{form}} ({min(values):{form}} to {max(values):{form}})"


def table(columns, rows):
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join(f"| {' | '.join(map(str, cells))} |" for cells in lines)


def replace_part(page, command, text):
    """Replaces what `command` made of a page, between two comments; a page without them gets them at its end."""
    begin, end = f"<!-- made by: {command} -->", "<!-- end -->"
    old = page.read_text() if page.exists() else ""
    if begin not in old:
        old += f"{begin}\n{end}\n"
    head, rest = old.split(begin, 1)
    page.write_text(f"{head}{begin}\n\n{text}\n\n{end}{rest.split(end, 1)[1]}")


def write_part(directory, command, name, text, numbers):
    """Writes a table of benchmarks.md in a directory, and the numbers behind it, as `name`, into benchmarks.json."""
    directory.mkdir(parents=True, exist_ok=True)
    replace_part(directory / "benchmarks.md", command, text)
    data = directory / "benchmarks.json"
    numbers = {**(json.loads(data.read_text()) if data.exists() else {}), name: numbers}
    data.write_text(json.dumps(numbers, indent=1) + "\n")


def executable():
    """The one that the variable IRONBIRD names, or a release build."""
    if "IRONBIRD" in os.environ:
        return Path(os.environ["IRONBIRD"])
    call(["cargo", "build", "--release", "--locked", "-p", "ironbird", "--bin", "ironbird"], cwd=ROOT)
    return target() / "release" / "ironbird"


def target():
    return Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")).resolve()


def commit():
    described = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True)
    return described.stdout.strip() or "unknown"


def conditions():
    """Commit, machine and its load, for the line below a table. Call it before measuring."""
    model = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text())
    return (f"{commit()}; {model[1] if model else platform.machine()}, {os.cpu_count()} processors, Linux {platform.release()}; "
            f"load average {os.getloadavg()[0]:.1f} before")


def loops_processor():
    """The processor that the loops of a flight take."""
    return max(os.sched_getaffinity(0))


def stolen(before):
    """Share of the processors that the host took since [%]."""
    taken, elapsed = (b - a for a, b in zip(before, steal()))
    return 100.0 * taken / max(elapsed, 1)


def steal():
    """Ticks of the processors so far: stolen by the host, and all."""
    numbers = [int(word) for word in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
    return numbers[7], sum(numbers)
