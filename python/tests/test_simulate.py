"""`ironbird.simulate` with laws of the rig: the flight of the executable, bit for bit, as arrays."""

import pickle
import re
import signal
import subprocess
import sys
import threading
import time
import typing

import numpy as np
import pytest

import ironbird
from ironbird import flight as groups


@pytest.mark.parametrize(
    ("keywords", "flags"),
    [
        ({"trajectory": "lissajous", "duration_s": 2}, ["--trajectory", "lissajous", "--duration", "2s"]),
        (
            {"trajectory": "helix", "duration_s": 3, "inner": "indi", "outer": "estimating", "faults": ["mass_kg=+30%@1s"]},
            ["--trajectory", "helix", "--duration", "3s", "--inner", "indi", "--outer", "estimating"]
            + ["--fault", "mass_kg=+30%@1s"],
        ),
        (
            {"trajectory": "hover", "duration_s": 1, "airframe": "crazyflie"},
            ["--trajectory", "hover", "--duration", "1s", "--airframe", "crazyflie"],
        ),
    ],
)
def test_a_flight_is_that_of_the_executable(ironbird_command, keywords, flags):
    result = ironbird_command("simulate", *flags).stdout
    flight = ironbird.simulate(**keywords)
    assert f"ticks={len(flight.t)} outputs={flight.fingerprint} " in result


def test_an_unknown_keyword_gets_the_nearest_one():
    for call, said in [
        (lambda: ironbird.simulate(fault="mass_kg=+30%@8s"), r"simulate\(\) has no keyword `fault`; did you mean `faults`\?"),
        (lambda: ironbird.simulate(duration=1), "did you mean `duration_s`"),
        (lambda: ironbird.read(where="runs"), "read.. has no keyword `where`; there are run, out$"),
    ]:
        with pytest.raises(TypeError, match=said):
            call()


def test_arrays_have_a_row_per_tick_and_a_unit():
    flight = ironbird.simulate("lissajous", 0.5, faults=["mass_kg=0.6,rotor_efficiency_3=0.9@200ms"])
    assert flight.t.tolist() == [tick * 1e-3 for tick in range(501)]
    assert flight.state.position_w_m.shape == (501, 3)
    assert flight.state.attitude_quaternion.shape == (501, 4)
    assert flight.wrench.thrust_n.shape == (501,)
    assert flight.telemetry.inner.rotational_drag_nm_s.shape == (501,)
    assert flight.units["state.velocity_w_m_s"] == "m/s"
    assert flight.units["truth.mass_kg"] == "kg"
    assert flight.units["telemetry.inner.rotational_drag_nm_s"] == "N m s"
    assert (flight.units["state.command_tick"], flight.units["wrench.mode"]) == ("tick", "")
    # The state of a tick knows the swap that holds from it on.
    assert [flight.truth.mass_kg[tick] for tick in (199, 200)] == [0.52, 0.6]
    assert ironbird.simulate("lissajous", 0.5, faults="mass_kg=0.6@200ms").faults[0].parameter == "mass_kg"
    faults = [(fault.tick, fault.t, fault.parameter, fault.old, fault.new) for fault in flight.faults]
    assert faults == [(200, 0.2, "mass_kg", 0.52, 0.6), (200, 0.2, "rotor_efficiency_3", 1.0, 0.9)]
    assert [(it.t, it.over_s) for it in ironbird.simulate("hover", 0.2, faults="mass_kg=0.6~50ms@100ms").faults] == [(0.1, 0.05)]
    # Before the first command there is no tick of one.
    assert np.isnan(flight.state.command_tick[0]) and flight.state.command_tick[1] == 0
    assert flight.laws == {"outer": "pd", "inner": "adaptive", "mixer": "roll_pitch_first"}
    assert (flight.end, flight.trajectory, flight.period_s) == ("completed", "lissajous", 1e-3)
    assert len(flight.timing) == 0 and flight.theorem.v_th.shape == (501,)

