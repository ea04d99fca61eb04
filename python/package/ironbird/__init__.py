"""The rig from Python: simulate flights, read recorded ones, fly laws that are written here.

    flight = ironbird.simulate("lissajous", 20, outer="estimating", faults=["mass_kg=+30%@8s"])
    flight.t, flight.state.position_w_m, flight.units["state.position_w_m"]
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from typing import Any

from ironbird import _rig
from ironbird._rig import Desired, Given, LogError, Measured, Reference, Rig, SettingsError
from ironbird.flight import Array, Fault, Flight, Group
from ironbird.law import InnerLaw, OuterLaw

__all__ = [
    "Array",
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
    "read",
    "simulate",
]


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
    said = {
        "flight.trajectory": None if trajectory is None else os.fspath(trajectory),
        "flight.duration_s": duration_s,
        "flight.airframe": None if airframe is None else os.fspath(airframe),
        "flight.preset": preset,
        "flight.faults": None if faults is None else [faults] if isinstance(faults, str) else list(faults),
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


def read(run: str | os.PathLike[str] = "latest", *, out: str | os.PathLike[str] | None = None) -> Flight:
    """Reads a recorded flight: its directory, its flight.mcap, or `latest` among those in `out` (else in runs).

    There is a row for every tick of which the log holds a message; `Flight.tick` says which. What was not published at
    a tick is NaN.

    Raises:
        LogError: there is no such flight, or its log cannot be read.
    """
    columns, facts = _rig.read(os.fspath(run), None if out is None else os.fspath(out))
    return Flight._of(columns, facts)
