#!/usr/bin/env python3
"""Compares what the classes of the package `perfetto` read from a trace with the exported messages and the report of its flight.

python read_perfetto.py flight.perfetto-trace EXPORT_DIRECTORY report.json
"""
import collections
import json
import sys
from pathlib import Path

from perfetto.protos.perfetto.trace.perfetto_trace_pb2 import Trace, TrackEvent

STAGES = {"plant": "state", "outer": "setpoint", "inner": "wrench", "mixer": "rotor_speeds"}
INPUTS = ["state", "setpoint", "wrench"]

path, exported, report = map(Path, sys.argv[1:])
trace = Trace()
trace.ParseFromString(path.read_bytes())
tracks, slices, instants, open_since = {}, collections.defaultdict(list), [], {}
for packet in trace.packet:
    if packet.HasField("track_descriptor"):
        tracks[packet.track_descriptor.uuid] = packet.track_descriptor.name
        continue
    event, name = packet.track_event, tracks[packet.track_event.track_uuid]
    said = {note.name: note.string_value or note.uint_value for note in event.debug_annotations}
    if event.type == TrackEvent.TYPE_SLICE_BEGIN:
        assert name not in open_since, f"{name} begins a slice within a slice"
        open_since[name] = (packet.timestamp, event.name, said)
    elif event.type == TrackEvent.TYPE_SLICE_END:
        begin, what, said = open_since.pop(name)
        slices[name].append([said["tick"], begin, packet.timestamp, what])
    else:
        instants.append([name, packet.timestamp, said])
assert not open_since, f"slices without an end: {open_since}"
assert list(tracks.values()) == ["ironbird", *STAGES, "deadlines missed", "swaps", "faults", "other programs, in outages"], tracks
for place, (stage, topic) in enumerate(STAGES.items()):
    expected = []
    for line in (exported / f"{topic}.jsonl").read_text().splitlines():
        message = json.loads(line)
        tick, stamps = message["envelope.tick"], [message[f"envelope.stamps.{stage}.{which}_ns"] for which in ("receive", "send")]
        is_stale = place > 0 and message[f"envelope.input_tick.{INPUTS[place - 1]}"] != tick
        name = stage + (" (stale input)" if is_stale else "")
        if stamps[0] > 0:
            expected.append([tick, *stamps, name])
    assert len(expected) > 100 and slices[stage] == expected, f"{stage}: {slices[stage]} {expected}"
missed = sum(said["count"] for track, _, said in instants if track == "deadlines missed")
# Misses before the first state, and after the last state, are in no state.
reported = json.loads(report.read_text())["deadlines"]["missed"]
assert 21 <= missed <= reported, f"{missed} of {reported}"
swaps = [said for track, _, said in instants if track == "swaps"]
assert [swap["rotational_drag_nm_s"] for swap in swaps] == ["0.105 -> 0.2"], swaps
