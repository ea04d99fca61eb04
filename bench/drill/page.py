"""docs/faults.md and faults.json: the rows with what became of their trials."""

import json
import math
import os
import platform
import re
from pathlib import Path

HEAD = """# Faults, tried

Written by `bench/drill/run --write docs`; the same as data in [faults.json](faults.json), why it is so in
[decision 28](decisions/0028-drill.md). Each trial flies real processes over real shared memory, as a trial of its own: own root, own
instance, own processes, and a look at what is left of them. *Survived* means that all came out as expected. The interval is Wilson's, at
95 %, for the share that survives. Of forged messages, and of flipped bits, each message is a trial.

    bench/drill/run --only kill.inner --n 100     # one row again; --list shows the rows, --short is the gate's form
    bench/drill/run --soak 2h                     # one flight with a fault every 10 s: what grows of memory, files, descriptors
    bench/drill/mutants                           # each guard switched off in a build of its own: what turns red

"""


def wilson(survived, tried):
    """The interval of a share at 95 %."""
    z, p = 1.959964, survived / tried
    middle, width = p + z * z / (2 * tried), z * math.sqrt(p * (1 - p) / tried + z * z / (4 * tried * tried))
    return max(0.0, (middle - width) / (1 + z * z / tried)), min(1.0, (middle + width) / (1 + z * z / tried))


def percent(share):
    """Towards the worse, so that 100 % is said of nothing but all."""
    return f"{math.floor(share * 1e4) / 1e2:g}" if share < 1 else "100"


def told(why):
    """What went wrong in one line of a table, without the place of a rig that is gone."""
    return re.sub(r"/tmp/ibd\w+", "RIG", " ".join(why.split()))[:300].replace("|", "/")


def figures(row):
    return "; ".join(f"{name} {median:g} / {worst:g}" for name, (median, worst) in row["figures"].items()) or "-"


def line(row):
    tried, survived = row["tried"], row["survived"]
    if not tried:
        outcome = f"not tried here: {row['why'] or 'not in this form'}"
        return f"| `{row['name']}` | {row['fault']} | `{row['injector']}` | {row['expected']} | 0 | - | - | {outcome} |"
    low, high = wilson(survived, tried)
    failed = "" if survived == tried else f" **{row['why']}**"
    return (f"| `{row['name']}` | {row['fault']} | `{row['injector']}` | {row['expected']}{failed} | {tried} | {survived} | "
            f"{percent(low)} to {percent(high)} % | {figures(row)} |")


def write(directory, results):
    directory = Path(directory)
    (directory / "faults.json").write_text(json.dumps(results, indent=1) + "\n")
    rows = results["rows"]
    tried, good = [row for row in rows if row["tried"]], [row for row in rows if row["tried"] == row["survived"] > 0]
    text = HEAD
    text += (f"{len(rows)} rows, {len(tried)} tried, {len(good)} of these without a trial that failed. {results['machine']}. "
             "Other work ran on the machine meanwhile; figures of time say so much and no more.\n\n")
    for group in dict.fromkeys(row["group"] for row in rows):
        text += f"## {group}\n\n| row | fault | injector | expected | tried | survived | interval | median / worst |\n"
        text += "|---|---|---|---|---|---|---|---|\n"
        text += "".join(line(row) + "\n" for row in rows if row["group"] == group) + "\n"
    for section in ("soak", "mutants"):
        if results.get(section):
            text += results[section]["text"] + "\n"
    (directory / "faults.md").write_text(text)


def machine():
    return f"{os.cpu_count()} processors, {platform.system()} {platform.release()}, a {{profile}} build"
