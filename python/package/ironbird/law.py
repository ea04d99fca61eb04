"""What a law in Python is: a function, or an object with such a `tick`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeAlias

from ironbird._rig import Desired, Measured, Reference

OuterTick: TypeAlias = Callable[[int, Measured, Reference], Sequence[Any]]
"""(tick, measured, reference) -> (thrust_n, attitude_rad, attitude_rate_rad_s, attitude_acceleration_rad_s2)."""

InnerTick: TypeAlias = Callable[[int, Measured, Desired, Reference], Sequence[Any]]
"""(tick, measured, wanted, reference) -> (thrust_n, torque_b_nm)."""


class OuterObject(Protocol):
    """An outer law with a memory. Where it has `telemetry`, its numbers are the last value of what `tick` returns."""

    def tick(self, tick: int, measured: Measured, reference: Reference, /) -> Sequence[Any]: ...


class InnerObject(Protocol):
    """An inner law with a memory. Where it has `telemetry`, its numbers are the last value of what `tick` returns."""

    def tick(self, tick: int, measured: Measured, wanted: Desired, reference: Reference, /) -> Sequence[Any]: ...


OuterLaw: TypeAlias = OuterTick | OuterObject | type[OuterObject]
InnerLaw: TypeAlias = InnerTick | InnerObject | type[InnerObject]
