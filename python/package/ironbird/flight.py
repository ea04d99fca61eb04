"""A flight as arrays: one row per tick, groups by topic, units by name."""

from __future__ import annotations

import base64
import difflib
import html
import io
import json
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from ironbird import plot as picture
from ironbird import table
from ironbird._rig import LogError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ironbird._rig import Column

Array: TypeAlias = npt.NDArray[np.float64]


class Group(Mapping[str, Array]):
    """Arrays by name, as attributes or as keys; a row per tick, NaN where nothing was said."""

    def __init__(self, arrays: dict[str, Array]) -> None:
        self._arrays = arrays

    def __getitem__(self, name: str) -> Array:
        if name not in self._arrays:
            raise KeyError(self._lacks(name))
        return self._arrays[name]

    def _lacks(self, name: object) -> str:
        there = f"there are {', '.join(self._arrays)}" if self._arrays else "it is empty"
        return f"{type(self).__name__} has no {name!r}; {there}"

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    # What a type checker knows of are the names that the groups declare.
    if not TYPE_CHECKING:

        def __getattr__(self, name):
            if not name.startswith("_") and name in self._arrays:
                return self._arrays[name]
            words = f"{type(self).__name__} has no {name!r}" if name.startswith("_") else self._lacks(name)
            raise AttributeError(words, name=name, obj=self)

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._arrays]

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(self._arrays)})"


class Units(dict[str, str]):
    """Units by the names of their arrays; an error for an unknown name lists the nearest ones."""

    def __missing__(self, name: str) -> str:
        nearest = difflib.get_close_matches(str(name), self, n=5, cutoff=0.0)
        raise KeyError(f"units has no {name!r}; the nearest are {', '.join(nearest)}")


class Sensors:
    """What the sensors show at a tick."""

    position_w_m: Array
    """Position, world frame [m]."""
    velocity_w_m_s: Array
    """Velocity, world frame [m/s]."""
    attitude_rad: Array
    """Roll, pitch, yaw: ZYX Euler angles, body to world [rad]."""
    attitude_quaternion: Array
    """The same attitude as a unit quaternion w, x, y, z, body to world."""
    rate_b_rad_s: Array
    """Body rates p, q, r as the gyro measures them [rad/s]."""
    specific_force_b_m_s2: Array
    """Specific force as the accelerometer measures it, body frame [m/s^2]."""
    rotor_speed_mean_rad_s: Array
    """Mean of each rotor's speed over the last tick [rad/s]."""
    rotor_speed_squared_mean_rad2_s2: Array
    """Mean of each rotor's squared speed over the last tick [rad^2/s^2]."""
    rotor_speed_command_rad_s: Array
    """Rotor speeds that are in force from this tick on [rad/s]."""


class State(Sensors, Group):
    """What the sensors show at the tick, and the plant's account of commands and ticks."""

    command_tick: Array
    commands_taken: Array
    command_taken_tick: Array
    command_saturated: Array
    deadlines_missed: Array
    deadline_miss_run: Array
    ticks_skipped: Array
    parameter_epoch: Array


class Truth(Group):
    """What no sensor shows, and the parameters in force, by the names of `ironbird params`."""

    position_w_m: Array
    velocity_w_m_s: Array
    rate_b_rad_s: Array
    touches_ground: Array


class Setpoint(Group):
    """What the outer law wants."""

    thrust_n: Array
    attitude_rad: Array
    attitude_rate_rad_s: Array
    attitude_acceleration_rad_s2: Array
    limited: Array
    mode: Array


class Course(Group):
    """Where the vehicle should be."""

    position_w_m: Array
    velocity_w_m_s: Array
    acceleration_w_m_s2: Array
    jerk_w_m_s3: Array
    snap_w_m_s4: Array
    yaw_rad: Array
    yaw_rate_rad_s: Array
    yaw_acceleration_rad_s2: Array


class Wrench(Group):
    """What the inner law asks of the rotors."""

    thrust_n: Array
    torque_b_nm: Array
    mode: Array


class RotorSpeeds(Group):
    """What the mixer commands, and what that achieves by the nominal model."""

    speed_rad_s: Array
    thrust_n: Array
    torque_b_nm: Array
    saturated: Array
    mode: Array


class Telemetry(NamedTuple):
    """What each law shows of itself, by the law's own names."""

    outer: Group
    inner: Group
    mixer: Group


@dataclass(frozen=True)
class Fault:
    """A parameter of the plant that changed in flight."""

    tick: int
    """Tick from which the value changed."""
    t: float
    """The same as time of the flight [s]."""
    parameter: str
    """Name with unit."""
    old: float
    new: float
    over_s: float
    """How long the change took [s]; 0 if it was made at once."""


