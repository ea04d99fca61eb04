"""Laws of `.py` files in the rig's own processes: `ironbird ... --inner my_law.py`."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import ironbird
from conftest import executable, needs_adapter

pytestmark = needs_adapter
ANGLES = Path(__file__).resolve().parents[1] / "examples" / "angles.py"

OUTER = """
import numpy as np

class Law:
    role = "outer"
    name = "small_angles"
    settings = {"gains_1_s2": [2.0, 2.0, 4.0], "yaw": {"default": "follow", "words": ["north"]}}

    def __init__(self, rig, settings):
        self.rig, self.gains_1_s2, self.yaw = rig, settings["gains_1_s2"], settings["yaw"]

    def tick(self, tick, measured, reference):
        error, slip = reference.position_w_m - measured.position_w_m, reference.velocity_w_m_s - measured.velocity_w_m_s
        ax, ay, az = self.gains_1_s2 * error + 2.5 * slip + reference.acceleration_w_m_s2
        yaw, g = reference.yaw_rad if self.yaw == "follow" else 0.0, self.rig.airframe["gravity_m_s2"]
        roll, pitch = (ax * np.sin(yaw) - ay * np.cos(yaw)) / g, (ax * np.cos(yaw) + ay * np.sin(yaw)) / g
        return self.rig.airframe["mass_kg"] * (g + az), [roll, pitch, yaw], np.zeros(3), np.zeros(3)
"""


def outputs(result: str) -> str:
    return re.findall(r"outputs[ =]([0-9a-f]{16})", result)[-1]


@pytest.fixture
def law(tmp_path):
    """Writes a law's file."""

    def write(text: str, name: str = "my_law.py") -> Path:
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return write


def test_a_file_flies_the_same_everywhere(ironbird_command, tmp_path):
    flags = ["--inner", ANGLES, "--trajectory", "lissajous", "--duration", "2s"]
    simulated = ironbird_command("simulate", *flags)
    assert simulated.returncode == 0, simulated.stderr
    flown = ironbird_command("fly", *flags, "--pace", "lockstep", "--out", "runs")
    assert flown.returncode == 0, flown.stderr
    replayed = ironbird_command("replay", "--verify", "--out", "runs")
    assert "identical" in replayed.stdout, replayed.stderr
    module = ironbird.simulate("lissajous", 2, inner=str(ANGLES))
    assert outputs(simulated.stdout) == outputs(replayed.stdout) == module.fingerprint
    again = ironbird.simulate(settings=module.settings)
    assert again.fingerprint == module.fingerprint
    # Also as the class that stands in the file.
    scope: dict = {}
    exec(compile(ANGLES.read_text(), str(ANGLES), "exec"), scope)
    assert ironbird.simulate("lissajous", 2, inner=scope["Law"]).fingerprint == module.fingerprint
    read = ironbird.read(tmp_path / "runs" / "latest")
    assert (read.fingerprint, read.laws["inner"]) == (module.fingerprint, "angles.py")
    # To read a flight runs no law's code, and only that knows the names of what it shows.
    shown = read.telemetry.inner["value"]
    assert shown.shape == (2001, 32) and np.array_equal(shown[:, 0], module.telemetry.inner["largest_error_rad"])


