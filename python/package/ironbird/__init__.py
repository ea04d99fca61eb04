"""The rig from Python: simulate flights, fly and read recorded ones, fly laws that are written here, run campaigns.

    flight = ironbird.simulate("lissajous", 20, outer="estimating", faults=["mass_kg=+30%@8s"])
    flight.t, flight.state.position_w_m, flight.units["state.position_w_m"]
    flight.plot()
"""

from __future__ import annotations

import csv
import json
import os
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ironbird import _rig
from ironbird._rig import Desired, Given, LogError, Measured, Reference, Rig, SettingsError, __version__
from ironbird.command import CommandError, Flag, executable, expect, failed, hinting, place, run
from ironbird.flight import Array, Fault, Flight, Group
from ironbird.law import InnerLaw, OuterLaw
from ironbird.table import Table, flat

__all__ = [
    "Array",
    "CommandError",
    "Desired",
    "Fault",
    "Flight",
    "Given",
    "Group",
    "InnerLaw",
    "LogError",
    "Measured",
    "OuterLaw",
    "Reference",
    "Rig",
    "SettingsError",
    "Table",
    "__version__",
    "campaign",
    "compare",
    "executable",
    "fly",
    "margin",
    "read",
    "simulate",
]


@hinting
def simulate(
    trajectory: str | os.PathLike[str] | None = None,
    duration_s: float | None = None,
    *,
    airframe: str | os.PathLike[str] | None = None,
    preset: str | None = None,
    outer: str | OuterLaw | None = None,
    inner: str | InnerLaw | None = None,
    mixer: str | None = None,
    faults: str | Iterable[str] | None = None,
    seed: int | None = None,
    settings: Mapping[str, Mapping[str, Any]] | None = None,
) -> Flight:
    """Flies in one process, as `ironbird simulate` does, and returns every tick.

    What is not given is as in `settings`, which has the sections and keys of a settings file, and else as the rig has
    it by default. Settings that were made for one law, airframe or preset do not fly another. `outer` and `inner` are the name or the file of a law, or a law in Python: a function, an object with
    `tick`, or a class of such, which is made as `ironbird fly` makes that of a file.

    The interpreter is free for other threads while laws of the rig fly. Ctrl-C ends the flight.

    Raises:
        SettingsError: a setting is unknown, or not what it may be.
        MemoryError: the arrays of so many ticks do not fit.
        Exception: whatever a law in Python raises, with its own traceback.
    """
    if not (mixer is None or isinstance(mixer, str)):
        raise TypeError(f"mixer: expected the name of a law, not {type(mixer).__name__}; in Python fly outer and inner laws")
    if not isinstance(settings, Mapping | None) or not all(isinstance(keys, Mapping) for keys in (settings or {}).values()):
        raise TypeError(f"settings: expected sections with their keys, as in {{'plant': {{'mass_kg': 0.5}}}}, not {settings!r:.99}")
    said = {
        "flight.trajectory": None if trajectory is None else os.fspath(trajectory),
        "flight.duration_s": duration_s,
        "flight.airframe": None if airframe is None else os.fspath(airframe),
        "flight.preset": preset,
        "flight.faults": [faults] if isinstance(faults, str) else faults,
        "flight.seed": seed,
        "outer.law": outer if isinstance(outer, str) else None,
        "inner.law": inner if isinstance(inner, str) else None,
        "mixer.law": mixer,
    }
    columns, facts = _rig.simulate(
        {name: dict(keys) for name, keys in (settings or {}).items()},
        {key: value for key, value in said.items() if value is not None},
        None if isinstance(outer, str) else outer,
        None if isinstance(inner, str) else inner,
    )
    return Flight._of(columns, facts)


@hinting
def read(run: str | os.PathLike[str] = "latest", *, out: str | os.PathLike[str] | None = None) -> Flight:
    """Reads a recorded flight: its directory, its flight.mcap, or `latest` among those in `out` (else in runs).

    There is a row for every tick of which the log holds a message; `Flight.tick` says which. What was not published at
    a tick is NaN.

    Raises:
        LogError: there is no such flight, or its log cannot be read.
    """
    columns, facts = _rig.read(os.fspath(run), None if out is None else os.fspath(out))
    return Flight._of(columns, facts)


