"""`ironbird.read`: recorded flights, as they were flown."""

import numpy as np
import pytest

import ironbird



def fly(ironbird_command, tmp_path, *flags, duration="1s"):
    where = ["--trajectory", "lissajous", "--duration", duration, "--out", tmp_path / "runs"]
    flown = ironbird_command("fly", *where, *flags)
    assert flown.returncode in (0, 3), flown.stderr
    return tmp_path / "runs" / "latest"


def test_a_flight_in_lockstep_is_the_simulated_one(ironbird_command, tmp_path):
    fault = "rotational_drag_nm_s=0.525@400ms"
    run = fly(ironbird_command, tmp_path, "--pace", "lockstep", "--fault", fault)
    read = ironbird.read(run)
    simulated = ironbird.simulate("lissajous", 1, faults=[fault])
    assert (read.fingerprint, read.end, read.laws) == (simulated.fingerprint, "completed", simulated.laws)
    assert read.faults == simulated.faults
    # The theorem's monitor is read from the log, and watches in the simulation.
    for name in ("state", "truth", "setpoint", "reference", "wrench", "rotor_speeds", "theorem"):
        for column, values in getattr(simulated, name).items():
            assert np.array_equal(values, getattr(read, name)[column], equal_nan=True), f"{name}.{column}"
    for role in ("outer", "inner", "mixer"):
        assert list(getattr(read.telemetry, role)) == list(getattr(simulated.telemetry, role))
    assert set(simulated.units.items()) < set(read.units.items())
    # In lockstep ticks have no place on the clock.
    assert "loop_us" in read.timing and "slack_us" not in read.timing
    assert f"outputs {read.fingerprint}" in ironbird_command("replay", run, "--verify").stdout
    assert np.array_equal(ironbird.read(run / "flight.mcap").t, read.t)
    assert ironbird.read("latest", out=tmp_path / "runs").fingerprint == read.fingerprint
    assert ironbird.simulate(settings=read.settings).fingerprint == read.fingerprint


def test_ticks_that_were_left_out_are_no_rows_and_what_was_not_said_is_nan(ironbird_command, tmp_path):
    run = fly(ironbird_command, tmp_path, "--rt", "off", "--log", "all")
    read = ironbird.read(run)
    assert np.all(np.diff(read.tick) >= 1) and np.array_equal(read.t, read.tick * 1e-3)
    for group in (read.state, read.wrench, read.timing):
        assert all(len(values) == len(read.t) for values in group.values())
    timing = read.timing
    names = {f"{kind}_{role}_us" for kind in ("wake", "compute") for role in ("plant", "outer", "inner", "mixer")}
    names |= {"timer_us", "hop_plant_outer_us", "hop_outer_inner_us", "hop_inner_mixer_us", "loop_us", "slack_us"}
    assert set(timing) == names and all(read.units[f"timing.{name}"] == "us" for name in names)
    said = ~np.isnan(timing.loop_us)
    assert said.any() and np.all(timing.loop_us[said] > 0)
    # The loop is what its parts take: it begins with the sampling, after the plant has woken.
    parts = sum(timing[f"compute_{role}_us"] for role in ("outer", "inner", "mixer"))
    parts = parts + sum(timing[f"hop_{hop}_us"] for hop in ("plant_outer", "outer_inner", "inner_mixer"))
    whole = said & ~np.isnan(parts)
    assert np.all(parts[whole] <= timing.loop_us[whole] + 1e-3)


def test_an_excerpt_has_the_rows_that_it_holds(ironbird_command, tmp_path):
    flags = ["--pace", "lockstep", "--log", "around-misses", "--config", tmp_path / "s.toml"]
    (tmp_path / "s.toml").write_text("[recorder]\nlog_around_s = 0.1\n")
    read = ironbird.read(fly(ironbird_command, tmp_path, *flags))
    assert read.tick.tolist() == [*range(101), *range(900, 1001)]


def test_a_log_without_its_end_is_read_up_to_there(ironbird_command, tmp_path):
    run = fly(ironbird_command, tmp_path, "--pace", "lockstep", duration="5s")
    log = (run / "flight.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(log[: len(log) * 3 // 4])
    read = ironbird.read(tmp_path / "cut.mcap")
    assert read.end == "not known: the end of the log is missing" and 0 < len(read.t) < 5001
    (tmp_path / "cut.mcap").write_bytes(log[: len(log) // 100])
    with pytest.raises(ironbird.LogError, match="cut.mcap is truncated before its first message\n help: nothing"):
        ironbird.read(tmp_path / "cut.mcap")


def test_what_is_no_flight_is_told(tmp_path, ironbird_command):
    (tmp_path / "flight.mcap").write_bytes(b"no log")
    with pytest.raises(ironbird.LogError, match="is damaged or no flight log"):
        ironbird.read(tmp_path / "flight.mcap")
    with pytest.raises(ironbird.LogError, match="an empty path is no flight"):
        ironbird.read("")
    result = ironbird_command("export", "nowhere").stderr
    with pytest.raises(ironbird.LogError) as raised:
        ironbird.read("nowhere", out="runs")
    assert f"error: {raised.value}\n" == result


@pytest.mark.parametrize(("text", "why"), [("nonsense", "Expecting value"), ("", "Expecting value"), ("[]", "no schema"), ("{}", "no schema")])
def test_a_damaged_report_is_named(ironbird_command, tmp_path, text, why):
    run = fly(ironbird_command, tmp_path, "--pace", "lockstep", duration="10ms")
    (run / "report.json").write_text(text)
    with pytest.raises(ironbird.LogError, match=f"report.json is no report of a flight: .*{why}"):
        ironbird.read(run)