def test_settings_reach_a_law(ironbird_command, law, tmp_path):
    file = law(OUTER)
    (tmp_path / "s.toml").write_text('[outer]\nlaw = "my_law.py"\ngains_1_s2 = [1.0, 1.0, 3.0]\nyaw = "north"\n')
    result = ironbird_command("simulate", "--config", "s.toml", "--duration", "2s")
    assert result.returncode == 0, result.stderr
    own = {"gains_1_s2": [1.0, 1.0, 3.0], "yaw": "north"}
    module = ironbird.simulate(duration_s=2, outer=str(file), settings={"outer": own})
    assert outputs(result.stdout) == module.fingerprint
    assert ironbird.simulate(duration_s=2, outer=str(file)).fingerprint != module.fingerprint
    for key, value, said in [
        ("gains_1_s2", "[1.0, 1.0]", "a list of 3 numbers"),
        ("yaw", '"south"', 'allowed is "follow" or "north"'),
        ("gain", "1.0", "unknown key `outer.gain`"),
    ]:
        (tmp_path / "s.toml").write_text(f'[outer]\nlaw = "my_law.py"\n{key} = {value}\n')
        result = ironbird_command("simulate", "--config", "s.toml")
        assert result.returncode == 2 and said in result.stderr, result.stderr
    for key, given, said in [
        ("gains_1_s2", [1.0], r"settings: outer.gains_1_s2 = \[1.0\]: expected three numbers"),
        ("yaw", "south", r"outer.yaw = 'south' is out of range: allowed is 'follow' or 'north'"),
        ("gain", 1.0, r"outer.gain: the law `small_angles` has no such setting"),
    ]:
        with pytest.raises(ironbird.SettingsError, match=said):
            ironbird.simulate(outer=str(file), settings={"outer": {key: given}})
    with pytest.raises(ironbird.SettingsError, match=r"inner.rate_1_s = 900.0 is out of range: allowed is 0 to 200 1/s"):
        ironbird.simulate(inner=str(ANGLES), settings={"inner": {"rate_1_s": 900.0}})


def test_a_law_of_a_file_is_explained_and_labelled(ironbird_command, tmp_path):
    result = ironbird_command("laws", ANGLES).stdout
    assert "angles: Proportional control of angles and body rates." in result
    assert "attitude_1_s2 = 100.0 [1/s^2]" in result and "gain of the angles; allowed: 0 to 1000 1/s^2" in result
    assert "largest_error_rad [rad]" in result and "not real-time" in result
    flown = ironbird_command("fly", "--inner", ANGLES, "--duration", "1s", "--rt", "off", "--out", "runs")
    assert "warning: the inner law `angles`" in flown.stderr and "is not real-time" in flown.stderr
    report = tmp_path / "runs" / "latest"
    assert "inner angles (angles.py, not real-time)" in (report / "report.txt").read_text()
    laws = json.loads((report / "report.json").read_text())["run"]["laws"]
    assert laws["inner"]["not_real_time"] and not laws["outer"]["not_real_time"]
    assert "identical" in ironbird_command("replay", "--verify", "--out", "runs").stdout


