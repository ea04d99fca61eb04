"""Laws in Python: functions and objects, what they are given, and what goes wrong in them."""

import hashlib
import re
import sys
import traceback

import numpy as np
import pytest

import ironbird

INERTIA_KG_M2 = np.array([3.8278e-3, 3.8278e-3, 7.6566e-3])


def angles(tick, measured, wanted, reference):
    """A proportional law for angles and rates."""
    error = wanted.attitude_rad - measured.attitude_rad
    return wanted.thrust_n, INERTIA_KG_M2 * (100.0 * error - 20.0 * measured.rate_b_rad_s)


class Angles:
    """The same with a memory, which it shows."""

    telemetry = {"largest_error_rad": "rad", "ticks": ""}

    def __init__(self):
        self.largest = 0.0
        self.ticks = 0

    def tick(self, tick, measured, wanted, reference):
        error = wanted.attitude_rad - measured.attitude_rad
        self.largest = max(self.largest, float(np.abs(error).max()))
        self.ticks += 1
        return (*angles(tick, measured, wanted, reference), [self.largest, self.ticks])


def position(tick, measured, reference):
    """A proportional law for position and velocity, with the small-angle inverse."""
    error = reference.position_w_m - measured.position_w_m
    slide = reference.velocity_w_m_s - measured.velocity_w_m_s
    ax, ay, az = 2.0 * error + 2.0 * slide + reference.acceleration_w_m_s2
    yaw = reference.yaw_rad
    roll = (ax * np.sin(yaw) - ay * np.cos(yaw)) / 9.8
    pitch = (ax * np.cos(yaw) + ay * np.sin(yaw)) / 9.8
    return 0.52 * (9.8 + az), np.array([roll, pitch, yaw]), np.zeros(3), np.zeros(3)


def test_functions_fly_both_loops():
    flight = ironbird.simulate("hover", 8, outer=position, inner=angles)
    assert flight.end == "completed" and flight.position_error_m[-1] < 0.03
    assert flight.laws == {"outer": "position", "inner": "angles", "mixer": "roll_pitch_first"}
    assert np.all(flight.wrench.mode == 0) and len(flight.theorem) == 0
    assert ironbird.simulate("hover", 8, outer=position, inner=angles).fingerprint == flight.fingerprint


def test_an_object_shows_its_telemetry():
    law = Angles()
    flight = ironbird.simulate("lissajous", 1, inner=law)
    assert law.ticks == 1001 and flight.telemetry.inner.ticks.tolist() == list(range(1, 1002))
    assert flight.telemetry.inner.largest_error_rad[-1] == law.largest
    assert flight.units["telemetry.inner.largest_error_rad"] == "rad"
    assert flight.fingerprint != ironbird.simulate("lissajous", 1, inner=angles).fingerprint, "telemetry is output"
    bare = ironbird.simulate("lissajous", 1, inner=angles)
    assert np.array_equal(bare.state.position_w_m, flight.state.position_w_m)


def test_a_law_is_given_what_the_flight_records():
    seen = []

    def law(tick, measured, wanted, reference):
        seen.append((tick, measured, wanted, reference))
        return angles(tick, measured, wanted, reference)

    flight = ironbird.simulate("lissajous", 0.1, inner=law)
    assert [tick for tick, *_ in seen] == list(range(101))
    for tick, measured, wanted, reference in seen:
        assert (measured.age, wanted.age) == (0, 0)
        for given, recorded in [(measured, flight.state), (wanted, flight.setpoint), (reference, flight.reference)]:
            for name in (name for name in recorded if hasattr(given, name)):
                assert np.array_equal(getattr(given, name), recorded[name][tick]), name
        command = measured.given
        assert command.age == (1 if tick else None) and command.saturated is False
        assert command.other_law is False
        if tick:
            for name in ("thrust_n", "torque_b_nm"):
                assert np.array_equal(getattr(command, name), flight.rotor_speeds[name][tick - 1]), name
    assert isinstance(seen[0][3].yaw_rad, float) and isinstance(seen[0][2].limited, bool)
    with pytest.raises(AttributeError, match="Measured has no `position`; it has position_w_m, velocity_w_m_s, .*, age, given$"):
        seen[0][1].position


def test_arrays_are_the_laws_own():
    kept = []

    def law(tick, measured, wanted, reference):
        kept.append(measured.position_w_m)
        measured.position_w_m[:] = 1e9
        return angles(tick, measured, wanted, reference)

    flight = ironbird.simulate("lissajous", 0.1, inner=law)
    assert np.array_equal(np.array(kept), flight.state.position_w_m)


