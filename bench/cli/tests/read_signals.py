"""Compares what a flight's report, tables, page and picture say of the signals of its laws.

python read_signals.py DIRECTORY REPORT OUTER INNER RATE_ERROR ESTIMATES

REPORT is the text of `ironbird report --full`; then how many signals each law has, and whether there is a rate error, and estimates.
"""

import csv
import json
import sys
from pathlib import Path


def columns(path):
    with open(path, newline="") as file:
        names, *rows = csv.reader(file)
    return dict(zip(names, zip(*rows)))


def main(directory, text, outer, inner, rate_error, estimates):
    directory, text = Path(directory), Path(text).read_text()
    report = json.loads((directory / "report.json").read_text())
    page, states = (directory / "report.html").read_text(), columns(directory / "states.csv")
    laws = report["run"]["laws"]
    for role, count in ("outer", int(outer)), ("inner", int(inner)):
        exported = columns(directory / f"export/{role}_telemetry.csv")
        signals = laws[role]["telemetry"]
        assert (len(signals), len(exported)) == (count, count + 2), (role, signals)
        for signal in signals:
            name = signal["name"]
            values = [float(cell) for cell in exported[name]]
            assert (signal["last"], signal["max"]) == (values[-1], max(values)), signal
            assert states[f"{role}_telemetry.{name}"] == exported[name], name
            assert f'data-plot="{role}-{name}"' in page and f"  {role} {name} " in text, name
    for key, column, plots, exists in [
        ("rate_error_final_rad_s", "e_p", ["rate-error"], rate_error == "yes"),
        ("estimates", "kr_hat", ["k_r"], estimates == "yes"),
    ]:
        assert (key in report["flight"]) == exists, key
        assert any(states[column]) == exists, column
        for plot in plots:
            assert (f'data-plot="{plot}"' in page) == exists, plot
    svg = (directory / "flight.svg").read_text()
    assert ("estimate of k_r" in svg) == (estimates == "yes")
    assert (">yaw<" in svg) == (estimates == "no")
    if estimates == "no":
        law = laws["inner"]["name"]
        why = f"the inner law `{law}` has no theorem"
        assert report["theorem"] == {"law_without": law, "not_applicable": why}, report["theorem"]
        assert why in page
        assert f"Theorem   not applicable: {why}\n" in text
        assert "estimated" not in text, text


main(*sys.argv[1:])