TICK = "    def tick(self, tick, measured, wanted, reference):\n"
LEVEL = TICK + "        return wanted.thrust_n, [0, 0, 0]\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("class Law:\n    def tick(self:\n", "my_law.py:2: "),
        ("import numpy\n\nraise RuntimeError('no table')\n", "my_law.py:3: RuntimeError: no table"),
        ("import nonesuch\n", "my_law.py:1: ModuleNotFoundError: No module named 'nonesuch'"),
        ("import sys\nsys.exit(3)\n", "my_law.py:2: SystemExit: 3"),
        ("gain = 3\n", "a law is the class `Law`, or the only class with a `tick`; the file has none"),
        (f"class A:\n{LEVEL}\nclass B:\n{LEVEL}", "the file has 2: A, B"),
        (f"class Law:\n{LEVEL}", "my_law.py:1: Law.role = None: write role = 'outer' or role = 'inner'"),
        (
            f"class Law:\n    role = 'inner'\n    name = 'My law'\n{LEVEL}",
            "my_law.py:3: name = 'My law': write it in snake_case, with at most 40 letters, without the capital 'M'",
        ),
        (f"class Law:\n    role = 'inner'\n    settings = [1]\n{LEVEL}", "my_law.py:3: settings = [1]: expected a dict"),
        (
            f"class Law:\n    role = 'inner'\n    settings = {{'gain': {{'default': 3, 'max': 2}}}}\n{LEVEL}",
            "my_law.py:3: settings['gain'] has default = 3, which is not within",
        ),
        (
            f"class Law:\n    role = 'inner'\n    settings = {{'gain': {{'value': 3}}}}\n{LEVEL}",
            "my_law.py:3: settings['gain'] has an unknown key 'value': its keys are default, min, max, words",
        ),
        (
            f"class Law:\n    role = 'inner'\n    settings = {{'law': 3}}\n{LEVEL}",
            "my_law.py:3: settings has the name 'law'",
        ),
        (
            f"class Law:\n    role = 'inner'\n    settings = {{'gain': None}}\n{LEVEL}",
            "my_law.py:3: settings['gain'] has default = None: write a number, three of them, or a word",
        ),
        (
            f"class Law:\n    role = 'inner'\n    settings = {{\n        'Gain': 3,\n    }}\n{LEVEL}",
            "my_law.py:3: settings has the name 'Gain': write it in snake_case, with at most 40 letters, without the capital",
        ),
        (
            f"class Base:\n    telemetry: dict = {{'Err': 'rad'}}\n\nclass Law(Base):\n    role = 'inner'\n{LEVEL}",
            "my_law.py:2: telemetry has 'Err': write it in snake_case, with at most 40 letters, without the capital 'E'",
        ),
        (f"class Law:\n    role = 'middle'\n{LEVEL}", "my_law.py:2: Law.role = 'middle': write role = 'outer' or"),
        (f"class Law:\n    role = 'inner'\n    version = 2\n{LEVEL}", "my_law.py:3: version = 2: expected a string"),
        (f"class Law:\n    role = 'inner'\n    telemetry = ['a b']\n{LEVEL}", "my_law.py:3: telemetry has 'a b'"),
        (
            f"class Law:\n    role = 'inner'\n    def __init__(self, rig, settings):\n        rig.mass\n{LEVEL}",
            "my_law.py:4: AttributeError: 'ironbird.Rig' object has no attribute 'mass'",
        ),
        (f"class Law:\n    role = 'outer'\n{LEVEL}", "is a law of the role outer, and not of inner"),
    ],
)
def test_what_is_wrong_with_a_file_is_told_before_take_off(ironbird_command, law, text, said):
    file = law(text)
    result = ironbird_command("simulate", "--inner", file)
    assert result.returncode == 2 and said in result.stderr, result.stderr
    assert not result.stdout
    # In a notebook an exception of the law's own keeps its type, and its place in the traceback.
    own = "my_law.py:4: AttributeError: "
    with pytest.raises(AttributeError if own in said else ironbird.SettingsError) as raised:
        ironbird.simulate("hover", 1, inner=str(file))
    assert said.removeprefix(own) in str(raised.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "the file has none"),
        ("x = " + "(" * 100_000, "my_law.py:1: too many nested parentheses"),
        ("def f(): f()\nf()\n", "RecursionError: maximum recursion depth exceeded"),
        ("raise ValueError('x' * 1_000_000)\n", "my_law.py:1: ValueError: xxx"),
        ("raise ValueError('\\x1b[2J')\n", "my_law.py:1: ValueError: \\u001b[2J"),
    ],
)
def test_a_broken_file_is_refused_in_few_words(ironbird_command, law, text, said):
    result = ironbird_command("simulate", "--inner", law(text))
    assert result.returncode == 2 and said in result.stderr, result.stderr
    assert len(result.stderr) < 4000


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ("{}['gain']", "{file}:6: KeyError: 'gain'"),
        ("None", "TypeError: {file}:3: `law` at tick 300 gave nothing; return (thrust_n, torque_b_nm[3])"),
        ("(5.0, [0, float('nan'), 0])", "ValueError: {file}:3: `law` at tick 300 gave torque_b_nm = [0, nan, 0]; expected"),
        ("sys.exit('enough')", "{file}:6: SystemExit: enough"),
    ],
)
def test_an_exception_in_flight_ends_the_role_with_its_traceback(ironbird_command, law, tmp_path, answer, said):
    text = "class Law:\n    role = 'inner'\n" + TICK
    text += f"        import sys\n        if tick == 300:\n            return {answer}\n"
    file = law(text + "        return wanted.thrust_n, [0, 0, 0]\n")
    said = said.replace("{file}", str(file))
    named = f"error: the inner law `law` ({file}:3) failed in tick 300: {said}"
    simulated = ironbird_command("simulate", "--inner", file)
    assert simulated.returncode == 1 and named in simulated.stderr and not simulated.stdout
    flags = ["--inner", file, "--pace", "lockstep", "--duration", "2s", "--out", "runs"]
    flown = ironbird_command("fly", *flags)
    assert flown.returncode == 1 and named in flown.stderr, flown.stderr
    run = tmp_path / "runs" / "latest"
    for name in ("report.txt", "report.json", "report.html"):
        report = (run / name).read_text().replace("&#39;", "'").replace("&quot;", '"')
        assert "failed in tick 300" in report and "the inner process, which flew the law `law`" in report, name
    verdict = json.loads((run / "report.json").read_text())["words"]["flight"]["why"]
    assert verdict.startswith(f"aborted after 301 ticks (0.301 s): {named.removeprefix('error: ')}"), verdict
    if answer != "None" and "nan" not in answer:
        words = json.loads((run / "report.json").read_text())["run"]["last_words"]
        assert f'  File "{file}", line 6, in tick' in words, words


