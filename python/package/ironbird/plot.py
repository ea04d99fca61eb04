"""The picture of a flight, by matplotlib."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from ironbird.flight import Array, Flight

REFERENCE: dict[str, Any] = {"color": "0.75", "linewidth": 4.0}


def draw(figure: Any, flight: Flight, every: int) -> None:
    """Draws a flight onto an empty figure of matplotlib."""
    rows = slice(None, None, every)
    t = flight.t[rows]
    position, reference = flight.state.position_w_m[rows], flight.reference.position_w_m[rows]
    (path, place), (error, attitude), (rotors, last) = figure.subplots(3, 2)

    path.plot(*reference.T[:2], **REFERENCE, label="reference")
    path.plot(*position.T[:2], linewidth=1.0, label="flown")
    path.set(title="path from above", xlabel="x [m]", ylabel="y [m]", aspect="equal", adjustable="datalim")

    def over_time(ax: Any, values: Array, names: tuple[str, ...], title: str, label: str) -> None:
        for column, name in zip(values.T, names, strict=True):
            ax.plot(t, column, linewidth=1.0, label=name)
        ax.set(title=title, xlabel="t [s]", ylabel=label)

    place.plot(t, reference, **REFERENCE)
    over_time(place, position, ("x", "y", "z"), "position, and its reference", "[m]")
    over_time(error, flight.position_error_m[rows, None], ("error",), "distance from the reference", "[m]")
    over_time(attitude, flight.state.attitude_rad[rows], flight.axes["state.attitude_rad"], "attitude", "[rad]")
    speeds = flight.rotor_speeds.speed_rad_s[rows]
    over_time(rotors, speeds, flight.axes["rotor_speeds.speed_rad_s"], "rotor speeds commanded", "[rad/s]")
    estimates = {
        name: values / flight.truth[name]
        for name, values in flight.telemetry.inner.items()
        if name in flight.truth and np.all(flight.truth[name] != 0.0)
    }
    if estimates:
        shares = np.column_stack([values[rows] for values in estimates.values()])
        over_time(last, shares, tuple(estimates), "estimate / true value", "")
        last.axhline(1.0, color="k", linestyle="--", linewidth=0.8)
    else:
        over_time(last, flight.state.rate_b_rad_s[rows], ("p", "q", "r"), "body rates", "[rad/s]")
    instants = sorted({fault.t for fault in flight.faults})
    for ax in (place, error, attitude, rotors, last):
        for instant in instants:
            ax.axvline(instant, color="tab:red", linestyle=":", linewidth=1.0)
    for ax in (path, place, attitude, rotors, last):
        ax.legend(fontsize="x-small", loc="best")
    for ax in figure.axes:
        ax.grid(alpha=0.3)
    changes = ", ".join(f"{it.parameter} {it.old:g} to {it.new:g} at {it.t:g} s{f' over {it.over_s:g} s' if it.over_s else ''}" for it in flight.faults[:3])
    more = f", and {len(flight.faults) - 3} more" if len(flight.faults) > 3 else ""
    figure.suptitle(flight.title + (f"\n{changes}{more}" if changes else ""), fontsize="medium")
