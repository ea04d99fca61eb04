"""Prints what three public readers make of a campaign's rows: per reader the same numbers, as JSON."""

import json
import sys

import duckdb
import pandas
import polars
import pyarrow.parquet


def main(path):
    metadata = pyarrow.parquet.read_metadata(path).metadata
    frame = pandas.read_parquet(path)
    lazy = polars.scan_parquet(path)
    (rows, successes, error, mass), = duckdb.sql(
        f"""select count(*), count(*) filter (success), sum("position_error_max_m"), sum("plant.mass_kg") from '{path}'"""
    ).fetchall()
    columns = lazy.select(
        polars.len(), polars.col("success").sum(), polars.col("position_error_max_m").sum(), polars.col("plant.mass_kg").sum()
    ).collect().row(0)
    print(
        json.dumps(
            {
                "duckdb": [rows, successes, error, mass],
                "polars": list(columns),
                "pandas": [
                    len(frame),
                    int(frame["success"].sum()),
                    float(frame["position_error_max_m"].sum()),
                    float(frame["plant.mass_kg"].sum()),
                ],
                "unit": metadata[b"unit.plant.mass_kg"].decode(),
                "told": {
                    key.decode(): value.decode()
                    for key, value in metadata.items()
                    if key.startswith(b"ironbird.")
                },
            }
        )
    )


main(sys.argv[1])
