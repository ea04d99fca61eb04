"""The rows of the drill, read from the pages of the system tests, which play each of them."""

import json
import os
import subprocess
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TESTS = ROOT / "bench/cli/tests"


class Wrong(Exception):
    """A trial failed."""


class NotHere(Exception):
    """A trial needs what this machine, or this user, does not have."""


@dataclass(frozen=True)
class Row:
    group: str
    name: str
    fault: str
    expected: str
    n: int
    # Trials with --short; 0 skips the row unless it is named.
    short: int
    # What a trial is.
    trial: str
    # Real-time loops would keep those of another row from their processor.
    is_alone: bool = False


def table(page):
    """The cells of a page's first table."""
    lines = [line for line in (TESTS / page).read_text().splitlines() if line.startswith("| ")][1:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def rows():
    found = []
    for name, fault, expected, n, short, trial in table("transcripts/drill.md"):
        group = "Messages" if name.split(".")[0] in ("flipped", "missing", "flood") else "Processes and machine"
        found.append(Row(group, name, fault, expected, int(n), int(short), trial))
    for name, fault, at, _, flags, exit_code, outcome, words in table("transcripts/fault_matrix.md"):
        when = "" if at == "-" else f", {at}"
        expected = f"{outcome}, code {exit_code}" + (f": `{words}`" if words else "")
        found.append(Row("Fault matrix", name, fault + when, expected, 20, 0, "flight", "--rt prefer" in flags))
    return found


def tests_of(executable):
    """The newest build of the system tests, beside the executable or in target/debug."""
    places = [executable.parent / "deps", executable.parent.parent / "debug/deps", ROOT / "target/debug/deps"]
    found = [path for place in places for path in place.glob("rig-*") if not path.suffix]
    if not found:
        raise NotHere("the system tests are not built: cargo test -p ironbird --test rig --no-run")
    return max(found, key=lambda path: path.stat().st_mtime)


def play(row, n, executable):
    """Plays a row n times, each time at other instants; yields the figures of each trial."""
    environment = {**os.environ, "IRONBIRD": str(executable), "IRONBIRD_SCENARIOS": row.name, "IRONBIRD_ROUNDS": str(n)}
    tests = subprocess.run([tests_of(executable), "--exact", "transcripts::drill", "--ignored", "--nocapture"], cwd=ROOT / "bench/cli",
                           env=environment, capture_output=True, text=True, check=False)
    trials = [line.split(" ", 2) for line in tests.stdout.splitlines() if line.startswith("TRIAL ")]
    if "NOT TESTED: " in tests.stderr:
        raise NotHere(tests.stderr.partition("NOT TESTED: ")[2].splitlines()[0])
    trials = [figures for _, name, figures in trials if name == row.name]
    if not trials and tests.returncode == 0:
        raise NotHere("the system tests played no such row; build them again")
    for figures in trials[:n]:
        yield json.loads(figures)
    if tests.returncode != 0:
        raise Wrong(tests.stderr.partition("panicked at")[2][:300])