def _report(file: Path | None) -> dict[str, Any]:
    if file is None or not file.is_file():
        return {}
    try:
        report = json.loads(file.read_text(encoding="utf-8"))
        if isinstance(report, dict) and "schema" in report:
            return report
        why = "it has no schema"
    except ValueError as error:
        why = str(error)
    raise LogError(f"{file} is no report of a flight: {why}; move it away to read the log without it")


@dataclass(frozen=True, eq=False, repr=False)
class Flight:
    """A flight: arrays with a row per tick, and what is known of it."""

    t: Array
    """Time of the flight [s]."""
    tick: Array
    """Number of the tick."""
    state: State
    truth: Truth
    setpoint: Setpoint
    reference: Course
    wrench: Wrench
    rotor_speeds: RotorSpeeds
    telemetry: Telemetry
    theorem: Group
    """What the theorem's monitor says; empty where the inner law has no theorem."""
    timing: Group
    """Latencies [us]; empty in a simulated flight. `slack_us` is below 0 where a deadline was missed."""
    units: Mapping[str, str]
    """Unit of each array, as `units["state.position_w_m"]`; empty for a ratio, a count or a flag."""
    axes: Mapping[str, tuple[str, ...]]
    """Names of the columns of each array that has several, as `axes["state.attitude_rad"]`: roll, pitch, yaw."""
    faults: tuple[Fault, ...]
    end: str
    """Why it ended: `completed`, or how it left its envelope."""
    fingerprint: str
    """Hash over all outputs of all stages, the one that `ironbird simulate` and `ironbird replay` print."""
    laws: Mapping[str, str]
    """Name of the law of each role."""
    trajectory: str
    period_s: float
    """Length of a tick [s]."""
    settings: Mapping[str, Mapping[str, Any]]
    """What it was flown with; `simulate(settings=flight.settings)` flies it again."""
    directory: Path | None
    """Where its log is; None for a simulated flight."""
    report: Mapping[str, Any]
    """The report (`ironbird docs report`) beside the log; empty where there is none."""

    @property
    def status(self) -> str | None:
        """PASS, COMPLETED, INCOMPLETE, FAIL, INTERRUPTED or ABORTED; None without a report."""
        status: str | None = self.report.get("verdict", {}).get("status")
        return status

    @property
    def verdicts(self) -> dict[str, str]:
        """The report's verdicts on flight, timing and theorem, and the last words of a process that failed; of a flight
        without a report, how it ended."""
        words: Mapping[str, Mapping[str, str]] = self.report.get("words", {})
        if not words:
            recent_s = min(5.0, float(self.t[-1])) if len(self.t) else 0.0
            recent_m = self.position_error_m[self.t >= self.t[-1] - recent_s] if len(self.t) else np.empty(0)
            # A tick whose state was lost has no error.
            known_m = recent_m[np.isfinite(recent_m)]
            error_m = known_m.max() if known_m.size else np.nan
            return {"flight": f"{self.end}; position error up to {error_m:.4f} m in the last {recent_s:.1f} s"}
        verdicts = {name: f"{it['word'].replace('_', ' ')}: {it['why']}" for name, it in words.items()}
        last = "\n".join(self.report["run"]["last_words"])
        return verdicts | ({"last words": last} if last else {})

    @property
    def position_error_m(self) -> Array:
        """Distance between the vehicle, where it truly is, and its reference [m]."""
        error: Array = np.linalg.norm(self.truth.position_w_m - self.reference.position_w_m, axis=1)
        return error

    @property
    def yaw_error_rad(self) -> Array:
        """Difference between the yaw and that of the reference, at most pi [rad]."""
        difference = self.reference.yaw_rad - self.state.attitude_rad[:, 2]
        error: Array = np.abs((difference + np.pi) % (2.0 * np.pi) - np.pi)
        return error

    @property
    def tilt_error_rad(self) -> Array:
        """Angle between body z and the thrust that the reference needs of the true airframe in the steady wind [rad]."""
        truth, reference = self.truth, self.reference
        wind = np.column_stack([truth["wind_x_m_s"], truth["wind_y_m_s"], truth["wind_z_m_s"]])
        drag = (truth["translational_drag_kg_s"] / truth["mass_kg"])[:, None]
        thrust = reference.acceleration_w_m_s2 + drag * (reference.velocity_w_m_s - wind)
        thrust[:, 2] += truth["gravity_m_s2"]
        w, x, y, z = self.state.attitude_quaternion.T
        body_z = np.column_stack([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)])
        across = np.linalg.norm(np.cross(body_z, thrust), axis=1)
        error: Array = np.arctan2(across, np.sum(body_z * thrust, axis=1))
        return error

    @property
    def title(self) -> str:
        """Trajectory, length, laws and end."""
        end = self.status if self.status and self.end == "completed" else ", ".join(filter(None, (self.status, self.end)))
        return f"{self.trajectory}, {len(self.t)} ticks, {' + '.join(self.laws.values())}: {end}"

    def columns(self, every: int = 1) -> dict[str, Array]:
        """All numbers by name, each an array with a row for every `every`th tick: `t_s`, `tick`, `state.position_w_m.x`.

        Those of the loop have the names of `ironbird export --joined`.
        """
        if every < 1:
            raise ValueError(f"every = {every}: allowed are 1 and more")
        result = {"t_s": self.t[::every], "tick": self.tick[::every]}
        groups: dict[str, Group] = {name: value for name in self.__dataclass_fields__ if isinstance(value := getattr(self, name), Group)}
        groups |= {f"telemetry.{role}": group for role, group in self.telemetry._asdict().items()}
        for group, arrays in groups.items():
            for name, array in arrays.items():
                path = f"{group}.{name}"
                if path in self.axes:
                    parts = zip(self.axes[path], array[::every].T, strict=True)
                    result |= {f"{path}.{axis}": part for axis, part in parts}
                else:
                    result[path] = array[::every]
        return result

    def to_pandas(self, every: int = 1) -> Any:
        """A DataFrame of pandas with the columns of `columns`, and a row for every `every`th tick."""
        return table.pandas(self.columns(every))

    def to_polars(self, every: int = 1) -> Any:
        """The same as a DataFrame of Polars."""
        return table.polars(self.columns(every))

    def plot(self, every: int = 1) -> Figure:
        """A figure of matplotlib: path, position, error, attitude, rotor speeds and estimates; dotted lines are faults."""
        matplotlib = table.library("matplotlib", "plot()")
        pyplot = table.library("matplotlib.pyplot", "plot()")
        figure: Figure = pyplot.figure(figsize=(11, 9), layout="constrained")
        picture.draw(figure, self, every)
        if "inline" in matplotlib.get_backend():
            # A notebook shows what a cell returns, and all open figures once more.
            pyplot.close(figure)
        return figure

    def __repr__(self) -> str:
        return f"<Flight {self.title}, outputs {self.fingerprint}>"

    def _repr_html_(self) -> str:
        lines = "".join(
            f"<tr><th>{html.escape(name)}</th><td style='text-align:left;white-space:pre-wrap'>{html.escape(text)}</td></tr>"
            for name, text in self.verdicts.items()
        )
        text = f"<p><b>{html.escape(self.title)}</b></p><table>{lines}</table>"
        try:
            drawn = table.library("matplotlib.figure", "plot()").Figure(figsize=(11, 9), layout="constrained")
        except ImportError:
            return text
        picture.draw(drawn, self, max(1, len(self.t) // 4000))
        png = io.BytesIO()
        drawn.savefig(png, format="png", dpi=80)
        return f"{text}<img alt='the flight' src='data:image/png;base64,{base64.b64encode(png.getvalue()).decode()}'>"

    @classmethod
    def _of(cls, columns: list[Column], facts: dict[str, Any]) -> Flight:
        groups: dict[str, dict[str, Array]] = {}
        for group, name, _, _, array in columns:
            groups.setdefault(group, {})[name] = array
        telemetry = (Group(groups.get(f"telemetry.{role}", {})) for role in Telemetry._fields)
        tick: Array = facts["tick"]
        directory = Path(facts["log"]).absolute().parent if "log" in facts else None
        report = directory / "report.json" if directory else None
        return cls(
            t=tick * facts["period_s"],
            tick=tick,
            state=State(groups["state"]),
            truth=Truth(groups["truth"]),
            setpoint=Setpoint(groups["setpoint"]),
            reference=Course(groups["reference"]),
            wrench=Wrench(groups["wrench"]),
            rotor_speeds=RotorSpeeds(groups["rotor_speeds"]),
            telemetry=Telemetry(*telemetry),
            theorem=Group(groups.get("theorem", {})),
            timing=Group(groups.get("timing", {})),
            units=Units({"t": "s"} | {f"{group}.{name}": unit for group, name, unit, _, _ in columns}),
            axes={f"{group}.{name}": tuple(axes) for group, name, _, axes, _ in columns if axes},
            faults=tuple(Fault(*fault) for fault in facts["faults"]),
            end=facts["end"],
            fingerprint=facts["fingerprint"],
            laws=facts["laws"],
            trajectory=facts["trajectory"],
            period_s=facts["period_s"],
            settings=tomllib.loads(facts["settings"]) | facts.get("handed", {}),
            directory=directory,
            report=_report(report),
        )