@pytest.mark.parametrize(
    "fault",
    [
        "plant.position_noise_m=0.05",
        # The outer law publishes nothing from then on.
        "outer.state.drop=1@500ms",
        "plant.stop=100ms@500ms",
    ],
)
def test_the_error_is_that_of_the_true_position_in_every_state(ironbird_command, fault):
    name, value = fault.split("=")
    is_setting = "@" not in fault
    keywords = {"settings": {"plant": {name.split(".")[1]: float(value)}}} if is_setting else {"faults": fault}
    flight = ironbird.simulate("fast", 1, **keywords)
    simulated = ironbird_command(*f"simulate --trajectory fast --duration 1s {'--set' if is_setting else '--fault'} {fault}".split())
    errors = {name: float(re.search(rf"{name}=(\S+)", simulated.stdout)[1]) for name in ("position_error_m", "yaw_error_rad")}
    assert flight.tick[-1] == 1000 and flight.t[-1] == 1.0
    assert abs(flight.position_error_m.max() - errors["position_error_m"]) <= 5e-5
    assert abs(flight.yaw_error_rad.max() - errors["yaw_error_rad"]) <= 5e-5
    assert f"position error up to {errors['position_error_m']:.4f} m" in flight.verdicts["flight"]


def test_yaw_and_tilt_errors_are_against_the_reference():
    # A steady wind of 2 m/s needs a lean whose tangent is drag over weight.
    flight = ironbird.simulate("hover", 20.0, faults="wind_x_m_s=2@5s")
    assert flight.tilt_error_rad[5001] > 0.3 and flight.tilt_error_rad[-1] < 0.01
    turned = ironbird.simulate("step", 1.0)
    assert abs(turned.yaw_error_rad[0] - 0.5) < 1e-12 and turned.yaw_error_rad[-1] < 0.5


def test_declared_names_are_those_that_there_are():
    flight = ironbird.simulate("hover", 0.01)
    for group in (flight.state, flight.setpoint, flight.reference, flight.wrench, flight.rotor_speeds):
        assert set(typing.get_type_hints(type(group))) == set(group), type(group)
    assert set(typing.get_type_hints(groups.Truth)) < set(flight.truth)
    stub = (groups.__file__ or "").replace("flight.py", "_rig.pyi")
    with open(stub, encoding="utf-8") as file:
        declared = file.read().split("class ")

    def names(of):
        body = next(part for part in declared if part.startswith((of + ":", of + "(Sensors):")))
        inherited = typing.get_type_hints(groups.Sensors) if "(Sensors)" in body else {}
        return {*inherited} | {line.split("(")[0].removeprefix("def ") for line in map(str.strip, body.splitlines()) if "def " in line}

    seen = {}

    def law(tick, measured, wanted, reference):
        seen.update(Measured=measured, Desired=wanted, Reference=reference)
        return wanted.thrust_n, [0.0, 0.0, 0.0]

    ironbird.simulate("hover", 0.01, inner=law)
    for name, thing in seen.items():
        public = {attribute for attribute in dir(thing) if not attribute.startswith("_")}
        assert public == names(name), name


def test_why_a_flight_ended_is_told():
    flight = ironbird.simulate("lissajous", 20, faults=["mass_kg=+300%@1s"])
    assert flight.end.startswith("the flight left its envelope") or "ground" in flight.end
    assert len(flight.t) < 20_001


@pytest.mark.parametrize(
    ("keywords", "flags"),
    [
        ({"duration_s": 0.0}, ["--duration", "0s"]),
        ({"airframe": "zeppelin"}, ["--airframe", "zeppelin"]),
        ({"duration_s": 1, "faults": ["mass_kg=0.6@8s"]}, ["--duration", "1s", "--fault", "mass_kg=0.6@8s"]),
        ({"faults": ["mass_kg=99@1s"]}, ["--fault", "mass_kg=99@1s"]),
        ({"trajectory": "nowhere.csv"}, ["--trajectory", "nowhere.csv"]),
        ({"inner": "adaptiv"}, ["--inner", "adaptiv"]),
        ({"preset": "calm"}, ["--preset", "calm"]),
    ],
)
def test_a_mistake_is_told_as_the_executable_tells_it(ironbird_command, keywords, flags):
    result = ironbird_command("simulate", *flags)
    with pytest.raises(ironbird.SettingsError) as raised:
        ironbird.simulate(**keywords)
    assert (result.returncode, result.stderr) == (2, f"error: {raised.value}\n")


