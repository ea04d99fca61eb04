"""Prints what another implementation reads in an interval log: per tag the values over all intervals, as JSON."""

import json
import math
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


def main(path):
    reference = HdrHistogram(1, 10_000_000_000, 3)
    reader = HistogramLogReader(path, reference)
    total, intervals = {}, {}
    while (histogram := reader.get_next_interval_histogram()) is not None:
        tag = histogram.get_tag()
        total.setdefault(tag, HdrHistogram(1, 10_000_000_000, 3)).add(histogram)
        intervals.setdefault(tag, []).append(
            {
                "start_ms": histogram.get_start_time_stamp(),
                "end_ms": histogram.get_end_time_stamp(),
                "count": histogram.total_count,
                "max_ns": histogram.get_max_value(),
            }
        )
    tags = {
        tag: {
            "count": histogram.total_count,
            "min_ns": histogram.get_min_value(),
            "p50_ns": value_at(histogram, 0.5),
            "p90_ns": value_at(histogram, 0.9),
            "p99_ns": value_at(histogram, 0.99),
            "max_ns": histogram.get_max_value(),
            "intervals": intervals[tag],
        }
        for tag, histogram in total.items()
    }
    json.dump({"start_s": reader.get_start_time_sec(), "tags": tags}, sys.stdout)


if __name__ == "__main__":
    main(sys.argv[1])
