"""Compares what another implementation reads in an interval log with the report of its flight.

python read_hlog.py latency.hlog report.json
"""

import json
import math
import re
import sys

from hdrh.histogram import HdrHistogram
from hdrh.log import HistogramLogReader


def value_at(histogram, quantile):
    """The value at a rank, rounded up; the package's own percentiles round the rank to the nearest."""
    rank = max(1, math.ceil(quantile * histogram.total_count))
    seen = 0
    for item in histogram.get_recorded_iterator():
        seen += item.count_at_value_iterated_to
        if seen >= rank:
            return histogram.get_highest_equivalent_value(item.value_iterated_to)
    raise ValueError("a histogram of fewer values than it says")


def header(path, name):
    """The number of a comment such as `#[StartTime: 12.345 (seconds since epoch)]`."""
    with open(path) as log:
        return float(re.search(rf"^#\[{name}: ([^ \]]+)", log.read(), re.MULTILINE)[1])


def main(path, report):
    with open(report) as file:
        report = json.load(file)
    start_s = header(path, "StartTime")
    # The run is numbered when the roles are ready, and t_0 announced after that; starts of intervals count from t_0.
    assert start_s >= report["run"]["run_id"] / 1e9 - 1e-3, start_s
    assert header(path, "BaseTime") == start_s
    # Maxima of intervals are in milliseconds.
    assert header(path, "MaxValueDivisor") == 1e6
    longest_ns = 3_600_000_000_000
    reader = HistogramLogReader(path, HdrHistogram(1, longest_ns, 3))
    total, intervals = {}, {}
    while (histogram := reader.get_next_interval_histogram()) is not None:
        tag = histogram.get_tag()
        total.setdefault(tag, HdrHistogram(1, longest_ns, 3)).add(histogram)
        intervals.setdefault(tag, []).append(histogram)
    assert reader.get_start_time_sec() == start_s
    assert set(total) == {series["name"] for series in report["series"]}, total
    for series in report["series"]:
        name, read, parts = series["name"], total[series["name"]], intervals[series["name"]]
        assert read.total_count == series["count"] == sum(part.total_count for part in parts), name
        # Both fill the same buckets; the report's smallest and largest value are exact.
        for key, read_ns in {
            "min_us": read.get_min_value(),
            "p50_us": value_at(read, 0.5),
            "p90_us": value_at(read, 0.9),
            "p99_us": value_at(read, 0.99),
            "max_us": read.get_max_value(),
        }.items():
            in_report_ns = round(series[key] * 1e3)
            assert read.values_are_equivalent(read_ns, in_report_ns), (name, key, read_ns, in_report_ns)
        assert max(part.get_max_value() for part in parts) == read.get_max_value(), name
        for part in parts:
            begin_ms, end_ms = part.get_start_time_stamp(), part.get_end_time_stamp()
            assert start_s * 1e3 - 1 <= begin_ms < end_ms, (name, begin_ms, end_ms)


if __name__ == "__main__":
    main(*sys.argv[1:])