def test_an_exception_comes_through_with_its_own_traceback():
    def broken(tick, measured, wanted, reference):
        if tick == 12:
            raise KeyError("gain")
        return angles(tick, measured, wanted, reference)

    with pytest.raises(KeyError, match="gain") as raised:
        ironbird.simulate("hover", 1, inner=broken)
    frames = traceback.extract_tb(raised.value.__traceback__)
    assert (frames[-1].name, frames[-1].line) == ("broken", 'raise KeyError("gain")')


@pytest.mark.parametrize(
    ("answer", "error", "said"),
    [
        (None, TypeError, r"gave nothing; return \(thrust_n, torque_b_nm\[3\]\)"),
        (5.0, TypeError, r"gave a value of type float; return \(thrust_n, torque_b_nm\[3\]\)"),
        ((5.0,), TypeError, r"gave a value of type tuple of length 1; return \(thrust_n, torque_b_nm\[3\]\)"),
        (np.zeros(3), TypeError, r"gave a value of type ndarray of length 3; return \(thrust_n, torque_b_nm\[3\]\)"),
        ((5.0, [0, 0, 0], [1]), TypeError, r"gave a value of type tuple of length 3; return \(thrust_n, torque_b_nm\[3\]\)"),
        (("5 N", [0, 0, 0]), ValueError, r"gave thrust_n = '5 N'; expected a finite number"),
        ((5.0, [0, 0]), ValueError, r"gave torque_b_nm = \[0, 0\]; expected three finite numbers"),
        ((5.0, np.array([0, np.nan, 0])), ValueError, r"gave torque_b_nm = array\(\[ 0., nan,  0.\]\); expected three"),
        ((np.inf, [0, 0, 0]), ValueError, r"gave thrust_n = inf; expected a finite number"),
    ],
)
def test_an_answer_that_is_none_is_told_with_its_place(answer, error, said):
    def law(tick, measured, wanted, reference):
        return answer if tick == 3 else angles(tick, measured, wanted, reference)

    line = law.__code__.co_firstlineno
    with pytest.raises(error, match=rf"test_laws.py:{line}: `law` at tick 3 {said}"):
        ironbird.simulate("hover", 1, inner=law)


def test_telemetry_has_a_number_for_each_name():
    class Two(Angles):
        telemetry = ("a", "b", "c")

    with pytest.raises(ValueError, match=r"`Two` at tick 0 gave telemetry = \[.*\]; return telemetry\[3\], a number for each name"):
        ironbird.simulate("hover", 1, inner=Two())
    snake = "write it in snake_case, with at most 40 letters"
    for telemetry, said in [
        (["A b"], f"telemetry has 'A b': {snake}, without the capital 'A'$"),
        ({"Err": "rad"}, f"telemetry has 'Err': {snake}, without the capital 'E'$"),
        ({"a b": "rad"}, f"telemetry has 'a b': {snake}, without ' '$"),
        (["1st"], f"telemetry has '1st': {snake}, and a letter first$"),
        ([""], f"telemetry has '': {snake}, and a letter first$"),
        (["a" * 41], f"telemetry has '{'a' * 41}': {snake}$"),
        ([3], "telemetry has 3: '': write names and units as {'tilt_rad': 'rad'}$"),
        ({"tilt_rad": 1}, "telemetry has 'tilt_rad': 1: write names and units as {'tilt_rad': 'rad'}$"),
    ]:
        with pytest.raises(ironbird.SettingsError, match=said):
            ironbird.simulate("hover", 1, inner=type("Odd", (Angles,), {"telemetry": telemetry})())


def test_an_outer_answer_is_told_too():
    with pytest.raises(TypeError, match=r"gave a value of type tuple of length 2; return \(thrust_n, attitude_rad\[3\], attitude_rate_rad_s\[3\], "):
        ironbird.simulate("hover", 1, outer=lambda tick, measured, reference: (5.0, [0, 0, 0]))


def test_a_file_may_define_dataclasses(tmp_path):
    file = tmp_path / "json.py"
    file.write_text(
        "from __future__ import annotations\n"
        "from dataclasses import dataclass\n\n"
        "@dataclass\n"
        "class Gains:\n"
        "    angle_1_s2: float = 100.0\n\n"
        "class Law:\n"
        "    role = 'inner'\n"
        "    def tick(self, tick, measured, wanted, reference):\n"
        "        error = wanted.attitude_rad - measured.attitude_rad\n"
        "        return wanted.thrust_n, 0.004 * Gains().angle_1_s2 * error\n"
    )
    assert ironbird.simulate("hover", 0.1, inner=str(file)).laws["inner"] == "law"
    assert sys.modules.get("json") is not sys.modules[str(file)], "a module of the same name is not hidden"