@pytest.mark.parametrize(
    "settings",
    [
        {"inner": {"alfa_1_s": 3.0}},
        {"inner": {"alpha_1_s": -3.0}},
        {"inner": {"law": "adaptiv"}},
        {"flight": {"preset": "calm"}},
        {"flight": {"period_s": "short"}},
        {"flights": {"period_s": 1e-3}},
        {"rotor": {"min_rad_s": 900.0}},
    ],
)
def test_a_setting_is_refused_as_that_of_a_file(ironbird_command, tmp_path, settings):
    lines = [f"[{section}]\n{key} = {value!r}" for section, keys in settings.items() for key, value in keys.items()]
    (tmp_path / "s.toml").write_text("\n".join(lines))
    result = ironbird_command("simulate", "--config", "s.toml").stderr
    with pytest.raises(ironbird.SettingsError) as raised:
        ironbird.simulate(settings=settings)
    message, _, hint = result.removeprefix("error: ").partition("\n")
    message = message.replace("settings file s.toml:", "settings:").removesuffix(" (settings file s.toml)")
    assert str(raised.value) == f"{message}\n{hint}".rstrip()


def test_what_no_setting_can_be_is_refused_by_its_key():
    for settings, said in [
        ({"flight": {"seed": None}}, "settings: flight.seed = None: expected a number, a string, a list or a dict"),
        ({"flight": {3: 1}}, "settings: the key 3 is no string"),
        ({"flight": {"seed": 2**70}}, "flight.seed"),
    ]:
        with pytest.raises(ironbird.SettingsError, match=said.replace("(", r"\(")):
            ironbird.simulate(settings=settings)


def test_an_argument_of_another_type_is_refused_by_its_key():
    for arguments, said in [
        ({"duration_s": "long"}, 'settings: flight.duration_s = "long": expected a number, as in 30.0'),
        ({"preset": 3}, 'settings: flight.preset = 3: expected a string, as in "flight"'),
        ({"faults": [3]}, r"settings: flight.faults = \[3\]: expected a list of strings"),
    ]:
        with pytest.raises(ironbird.SettingsError, match=said):
            ironbird.simulate("hover", **arguments)


def test_settings_of_one_law_airframe_or_preset_are_not_mixed_with_another():
    settings = ironbird.simulate("hover", 0.01).settings
    for arguments, said in [
        ({"inner": "fixed"}, 'its section [inner] is of the law `adaptive`, and would go before those of inner="fixed"'),
        ({"airframe": "x500"}, 'of the airframe `paper`, and would go before those of airframe="x500"'),
        ({"preset": "soft"}, 'of the preset `flight`, and would go before those of preset="soft"'),
    ]:
        with pytest.raises(ironbird.SettingsError, match=re.escape(said)) as raised:
            ironbird.simulate(settings=settings, **arguments)
        assert "out of the settings, or fly without " in str(raised.value), raised.value
        assert "--" not in str(raised.value), "in Python there are no flags"
    same = {"outer": "pd", "inner": "adaptive", "airframe": "paper", "preset": "flight"}
    again = ironbird.simulate(settings=settings, **same)
    assert again.fingerprint == ironbird.simulate("hover", 0.01).fingerprint
    others = {section: keys for section, keys in settings.items() if section != "inner"}
    fixed = ironbird.simulate(settings=others, inner="fixed")
    assert fixed.fingerprint == ironbird.simulate("hover", 0.01, inner="fixed").fingerprint


def test_a_flight_that_does_not_fit_into_memory_is_refused_before_it_begins():
    begun = time.monotonic()
    with pytest.raises(MemoryError) as raised:
        ironbird.simulate("hover", 30 * 86_400)
    assert time.monotonic() - begun < 5
    words = r"2592000001 ticks take (\d+) bytes, and (\d+) are available: fly shorter, .* `ironbird simulate --states FILE`"
    said = re.match(words, str(raised.value))
    assert said and int(said[1]) > 2_592_000_001 * 1000 and int(said[1]) > int(said[2]), raised.value