@pytest.mark.parametrize(
    ("keeps", "methods", "said"),
    [
        ("0", "", "restored     yes"),
        ("0", "save = lambda self: b'%d' % self.n\n    def load(self, state): self.n = int(state)", "restored     yes"),
        ("0", "save = lambda self: b'0'\n    load = lambda self, state: None", "restored     NO: torque_b_nm about x of input"),
        ("rig", "", "cannot be saved, nor reintegrated after a restart: TypeError: cannot pickle 'ironbird.Rig' object"),
        ("bytes(2000)", "", "ValueError: its state has 20"),
        ("0", "load = lambda self, state: 1 / 0", "restored     NO: it does not load the state that it saved"),
    ],
)
def test_a_law_continues_from_its_saved_state(ironbird_command, law, keeps, methods, said):
    text = "class Law:\n    role = 'inner'\n    def __init__(self, rig, settings):\n"
    text += f"        self.n, self.kept = 0, {keeps}\n    {methods}\n{TICK}        self.n += 1\n"
    result = ironbird_command("laws", law(text + "        return wanted.thrust_n, [self.n, 0, 0]\n"))
    assert said in result.stdout + result.stderr and result.returncode == (3 if "NO" in said else 0), result


def test_what_a_law_prints_does_not_mix_with_the_verdict(ironbird_command, law):
    file = law("class Law:\n    role = 'inner'\n" + TICK + "        print('at', tick)\n" + LEVEL.splitlines()[1] + "\n")
    result = ironbird_command("simulate", "--inner", file, "--duration", "10ms")
    assert result.stderr.splitlines()[-1] == "at 10" and "at 1" not in result.stdout


def test_packages_are_those_of_the_environment(ironbird_command, law, tmp_path, monkeypatch):
    file = law("import sys\n\nclass Law:\n    role = 'inner'\n    summary = sys.prefix\n" + LEVEL)
    monkeypatch.delenv("IRONBIRD_PYTHON", raising=False)
    monkeypatch.setenv("VIRTUAL_ENV", sys.prefix)
    assert f"law: {sys.prefix}" in ironbird_command("laws", file).stdout
    monkeypatch.setenv("IRONBIRD_PYTHON", sys.executable)
    monkeypatch.setenv("VIRTUAL_ENV", "/nowhere")
    assert f"law: {sys.prefix}" in ironbird_command("laws", file).stdout
    monkeypatch.setenv("IRONBIRD_PYTHON", "/nowhere/python")
    result = ironbird_command("laws", file)
    assert result.returncode == 2 and "IRONBIRD_PYTHON leads to /nowhere/python, which is not there" in result.stderr