def fly(**flags: Flag) -> Flight:
    """Flies in four real-time processes, as `ironbird fly` does, and reads the flight from its directory.

    Keywords are the flags of `ironbird fly`, with `_` for each `-`: `fly(trajectory="helix", duration="10s", inner="indi",
    fault=["mass_kg=+30%@5s"], set={"inner.filter_rad_s": 60.0}, pace="lockstep")`. A gate that does not hold, a lost
    flight and a dead process are results: see `status` and `verdicts`.

    Raises:
        SettingsError: a flag or a setting is unknown, or not what it may be.
        CommandError: nothing was flown.
        LogError: the flight has no log (`log="off"`).
        FileNotFoundError: there is no executable.
        KeyboardInterrupt: Ctrl-C ended the flight in order; its directory is the newest one.
    """
    done = run("fly", **flags)
    directory = place(done.stdout, "run")
    if directory is None:
        raise failed(done)
    return read(directory)


def compare(**flags: Flag) -> Table:
    """Simulates a flight with several laws, as `ironbird compare` does: a row for each combination of laws.

    `compare(inner=["adaptive", "indi"], fault="disturbance_gain_rad_s2=2@8s")`. With `table` or `suite`, there is a row for
    each case and combination. `document` has all that `--format json` prints.

    Raises:
        SettingsError, CommandError, FileNotFoundError: as `fly`.
    """
    if "table" in flags or "suite" in flags:
        with tempfile.TemporaryDirectory() as directory:
            rows = Path(os.fspath(flags.pop("csv", None) or Path(directory) / "rows.csv"))  # type: ignore[arg-type]
            expect(run("compare", csv=rows, **flags), 0, 3)
            with open(rows, newline="", encoding="utf-8") as file:
                return Table([{name: _value(name, text) for name, text in row.items()} for row in csv.DictReader(file)])
    document = _document("compare", flags, 0, 3)
    return Table([flat(row["laws"] | {name: row[name] for name in row if name != "laws"}) for row in document["outcomes"]], document)


def _document(name: str, flags: Mapping[str, Flag], *codes: int) -> dict[str, Any]:
    if "format" in flags:
        raise TypeError(f"format: {name}() reads the command's JSON and returns a table: leave it out")
    document: dict[str, Any] = json.loads(expect(run(name, **flags, format="json"), *codes))
    return document


def margin(**flags: Flag) -> Table:
    """Measures which faults a loop survives, as `ironbird margin` does: a row for each law, kind of fault and stage.

    `margin(inner="indi", only="inner", phases=1)`. The limits are the greatest strength, in ticks or as a share in percent,
    that is `unnoticed`, from which the loop `recovers`, that it `survives`, and at which it is `calm`. `untried` names the
    limits that still hold at `most`: the true limit may be greater, but more was not tried.

    Raises:
        SettingsError, CommandError, FileNotFoundError: as `fly`.
    """
    document = _document("margin", flags, 0)
    rows = []
    for law in document["laws"]:
        for search in law["searches"]:
            limits = dict(zip(LIMITS, search["limits"], strict=True))
            untried = [name for name, limit in limits.items() if limit == search["most"]]
            rows.append(law["laws"] | {name: search[name] for name in ("kind", "of", "most")} | limits | {"untried": ", ".join(untried)})
    return Table(rows, document)


LIMITS = ("unnoticed", "recovers", "survives", "calm")


def campaign(file: str | os.PathLike[str], *, out: str | os.PathLike[str] | None = None, **flags: Flag) -> Table:
    """Runs a campaign, as `ironbird campaign run` does: a row for each flight and arm, in the order of the flights.

    Flights that are recorded already in `out` (default: campaigns/NAME of the file) are not repeated. `document` is the
    report of the campaign: success of each arm with its interval, differences, factors.

    Raises:
        SettingsError, CommandError, FileNotFoundError: as `fly`.
        KeyboardInterrupt: Ctrl-C; the next call flies what is missing.
    """
    directory = Path(place(expect(run("campaign", "run", file, out=out, **flags), 0), "out") or "")
    document = json.loads(expect(run("campaign", "report", directory, format="json"), 0, 3))
    table = []
    for chunk in sorted(directory.glob("chunk-*.parquet")):
        columns = dict(_rig.read_rows(os.fspath(chunk)))
        table += [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    return Table(table, document)


def _value(column: str, text: str) -> float | int | str | None:
    """A cell of the table of `compare --csv`."""
    if column in ("case", "trajectory", "preset", "outer", "inner", "mixer", "outputs"):
        return text
    if column == "seed":
        return int(text)
    return float(text) if text else None
