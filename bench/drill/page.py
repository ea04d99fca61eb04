"""docs/faults.md and faults.json: the rows with what became of their trials."""

import itertools
import json
import math
import os
import platform
import re
from pathlib import Path

HEAD = """# Fault drill

How reliably does the rig survive a fault? The drill tries each fault of this list on real processes over real shared memory and
checks what is left. Use it after changes to processes, shared memory or recovery
([why it is built this way](decisions/0028-drill.md); the same data: [faults.json](faults.json)).

    bench/drill/run --short --write docs          # this page, each row a few times; without --short, n times
    bench/drill/run --only kill.inner --n 100     # one row; --list shows all
    bench/drill/run --soak 2h --write docs        # a fault every 10 s: growth of memory, files, descriptors
    bench/drill/mutants --write docs              # each check switched off in its own build: which rows fail

*Survived*: all came out as expected, and the flight left nothing behind. A real-time flight that failed once was repeated, and both
count. `8 failures, 1 flight`: trials that share a flight; if it fails, all of them do. *At least*: lower end of Wilson's interval (95 %)
for the share that survives, of flights if trials share them, otherwise of trials. *Killed* is SIGKILL, *stopped* SIGSTOP, at random
instants; *completed*: flown to its end; *identical*: `replay --verify`. Figures that were always 0 are left out.

"""


def wilson(survived, tried):
    """The lower end of a share's interval at 95 %."""
    z, p = 1.959964, survived / tried
    middle, width = p + z * z / (2 * tried), z * math.sqrt(p * (1 - p) / tried + z * z / (4 * tried * tried))
    return max(0.0, (middle - width) / (1 + z * z / tried))


def percent(share):
    """Towards the worse, so that 100 % is said of nothing but all."""
    return f"{math.floor(share * 1e4) / 1e2:g}" if share < 1 else "100"


def told(why):
    """What went wrong in one line of a table, without the place of a rig that is gone."""
    return re.sub(r"/tmp/ibd\w+", "RIG", " ".join(why.split()))[:300].replace("|", "/")


def figures(*rows):
    """Median and worst of each figure, one pair for each row."""
    names = dict.fromkeys(name for row in rows for name, (_, worst) in row["figures"].items() if worst)
    return "; ".join(f"{name} {', '.join('{:g}/{:g}'.format(*row['figures'][name]) for row in rows)}" for name in names) or "-"


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
    return f"Several builds: {each}"


def alike(rows, marks):
    """Rows in groups that differ in nothing but their fault: each group is a line of the table."""
    def key(row):
        mark = marks.get((row["build"], row["executable"], row["date"]), "")
        outcome = [row[name] for name in ("expected", "tried", "survived", "flights", "flights_lost", "why", "lack", "trial")]
        return (mark, row["injector"].split("(")[0], list(row["figures"]), outcome)
    return [list(group) for _, group in itertools.groupby(rows, key)]


def merged(texts):
    """Texts as one: what they begin and end with is written once."""
    words = [text.split() for text in dict.fromkeys(texts)]
    short = min(map(len, words))
    begin = next((n for n in range(short) if len({tuple(text[:n + 1]) for text in words}) > 1), short)
    end = next((n for n in range(short - begin) if len({tuple(text[-n - 1:]) for text in words}) > 1), short - begin)
    parts = [" ".join(text[begin:len(text) - end]) for text in words]
    return " ".join([*words[0][:begin], ", ".join(filter(None, parts)), *words[0][len(words[0]) - end:]]).replace("  ", " ").strip()


def line(rows, marks):
    row = rows[0]
    mark = marks.get((row["build"], row["executable"], row["date"]), "")
    tried, survived = row["tried"], row["survived"]
    names = ", ".join(f"`{row['name']}`" for row in rows)
    begin = f"| {names}{mark} | {merged(row['fault'] for row in rows)} | {row['expected']}"
    if not tried:
        return f"{begin} | 0 | - | - | not tried: {row['lack'] or row['why'] or 'not asked for'} |"
    flights = row["flights"]
    low = wilson(flights - row["flights_lost"], flights) if row["shares_flights"] else wilson(survived, tried)
    number = str(tried) if row["trial"] == "flight" else counted(tried, row["trial"])
    number += f", {counted(flights, 'flight')}" if row["shares_flights"] else ""
    failed = "" if survived == tried else f" **{row['why']}**"
    return f"{begin}{failed} | {number} | {survived} | {percent(low)} | {figures(*rows)} |"


def write(directory, results):
    directory = Path(directory)
    (directory / "faults.json").write_text(json.dumps(results, indent=1) + "\n")
    rows = results["rows"]
    tried, good = [row for row in rows if row["tried"]], [row for row in rows if row["tried"] == row["survived"] > 0]
    text = HEAD
    marks = builds(rows)
    text += (f"{told_of_builds(rows, marks)}; {results['machine']}, beside other work. {len(rows)} rows, {len(tried)} tried, "
             f"{len(good)} without a failed trial.\n\n")
    missing = [f"`{row['name']}`" for row in rows if not row["tried"]]
    text += f"Not tried: {', '.join(missing)}.\n\n" if missing else ""
    for group in dict.fromkeys(row["group"] for row in rows):
        text += f"## {group}\n\n| rows | fault | expected | tried, each | survived | at least [%] | median/worst |\n"
        text += "|---|---|---|---|---|---|---|\n"
        text += "".join(line(same, marks) + "\n" for same in alike([row for row in rows if row["group"] == group], marks)) + "\n"
    for section, title, command in (("soak", "Long flights", "bench/drill/run --soak 2h --write docs"),
                                    ("mutants", "Checks switched off", "bench/drill/mutants --write docs")):
        if results.get(section):
            text += results[section]["text"] + "\n"
        else:
            text += f"## {title}\n\nNot run: `{command}`.\n\n"
    (directory / "faults.md").write_text(text.rstrip("\n") + "\n")


def machine():
    return f"{os.cpu_count()} processors, {platform.system()} {platform.release()}"