def test_a_python_without_numpy_is_told(ironbird_command, law, tmp_path, monkeypatch):
    import venv

    venv.create(tmp_path / "bare", with_pip=False)
    monkeypatch.setenv("IRONBIRD_PYTHON", str(tmp_path / "bare/bin/python"))
    result = ironbird_command("laws", ANGLES)
    version = ".".join(map(str, sys.version_info[:3]))
    said = f"Python {version} in {tmp_path / 'bare'} cannot import numpy (ModuleNotFoundError: No module named 'numpy')"
    assert result.returncode == 2 and said in result.stderr, result.stderr


def test_without_the_adapter_it_is_said_how_to_build_it(ironbird_command, tmp_path, monkeypatch):
    monkeypatch.delenv("IRONBIRD_PYTHON_ADAPTER", raising=False)
    shutil.copy(executable(), tmp_path / "ironbird")
    monkeypatch.setenv("IRONBIRD", str(tmp_path / "ironbird"))
    result = ironbird_command("laws", ANGLES)
    assert result.returncode == 2 and "needs libironbird_python.so" in result.stderr and "python/build" in result.stderr
    monkeypatch.setenv("IRONBIRD_PYTHON_ADAPTER", "/nowhere.so")
    result = ironbird_command("laws", ANGLES)
    said = "error: IRONBIRD_PYTHON_ADAPTER names /nowhere.so, and there is no such file\n help: build it: python/build "
    assert result.returncode == 2 and result.stderr.startswith(said) and os.path.exists(ANGLES), result.stderr


HASHED = """
class Law:
    role = "inner"
    name = "hashed"
    telemetry = {"hash_of_a_text": ""}

    def tick(self, tick, measured, wanted, reference):
        return wanted.thrust_n, -0.08 * measured.rate_b_rad_s, [hash("x") % 1_000_003]
"""


def test_the_hash_of_a_text_is_the_same_in_every_process(ironbird_command, law, monkeypatch):
    file = law(HASHED)
    flags = ["--inner", file, "--trajectory", "hover", "--duration", "100ms"]
    monkeypatch.setenv("PYTHONHASHSEED", "7")
    flown = ironbird_command("fly", *flags, "--pace", "lockstep", "--out", "runs")
    monkeypatch.delenv("PYTHONHASHSEED")
    assert "identical" in ironbird_command("replay", "--verify", "--out", "runs").stdout, flown.stderr
    simulated = {outputs(ironbird_command("simulate", *flags).stdout) for _ in range(2)}
    script = f"import ironbird; print('outputs', ironbird.simulate('hover', 0.1, inner={str(file)!r}).fingerprint)"
    monkeypatch.setenv("PYTHONHASHSEED", "0")
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert simulated == {outputs(result)}


def test_settings_of_a_recorded_flight_do_not_fly_a_law_that_has_changed(ironbird_command, law, tmp_path):
    file = law(HASHED)
    flags = ["--inner", file, "--trajectory", "hover", "--duration", "100ms", "--pace", "lockstep", "--out", "runs"]
    assert ironbird_command("fly", *flags).returncode == 0
    settings = ironbird.read(tmp_path / "runs" / "latest").settings
    assert ironbird.simulate(settings=settings).settings["inner"] == settings["inner"]
    law(HASHED.replace("0.08", "0.09"))
    result = ironbird_command("simulate", "--config", tmp_path / "runs" / "latest" / "settings.toml").stderr
    with pytest.raises(ironbird.SettingsError) as raised:
        ironbird.simulate(settings=settings)
    words = str(raised.value).splitlines()
    assert "its SHA-256 is" in words[0] and [f"error: {words[0]}", *words[1:]] == re.sub(
        r" \(settings file .*\)", "", result
    ).splitlines(), result