def test_a_flight_takes_the_memory_that_is_said():
    # What may be mapped beside what already is: enough for half of it.
    script = """
import re, resource, ironbird
ironbird.simulate("hover", 0.01)
mapped = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (mapped + 50_000_000, mapped + 50_000_000))
try:
    ironbird.simulate("hover", 100)
except MemoryError as error:
    print(error)
"""
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert result.returncode == 0 and re.match(r"100001 ticks take \d+ bytes, ", result.stdout), result


def test_settings_of_a_flight_fly_it_again(tmp_path):
    flight = ironbird.simulate("lissajous", 1, seed=7, settings={"plant": {"gyro_noise_rad_s": 0.01}})
    again = ironbird.simulate(settings=flight.settings)
    assert again.fingerprint == flight.fingerprint
    assert ironbird.simulate(settings=flight.settings, seed=8).fingerprint != flight.fingerprint


def test_numbers_of_numpy_and_paths_are_settings(tmp_path):
    points = tmp_path / "points.csv"
    points.write_text("t,x,y,z,yaw\n" + "".join(f"{t},0,0,{1 + 0.1 * t},0\n" for t in range(8)))
    settings = {"outer": {"velocity_1_s": np.float64(3.0)}, "flight": {"seed": np.int64(3)}}
    flight = ironbird.simulate(points, np.float32(1.0), settings=settings)
    assert (flight.trajectory, flight.settings["flight"]["seed"]) == ("points.csv", 3)
    assert flight.settings["outer"]["velocity_1_s"] == 3.0


def test_a_flight_can_be_pickled_and_shown():
    flight = ironbird.simulate("hover", 0.1)
    again = pickle.loads(pickle.dumps(flight))
    assert np.array_equal(again.state.position_w_m, flight.state.position_w_m)
    assert repr(again) == f"<Flight hover, 101 ticks, pd + adaptive + roll_pitch_first: completed, outputs {flight.fingerprint}>"
    with pytest.raises(AttributeError, match="State has no 'positon_w_m'; there are position_w_m, "):
        flight.state.positon_w_m


def test_a_key_that_is_not_there_is_told_with_those_that_are():
    flight = ironbird.simulate("hover", 0.01, inner="pid")
    assert len(flight.telemetry.inner) > 0
    for ask, said in [
        (lambda: flight.state["x"], f"State has no 'x'; there are {', '.join(flight.state)}"),
        (lambda: flight.telemetry.inner["x"], f"Group has no 'x'; there are {', '.join(flight.telemetry.inner)}"),
        (lambda: flight.theorem["v_th"], "Group has no 'v_th'; it is empty"),
        (lambda: flight.units["state.position_m"], "units has no 'state.position_m'; the nearest are state.position_w_m, "),
    ]:
        with pytest.raises(KeyError) as raised:
            ask()
        assert raised.value.args[0].startswith(said), raised.value
    with pytest.raises(AttributeError, match="Group has no 'v_th'; it is empty"):
        flight.theorem.v_th
    assert flight.state.get("x") is None and flight.units.get("x") is None and "x" not in flight.units
    assert pickle.loads(pickle.dumps(flight)).units == flight.units


def test_others_run_while_laws_of_the_rig_fly():
    counted = 0
    over = threading.Event()

    def count():
        nonlocal counted
        while not over.is_set():
            counted += 1
            time.sleep(1e-3)

    other = threading.Thread(target=count)
    other.start()
    before = counted
    ironbird.simulate("lissajous", 60)
    during = counted - before
    over.set()
    other.join()
    # A thread that holds the interpreter for the whole flight lets no other one count at all.
    assert during >= 3


def test_ctrl_c_ends_a_flight():
    # Tests that run in the background ignore Ctrl-C.
    script = "import signal, ironbird; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    script += "print('flies', flush=True); ironbird.simulate('hover', 5000)"
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "flies\n"
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert said.rstrip().endswith("KeyboardInterrupt")


def test_settings_that_contain_themselves_are_refused():
    nested: dict = {}
    nested["a"] = nested
    endless: list = []
    endless.append(endless)
    for settings in [nested, {"plant": {"mass_kg": endless}}]:
        with pytest.raises(ironbird.SettingsError, match="contains itself"):
            ironbird.simulate("hover", 0.1, settings=settings)
