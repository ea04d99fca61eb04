"""Compares what three public readers make of a campaign's rows with each other and with its report.

python read_rows.py merged.parquet REPORT.json
"""

import json
import math
import sys

import duckdb
import pandas
import polars
import pyarrow.parquet


def main(path, report):
    metadata = pyarrow.parquet.read_metadata(path).metadata
    assert metadata[b"unit.plant.mass_kg"] == b"kg", metadata
    assert metadata[b"ironbird.schema"] == b"ironbird-campaign/1", metadata
    with open(report) as file:
        successes = sum(arm["successes"] for arm in json.load(file)["arms"])
    frame = pandas.read_parquet(path)
    lazy = polars.scan_parquet(path)
    (of_duckdb,) = duckdb.sql(
        f"""select count(*), count(*) filter (success), sum("position_error_max_m"), sum("plant.mass_kg") from '{path}'"""
    ).fetchall()
    of_polars = lazy.select(
        polars.len(), polars.col("success").sum(), polars.col("position_error_max_m").sum(), polars.col("plant.mass_kg").sum()
    ).collect().row(0)
    of_pandas = len(frame), frame["success"].sum(), frame["position_error_max_m"].sum(), frame["plant.mass_kg"].sum()
    for read in of_duckdb, of_polars, of_pandas:
        assert tuple(read[:2]) == (46, successes), (read, successes)
        for ours, other in zip(read[2:], of_duckdb[2:]):
            assert math.isclose(ours, other, rel_tol=1e-12), (read, of_duckdb)


main(*sys.argv[1:])
