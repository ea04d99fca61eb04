"""docs/faults.md and faults.json: the rows with what became of their trials."""

import json
import math
import os
import platform
import re

HEAD = """# Fault drill

The drill tries each fault of this list on real processes over real shared memory and checks what is left ([inject](injection.md)
faults yourself). Use it after changes to processes, shared memory or recovery
([why it is built this way](decisions/0028-drill.md); the same data: [faults.json](faults.json)).

    bench/drill/run --short --write docs          # this page, each row a few times; without --short, n times
    bench/drill/run --only kill.inner --n 100     # one row; --list shows all
    bench/drill/run --soak 2h --write docs        # a fault every 10 s: growth of memory, files, descriptors

*Survived*: all came out as expected, and the flight left nothing behind. A trial that failed once was repeated, and both count. *At
least*: lower end of Wilson's interval (95 %) for the share that survives. *Killed* is SIGKILL, *stopped* SIGSTOP, at random instants;
*masked*: another channel flies; *completed*: flown to its end; *identical*: `replay --verify`. Figures that were always 0 are left out.

"""

NOT_TRIED = """Not tried here, because the tests run each of them once
([fault_matrix.md](../bench/cli/tests/transcripts/fault_matrix.md) has the fault and what is expected):"""


def wilson(survived, tried):
    """The lower end of a share's interval at 95 %."""
    z, p = 1.959964, survived / tried
    middle, width = p + z * z / (2 * tried), z * math.sqrt(p * (1 - p) / tried + z * z / (4 * tried * tried))
    return max(0.0, (middle - width) / (1 + z * z / tried))


def percent(share):
    """Towards the worse, so that 100 % is said of nothing but all."""
    return f"{math.floor(share * 1e4) / 1e2:g}" if share < 1 else "100"


def one_line(why):
    """What went wrong in one line of a table, without the place of a rig that is gone."""
    return re.sub(r"/tmp/ib\w+", "RIG", " ".join(why.split()))[:300].replace("|", "/")


def figures(row):
    """Median and worst of each figure."""
    pairs = [(name, *pair) for name, pair in row["figures"].items() if pair[1]]
    return "; ".join(f"{name} {median:g}/{worst:g}" for name, median, worst in pairs) or "-"


def build_of(row):
    return row["build"], row["executable"], row["date"]


def builds(rows):
    """The builds that rows were tried with, each with its mark: none where there is only one."""
    found = list(dict.fromkeys(build_of(row) for row in rows if row["tried"]))
    return {build: f" ({chr(ord('a') + number)})" if len(found) > 1 else "" for number, build in enumerate(found)}


def text_of_builds(rows, marks):
    counts = {build: sum(build_of(row) == build for row in rows) for build in marks}
    texts = [f"{count} row{'s' * (count > 1)}{marks[build]} with `{build[0]}` on {build[2]}" for build, count in counts.items()]
    return f"Tried: {', '.join(texts) or 'nothing'}"


def line(row, marks):
    tried, survived = row["tried"], row["survived"]
    begin = f"| `{row['name']}`{marks.get(build_of(row), '')} | {row['fault']} | {row['expected']}"
    if not tried:
        return f"{begin} | 0 | - | - | not tried: {row['lack'] or row['why']} |"
    number = tried if row["trial"] == "flight" else f"{tried} x {row['trial']}"
    failed = "" if survived == tried else f" **{row['why']}**"
    return f"{begin}{failed} | {number} | {survived} | {percent(wilson(survived, tried))} | {figures(row)} |"


def write(directory, results):
    (directory / "faults.json").write_text(json.dumps(results, indent=1) + "\n")
    rows = results["rows"]
    tried, good = [row for row in rows if row["tried"]], [row for row in rows if row["tried"] == row["survived"] > 0]
    marks = builds(rows)
    text = (f"{HEAD}{text_of_builds(rows, marks)}; {results['machine']}, beside other work. {len(rows)} rows, {len(tried)} tried, "
            f"{len(good)} without a failed trial.\n\n")
    for group in dict.fromkeys(row["group"] for row in rows):
        of_group = [row for row in rows if row["group"] == group]
        listed = [row for row in of_group if row["tried"] or row["lack"] or row["why"]]
        text += f"## {group}\n\n"
        if listed:
            text += "| row | fault | expected | tried | survived | at least [%] | median/worst |\n|---|---|---|---|---|---|---|\n"
            text += "".join(line(row, marks) + "\n" for row in listed) + "\n"
        if others := [f"`{row['name']}`" for row in of_group if row not in listed]:
            text += f"{NOT_TRIED}\n{', '.join(others)}.\n\n"
    not_run = "## Long flights\n\nNot run: `bench/drill/run --soak 2h --write docs`.\n\n"
    text += results["soak"]["text"] if results.get("soak") else not_run
    (directory / "faults.md").write_text(text.rstrip("\n") + "\n")


def machine():
    return f"{os.cpu_count()} processors, {platform.system()} {platform.release()}"
