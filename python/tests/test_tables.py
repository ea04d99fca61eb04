"""What a flight is shown as: frames, exported tables, plots, notebooks."""

import csv
import dataclasses
import json
import sys

import nbclient
import nbformat
import numpy as np
import polars
import pytest
import scipy.io

import ironbird
from conftest import ROOT


@pytest.fixture(scope="module")
def flight():
    return ironbird.simulate("lissajous", 0.5, faults=["rotational_drag_nm_s=+200%@200ms"])


def test_frames_have_a_column_for_each_number(flight):
    frame, other = flight.to_pandas(every=10), flight.to_polars(every=10)
    assert frame.shape == other.shape == (51, len(flight.columns())) and list(frame) == other.columns
    assert frame["t_s"].iloc[-1] == 0.5 and frame["truth.rotational_drag_nm_s"].iloc[-1] == 0.315
    assert np.array_equal(other["state.attitude_rad.yaw"], flight.state.attitude_rad[::10, 2])
    assert np.array_equal(frame["rotor_speeds.speed_rad_s.4"], flight.rotor_speeds.speed_rad_s[::10, 3])
    with pytest.raises(ValueError, match="every = 0: allowed are 1 and more"):
        flight.to_pandas(every=0)


@pytest.mark.parametrize("package", ["pandas", "polars", "matplotlib"])
def test_a_package_that_is_missing_is_named(flight, monkeypatch, package):
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.setitem(sys.modules, f"{package}.pyplot", None)
    monkeypatch.setitem(sys.modules, f"{package}.figure", None)
    method = {"pandas": "to_pandas", "polars": "to_polars", "matplotlib": "plot"}[package]
    with pytest.raises(ImportError, match=rf"^{method}\(\) needs {package}: pip install {package}"):
        getattr(flight, method)()
    assert ("<img" in flight._repr_html_()) == (package != "matplotlib")


def test_a_plot_has_the_flight_and_its_faults(flight):
    figure = flight.plot(every=10)
    path, place, *rest, last = figure.axes
    assert len(figure.axes) == 6 and [line.get_label() for line in last.lines[:3]] == list(flight.telemetry.inner)[3:]
    assert np.array_equal(path.lines[1].get_xdata(), flight.state.position_w_m[::10, 0])
    assert all(any(list(line.get_xdata()) == [0.2, 0.2] for line in ax.lines) for ax in (place, *rest, last))
    assert "rotational_drag_nm_s 0.105 to 0.315 at 0.2 s" in figure.get_suptitle()
    without = ironbird.simulate("hover", 0.1, inner="indi").plot()
    assert [line.get_label() for line in without.axes[-1].lines] == ["p", "q", "r"]


def test_words_in_a_notebook_are_escaped(flight):
    page = dataclasses.replace(flight, end="<script>")._repr_html_()
    assert "<script>" not in page and "&lt;script&gt;; position error up to" in page and "data:image/png;base64," in page


@pytest.mark.parametrize("form", ["csv", "json", "parquet", "mat"])
def test_the_joined_export_is_the_flight(ironbird_command, tmp_path, form):
    runs = ["--out", tmp_path / "runs"]
    flags = ["--duration", "300ms", "--pace", "lockstep", "--fault", "mass_kg=0.6@100ms", "--fault", "state.drop=1@50ms..60ms"]
    assert ironbird_command("fly", *flags, *runs).returncode == 0
    exported = ironbird_command("export", "--joined", "--format", form, "--to", tmp_path, *runs)
    assert exported.returncode == 0 and "301 rows" in exported.stdout, exported
    whole = ironbird.read("latest", out=tmp_path / "runs")
    expected = {name: values for name, values in whole.columns().items() if not name.startswith(("theorem.", "timing."))}
    # Without a state, the outer loop publishes nothing.
    assert 5 < np.isnan(expected["setpoint.thrust_n"]).sum() < 20
    columns = READ[form](tmp_path / f"joined.{form}{'l' if form == 'json' else ''}")
    if form == "parquet":
        assert polars.read_parquet_metadata(tmp_path / "joined.parquet")["unit.truth.mass_kg"] == "kg"
    # The layout's fingerprint has the highest of its 64 bits set.
    exported = ironbird_command("export", "--format", form, "--to", tmp_path / "all", *runs)
    fingerprints = READ[form](tmp_path / "all" / f"rotor_speeds.{form}{'l' if form == 'json' else ''}")
    name = "envelope_layout" if form == "mat" else "envelope.layout"
    assert fingerprints[name][0] > 2**63, exported
    if form == "mat":
        expected = {name.replace(".", "_"): values for name, values in expected.items()}
        assert all(len(name) <= 63 for name in expected)
    assert list(columns) == list(expected) and list(columns)[:2] == ["t_s", "tick"]
    for name, values in columns.items():
        assert np.array_equal(np.array(values, float), expected[name], equal_nan=True), name


def of_csv(path):
    head, *rows = csv.reader(path.read_text().splitlines())
    return dict(zip(head, ([float(cell or "nan") for cell in column] for column in zip(*rows)), strict=True))


def of_json(path):
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    return {name: [row[name] for row in rows] for name in rows[0]}


READ = {
    "csv": of_csv,
    "json": of_json,
    "parquet": lambda path: {column.name: column.to_list() for column in polars.read_parquet(path)},
    "mat": lambda path: {name: values[:, 0] for name, values in scipy.io.loadmat(path).items() if not name.startswith("__")},
}


def test_the_notebook_runs(rig):
    notebook = nbformat.read(ROOT / "examples" / "first_flight.ipynb", as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells)
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": "."}}).execute()
    shown = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    pictures = [it for it in shown if "<img" in it.get("data", {}).get("text/html", "") or "image/png" in it.get("data", {})]
    text = "".join(it.get("text", "") for it in shown)
    assert len(pictures) == 4 and "adaptive  20 of 20 succeed" in text, text
