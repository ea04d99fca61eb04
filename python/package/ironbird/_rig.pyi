"""The rig's own half of the module, in Rust (python/src, python/law/src)."""

from typing import Any

from ironbird.flight import Array, Sensors
from ironbird.law import InnerLaw, OuterLaw

__version__: str

class SettingsError(ValueError):
    """A setting is unknown, or not what it may be."""

class LogError(ValueError):
    """There is no such flight, or its log cannot be read."""

class Measured(Sensors):
    """What the sensors show. Each attribute is a new array."""

    @property
    def age(self) -> int | None:
        """Ticks since it was measured; None before the first."""
    @property
    def given(self) -> Given | None:
        """What the rotor command in force gives; None for an outer law."""

class Given:
    """What the rotor command in force gives, by the nominal model: the mixer's answer to a demand of the inner law."""

    @property
    def age(self) -> int | None:
        """Ticks since the mixer made the command; None before the first."""
    @property
    def thrust_n(self) -> float:
        """Total thrust along body z [N]."""
    @property
    def torque_b_nm(self) -> Array:
        """Torque about body x, y, z [N m]."""
    @property
    def saturated(self) -> bool:
        """Whether the demand could not be met in full."""
    @property
    def other_law(self) -> bool:
        """Whether a channel with other laws flies, and the command answers their demand."""

class Desired:
    """What the outer law wants of the inner one. Each array is a new one."""

    @property
    def age(self) -> int | None:
        """Ticks since it was wanted; None before the first."""
    @property
    def thrust_n(self) -> float:
        """Total thrust along body z [N]."""
    @property
    def attitude_rad(self) -> Array:
        """Roll, pitch, yaw [rad]."""
    @property
    def attitude_rate_rad_s(self) -> Array:
        """Their first derivatives along the reference [rad/s]."""
    @property
    def attitude_acceleration_rad_s2(self) -> Array:
        """Their second derivatives along the reference [rad/s^2]."""
    @property
    def limited(self) -> bool:
        """Whether a limit of the outer law was active."""

class Reference:
    """Where the vehicle should be. Each array is a new one."""

    @property
    def position_w_m(self) -> Array:
        """p_d [m]."""
    @property
    def velocity_w_m_s(self) -> Array:
        """First derivative of p_d [m/s]."""
    @property
    def acceleration_w_m_s2(self) -> Array:
        """Second derivative of p_d [m/s^2]."""
    @property
    def jerk_w_m_s3(self) -> Array:
        """Third derivative of p_d [m/s^3]."""
    @property
    def snap_w_m_s4(self) -> Array:
        """Fourth derivative of p_d [m/s^4]."""
    @property
    def yaw_rad(self) -> float:
        """psi_d [rad], not wrapped."""
    @property
    def yaw_rate_rad_s(self) -> float:
        """First derivative of psi_d [rad/s]."""
    @property
    def yaw_acceleration_rad_s2(self) -> float:
        """Second derivative of psi_d [rad/s^2]."""

class Rig:
    """What a law is told before a flight."""

    @property
    def period_s(self) -> float:
        """Length of a tick [s]."""
    @property
    def airframe(self) -> dict[str, float]:
        """The airframe as it is believed to be, by the names of `ironbird params`."""
    @property
    def rotor_min_rad_s(self) -> float:
        """Smallest rotor speed [rad/s]."""
    @property
    def rotor_max_rad_s(self) -> float:
        """Largest rotor speed [rad/s]."""

Column = tuple[str, str, str, list[str], Array]

def simulate(
    settings: dict[str, dict[str, Any]],
    arguments: dict[str, Any],
    outer: OuterLaw | None = None,
    inner: InnerLaw | None = None,
) -> tuple[list[Column], dict[str, Any]]: ...
def read(run: str, out: str | None = None) -> tuple[list[Column], dict[str, Any]]: ...
def read_rows(path: str) -> list[tuple[str, list[Any]]]: ...
