"""Rows of the fault matrix (bench/rig/tests/fault_matrix.md), each flown n times by the system tests."""

import json
import os
import subprocess

from rig import ROOT, NotHere, Wrong

PAGE = ROOT / "bench/rig/tests/fault_matrix.md"


def tests_of(executable):
    """The newest build of the system tests, beside the executable or in target/debug."""
    places = [executable.parent / "deps", executable.parent.parent / "debug/deps", ROOT / "target/debug/deps"]
    found = [path for place in places for path in place.glob("rig-*") if not path.suffix]
    if not found:
        raise NotHere("the system tests are not built: cargo test -p ironbird --test rig --no-run")
    return max(found, key=lambda path: path.stat().st_mtime)


def flights(make, n, row):
    """Flies a row of the fault matrix n times, each at another instant."""
    with make(trials=n) as rig:
        environment = {**os.environ, "IRONBIRD_EXECUTABLE": rig.executable, "IRONBIRD_ROWS": row, "IRONBIRD_ROUNDS": str(n)}
        tests = subprocess.run([tests_of(rig.executable_path), "--exact", "fault_matrix::every_row", "--ignored", "--nocapture"],
                               cwd=ROOT / "bench/rig", env=environment, capture_output=True, text=True, check=False)
        trials = [line.split(" ", 2) for line in tests.stdout.splitlines() if line.startswith("TRIAL ")]
        for _, _, figures in trials[:n]:
            yield json.loads(figures)
        if tests.returncode != 0:
            rig.trials = n - len(trials)
            raise Wrong(tests.stderr.partition("panicked at")[2][:300])


def row_of(cells):
    name, fault, at, _, exit_code, outcome, said = cells
    when = "" if at == "-" else f", {at}"
    expected = f"{outcome}, code {exit_code}" + (f": `{said}`" if said else "")
    guards = ("heartbeat",) if name == "hang.inner" else ()
    return {"name": name, "fault": f"{fault}{when}", "injector": flights, "arguments": {"row": name}, "expected": expected,
            "n": 20, "short": len(guards), "guards": guards}


LINES = [line for line in PAGE.read_text().splitlines() if line.startswith("| ")][1:]
ROWS = [row_of([cell.strip() for cell in line.strip("|").split("|")]) for line in LINES]