def test_what_is_no_law_is_refused():
    with pytest.raises(TypeError, match="inner: expected a function, an object with `tick`"):
        ironbird.simulate("hover", 1, inner=3.0)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="mixer: expected the name of a law, not function"):
        ironbird.simulate("hover", 1, mixer=angles)  # type: ignore[arg-type]
    for settings in (3, {"inner": 3}, [("plant", {})]):
        with pytest.raises(TypeError, match=r"settings: expected sections with their keys, .*, not "):
            ironbird.simulate("hover", 1, settings=settings)  # type: ignore[arg-type]
    with pytest.raises(ironbird.SettingsError, match="flight.faults = 3: expected a list of strings"):
        ironbird.simulate("hover", 1, faults=3)  # type: ignore[arg-type]
    with pytest.raises(ironbird.SettingsError, match="settings: inner.alpha_1_s: the law `angles` has no such setting"):
        ironbird.simulate("hover", 1, inner=angles, settings={"inner": {"alpha_1_s": 3.0}})


LAW = """
class Law:
    role = "inner"
    name = "%s"
    settings = {"alpha_1_s": 100.0}

    def __init__(self, rig, settings):
        self.gain = 0.00004 * settings["alpha_1_s"]

    def tick(self, tick, measured, wanted, reference):
        error = wanted.attitude_rad - measured.attitude_rad
        return wanted.thrust_n, self.gain * error - 0.08 * measured.rate_b_rad_s
"""


def test_settings_of_another_law_are_not_a_law_of_pythons(tmp_path):
    one, two = tmp_path / "one.py", tmp_path / "two.py"
    one.write_text(LAW % "one")
    two.write_text(LAW % "two")
    of_one = ironbird.simulate("hover", 0.1, inner=str(one)).settings
    of_rig = ironbird.simulate("hover", 0.1).settings
    scope: dict = {}
    exec(LAW % "two", scope)
    for settings, law in [(of_rig, "adaptive"), (of_one, str(one))]:
        for inner, named in [(str(two), str(two)), (scope["Law"], "two")]:
            said = f'settings: its section [inner] is of the law `{law}`, and would go before those of inner="{named}"'
            with pytest.raises(ironbird.SettingsError, match=re.escape(said)):
                ironbird.simulate(settings=settings, inner=inner)
    said = re.escape(f'is of the law `{one}`, and would go before those of inner="pid"')
    with pytest.raises(ironbird.SettingsError, match=said):
        ironbird.simulate(settings=of_one, inner="pid")
    # A name alone is no setting, and its sum goes with it.
    bare = of_one | {"inner": {key: of_one["inner"][key] for key in ("law", "sha256")}}
    for inner, name in [(str(two), "two"), (scope["Law"], "two"), ("pid", "pid")]:
        assert ironbird.simulate(settings=bare, inner=inner).laws["inner"] == name
    # The same law is meant, by whatever path.
    again = ironbird.simulate(settings=of_one, inner=f"{tmp_path}/./one.py")
    assert again.settings["inner"] == of_one["inner"]
    by_class = ironbird.simulate("hover", 0.1, inner=scope["Law"])
    assert ironbird.simulate(settings=by_class.settings, inner=scope["Law"]).fingerprint == by_class.fingerprint


def test_a_file_that_has_changed_is_refused_by_both_sums(tmp_path, monkeypatch):
    file = tmp_path / "one.py"
    file.write_text(LAW % "one")
    monkeypatch.chdir(tmp_path)
    flight = ironbird.simulate("hover", 0.1, inner="one.py")
    old = hashlib.sha256(file.read_bytes()).hexdigest()
    assert (flight.settings["inner"]["law"], flight.settings["inner"]["sha256"]) == (str(file.resolve()), old)
    monkeypatch.chdir("/")
    assert ironbird.simulate(settings=flight.settings).fingerprint == flight.fingerprint
    file.write_text((LAW % "one").replace("100.0", "90.0"))
    new = hashlib.sha256(file.read_bytes()).hexdigest()
    path = file.resolve()
    said = f"the inner law {path}: its SHA-256 is {new}, but the settings were made for {path} with {old}"
    for arguments in ({}, {"inner": str(file)}):
        with pytest.raises(ironbird.SettingsError, match=said) as raised:
            ironbird.simulate(settings=flight.settings, **arguments)
        assert "or take inner.sha256 out of the settings" in str(raised.value)
    section = {key: value for key, value in flight.settings["inner"].items() if key != "sha256"}
    assert ironbird.simulate(settings=flight.settings | {"inner": section}).settings["inner"]["sha256"] == new
