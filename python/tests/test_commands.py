"""`fly`, `compare`, `margin`, `campaign`: the executable's results as objects, its errors as exceptions."""

import json
import re
import signal
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path

import pytest

import ironbird
from conftest import ROOT, needs_adapter
from ironbird import command

SMALL = ROOT / "bench" / "cli" / "tests" / "campaigns" / "small.toml"


def test_a_flight_is_the_simulated_one_with_its_report(rig):
    fault = "rotational_drag_nm_s=0.525@400ms"
    flags = {"duration": "1s", "pace": "lockstep", "fault": [fault], "inner": "adaptive", "set": {"inner": {"alpha_1_s": 150}}}
    flown = ironbird.fly(trajectory="lissajous", max_tracking_error=0.1, **flags)
    simulated = ironbird.simulate("lissajous", 1, faults=fault, settings={"inner": {"law": "adaptive", "alpha_1_s": 150.0}})
    assert (flown.fingerprint, flown.status, simulated.status) == (simulated.fingerprint, "PASS", None)
    assert flown.directory == (Path("runs") / "latest").resolve() and flown.report["ticks"]["run"] == 1001
    assert flown.verdicts["flight"].startswith("tracked: position error up to ") and list(simulated.verdicts) == ["flight"]
    # A gate that does not hold is a result.
    assert ironbird.fly(trajectory="lissajous", max_tracking_error=1e-9, **flags).status == "FAIL"


def test_a_flag_whose_value_is_a_truth_has_it(rig):
    flags = subprocess.run([command.executable(), "fly", "--help"], capture_output=True, text=True).stdout
    assert set(re.findall(r"--(\S+) <BOOL>", flags)) == command.BOOLEANS
    assert ironbird.fly(trajectory="hover", duration="50ms", rehearse=False).settings["rt"]["rehearse"] is False


def test_a_lost_flight_is_a_result(rig):
    lost = ironbird.fly(duration="20s", pace="lockstep", fault="mass_kg=+300%@1s")
    assert lost.status == "FAIL" and len(lost.t) < 20_001 and "lost" in lost.verdicts["flight"]


@needs_adapter
def test_a_law_that_fails_in_flight_has_its_traceback_in_the_verdicts(rig):
    law = (ROOT / "python" / "examples" / "angles.py").read_text()
    Path("late.py").write_text(law.replace("        error =", '        assert tick < 100, "too late"\n        error ='))
    flight = ironbird.fly(inner="late.py", duration="1s", pace="lockstep")
    assert flight.status == "ABORTED" and "AssertionError: too late\n" in flight.verdicts["last words"]


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        ({"durration": "1s"}, "unexpected argument '--durration' found"),
        ({"duration": 1}, "time unit needed"),
        ({"inner": "nope.py"}, "cannot read the law nope.py: No such file"),
        ({"fault": "mass_kg=99@1s"}, "mass_kg = 99 is out of range: allowed are 0.05 to 5.0 kg"),
        ({"set": {"inner": {"alpha": 1}}}, "unknown key `inner.alpha` of the law \"adaptive\"; did you mean `alpha_1_s`?"),
    ],
)
def test_a_mistake_is_told_in_the_words_of_the_executable(rig, flags, words):
    with pytest.raises(ironbird.SettingsError) as raised:
        ironbird.fly(**flags)
    assert words in str(raised.value) and not str(raised.value).startswith("error")


def test_a_flag_that_only_prints_is_refused(rig):
    for command in (ironbird.fly, ironbird.compare, ironbird.margin):
        with pytest.raises(TypeError, match="help: this flag prints a text and flies nothing"):
            command(help=True)
    for command in (ironbird.compare, ironbird.margin):
        with pytest.raises(TypeError, match="format: .* returns a table: leave it out"):
            command(format="text")
    with pytest.raises(TypeError, match="run `ironbird fly --print-config`"):
        ironbird.fly(print_config=True)


def test_a_law_without_a_file_is_told_where_it_flies(rig):
    with pytest.raises(TypeError, match="inner: expected .*, not function; .* a function in simulate"):
        ironbird.fly(inner=lambda tick, measured, wanted, reference: None)


def test_what_stands_in_the_way_has_its_exit_code(rig):
    with subprocess.Popen([ironbird.executable(), "fly", "--duration", "1h", "--rt", "off"], stdout=subprocess.DEVNULL) as first:
        while not (Path("runs") / "latest" / "report.json").exists():
            assert first.poll() is None
            time.sleep(0.02)
        with pytest.raises(ironbird.CommandError) as raised:
            ironbird.fly(duration="1s")
        first.send_signal(signal.SIGINT)
    assert raised.value.code == 5 and "default" in str(raised.value)


