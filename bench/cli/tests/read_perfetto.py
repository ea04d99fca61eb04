#!/usr/bin/env python3
"""Prints as JSON what the classes of the package `perfetto` read from a trace: tracks, slices, instants."""
import collections
import json
import sys

from perfetto.protos.perfetto.trace.perfetto_trace_pb2 import Trace, TrackEvent

trace = Trace()
with open(sys.argv[1], "rb") as file:
    trace.ParseFromString(file.read())
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
print(json.dumps({"tracks": list(tracks.values()), "slices": slices, "instants": instants}))
