"""docs/faults.md and faults.json: the rows with what became of their trials."""

import json
import math
import os
import platform
import re
from pathlib import Path

HEAD = """# Faults, tried

Written by `bench/drill/run --write docs`; the same as data in [faults.json](faults.json), why it is so in
[decision 28](decisions/0028-drill.md). Each trial is made with
real processes over real shared memory: own root, own instance, own processes, and a look at what is left of them. *Survived* means that
all came out as expected; a flight against the clock that failed once was flown again, and both are counted.

What a trial is stands beside its number. Where it is not a flight, several trials share one: `8 deaths, 1 flight`. A flight that fails
then costs all of its trials. The interval is Wilson's, at 95 %, for the share that survives: of flights where trials share them, else of
trials. Few trials give wide intervals, and say no more than these.

    bench/drill/run --short --write docs          # this page: each row a few times; without --short, as often as its n
    bench/drill/run --only kill.inner --n 100     # one row again; --list shows the rows
    bench/drill/run --soak 2h --write docs        # flights with a fault every 10 s: what grows of memory, files, descriptors
    bench/drill/mutants --write docs              # each guard switched off in a build of its own: what turns red

"""


def wilson(survived, tried):
    """The interval of a share at 95 %."""
    z, p = 1.959964, survived / tried
    middle, width = p + z * z / (2 * tried), z * math.sqrt(p * (1 - p) / tried + z * z / (4 * tried * tried))
    most = 1.0 if survived == tried else (middle + width) / (1 + z * z / tried)
    return max(0.0, (middle - width) / (1 + z * z / tried)), most


def percent(share):
    """Towards the worse, so that 100 % is said of nothing but all."""
    return f"{math.floor(share * 1e4) / 1e2:g}" if share < 1 else "100"


def told(why):
    """What went wrong in one line of a table, without the place of a rig that is gone."""
    return re.sub(r"/tmp/ibd\w+", "RIG", " ".join(why.split()))[:300].replace("|", "/")


def figures(row):
    return "; ".join(f"{name} {median:g} / {worst:g}" for name, (median, worst) in row["figures"].items()) or "-"


def counted(number, what):
    first, of, rest = what.partition(" that ")
    return f"{number} {first}{'' if number == 1 else 's'}{of}{rest}"


def builds(rows):
    """The builds that rows were tried with, each with its mark: none where there is one alone."""
    found = list(dict.fromkeys((row["build"], row["executable"], row["date"]) for row in rows if row["tried"]))
    return {build: f" ({chr(ord('a') + number)})" if len(found) > 1 else "" for number, build in enumerate(found)}


def told_of_builds(rows, marks):
    def number(build):
        return sum((row["build"], row["executable"], row["date"]) == build for row in rows)
    said = [f"`{build[0]}` on {build[2]}" for build in marks]
    if len(said) <= 1:
        return f"All rows with one build, {''.join(said) or 'not tried'}"
    each = ", ".join(f"{number(build)} rows{mark} with {words}" for (build, mark), words in zip(marks.items(), said))
    return f"Of several builds, and a row says no more than what its own did: {each}"


def line(row, marks):
    mark = marks.get((row["build"], row["executable"], row["date"]), "")
    tried, survived = row["tried"], row["survived"]
    begin = f"| `{row['name']}`{mark} | {row['fault']} | `{row['injector']}` | {row['expected']}"
    if not tried:
        return f"{begin} | 0 | - | - | not tried: {row['lack'] or row['why'] or 'not asked for'} |"
    flights = row["flights"]
    low, high = wilson(flights - row["flights_lost"], flights) if row["shares_flights"] else wilson(survived, tried)
    number = str(tried) if row["trial"] == "flight" else counted(tried, row["trial"])
    number += f", {counted(flights, 'flight')}" if row["shares_flights"] else ""
    failed = "" if survived == tried else f" **{row['why']}**"
    return (f"{begin}{failed} | {number} | {survived} | {percent(low)} to {percent(high)} % | {figures(row)} |")


def write(directory, results):
    directory = Path(directory)
    (directory / "faults.json").write_text(json.dumps(results, indent=1) + "\n")
    rows = results["rows"]
    tried, good = [row for row in rows if row["tried"]], [row for row in rows if row["tried"] == row["survived"] > 0]
    text = HEAD
    marks = builds(rows)
    text += (f"{told_of_builds(rows, marks)}; {results['machine']}. {len(rows)} rows, "
             f"{len(tried)} tried, {len(good)} of these without a trial that failed. Other work ran on the machine meanwhile; "
             "figures of time say so much and no more.\n\n")
    missing = [f"`{row['name']}`" for row in rows if not row["tried"]]
    text += f"Not tried: {', '.join(missing)}.\n\n" if missing else ""
    for group in dict.fromkeys(row["group"] for row in rows):
        text += f"## {group}\n\n| row | fault | injector | expected | tried | survived | interval | median / worst |\n"
        text += "|---|---|---|---|---|---|---|---|\n"
        text += "".join(line(row, marks) + "\n" for row in rows if row["group"] == group) + "\n"
    for section, title, command in (("soak", "Long flights", "bench/drill/run --soak 2h --write docs"),
                                    ("mutants", "Guards switched off", "bench/drill/mutants --write docs")):
        if results.get(section):
            text += results[section]["text"] + "\n"
        else:
            text += f"## {title}\n\nNot run: `{command}`.\n\n"
    (directory / "faults.md").write_text(text.rstrip("\n") + "\n")


def machine():
    return f"{os.cpu_count()} processors, {platform.system()} {platform.release()}"