def test_no_executable_is_told(monkeypatch):
    monkeypatch.setenv("IRONBIRD", "/nowhere/ironbird")
    with pytest.raises(FileNotFoundError, match="IRONBIRD=/nowhere/ironbird is no executable"):
        ironbird.fly()
    monkeypatch.delenv("IRONBIRD")
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.setattr(command.metadata, "files", lambda name: [])
    with pytest.raises(FileNotFoundError, match="cargo install --path bench/cli"):
        ironbird.fly()


def test_one_that_is_installed_with_the_module_is_found(monkeypatch, tmp_path):
    class Installed:
        name = "ironbird"
        locate = staticmethod(lambda: tmp_path / "ironbird")

    monkeypatch.delenv("IRONBIRD", raising=False)
    monkeypatch.setattr(command.metadata, "files", lambda name: [Installed])
    (tmp_path / "ironbird").write_text("")
    (tmp_path / "ironbird").chmod(0o755)
    assert ironbird.executable() == str(tmp_path / "ironbird")


def test_ctrl_c_ends_a_flight_in_order(rig):
    script = "import ironbird; ironbird.fly(duration='1h', rt='off')"
    with subprocess.Popen([sys.executable, "-c", script], stderr=subprocess.PIPE, text=True) as flight:
        while not (Path("runs") / "latest" / "report.json").exists():
            assert flight.poll() is None
            time.sleep(0.02)
        flight.send_signal(signal.SIGINT)
        _, err = flight.communicate()
    assert "KeyboardInterrupt" in err and flight.returncode != 0
    assert ironbird.read("latest").status == "INTERRUPTED"


def test_a_comparison_has_a_row_per_case(rig):
    table = ironbird.compare(inner=["adaptive", "indi"], duration="1s", max_lost=0)
    assert table.column("inner") == ["adaptive", "indi"] and all(row["error.rms_m"] < 0.01 for row in table)
    assert table.document["flight"]["trajectory"] == "lissajous"
    assert table.column("outputs")[0] == ironbird.simulate(duration_s=1).fingerprint
    Path("cases.toml").write_text('[[row]]\nname = "010"\nfaults = ["rotational_drag_nm_s=+200%@500ms"]\n')
    cases = ironbird.compare(table="cases.toml", inner=["adaptive", "indi"], duration="1s")
    assert [(row["case"], row["inner"]) for row in cases] == [("010", "adaptive"), ("010", "indi")]
    assert [type(value) for value in (cases[0]["seed"], cases[0]["fault_s"], cases[0]["lost_s"])] == [int, float, type(None)]


def test_margins_have_their_limits(rig):
    table = ironbird.margin(only="inner", phases=1, trajectory="hover", longest="5ms")
    assert [(row["kind"], row["of"], row["survives"]) for row in table] == [("outage", "inner", 5)]
    assert table.column("untried") == ["unnoticed, recovers, survives"]
    # The names of the limits are those of the report, in its order.
    source = (ROOT / "bench" / "analysis" / "src" / "margin.rs").read_text()
    assert json.dumps(list(ironbird.LIMITS)) in source


def test_a_campaign_has_a_row_per_flight(rig):
    # A build with uncommitted changes warns.
    with pytest.warns(UserWarning) if "-dirty" in version() else nullcontext():
        table = ironbird.campaign(SMALL, out="rows", jobs=2)
    assert len(table) == 46 and table[1]["arm"] == "fixed" and table[45]["flight"] == 22
    assert [arm["flights"] for arm in table.document["arms"]] == [23, 23]
    frames = (table.to_pandas(), table.to_polars())
    assert all(frame.shape == (46, len(table.columns)) and list(frame["lost"])[3] == table[3]["lost"] for frame in frames)
    assert frames[1].equals(polars_of("rows"), null_equal=True)
    assert "<td>adaptive</td>" in table._repr_html_() and "[46 rows, " in repr(table)
    with pytest.raises(KeyError, match="there is no column 'mass'; there are flight, arm, plant.mass_kg"):
        table.column("mass")


def version() -> str:
    return subprocess.run([ironbird.executable(), "--version"], capture_output=True, text=True).stdout


def polars_of(directory):
    import polars

    return polars.concat(polars.read_parquet(chunk) for chunk in sorted(Path(directory).glob("chunk-*.parquet")))
