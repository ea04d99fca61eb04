"""Flips bits of messages in the shared memory of a running flight, right after they were sent: INSTANCE REPORT SECONDS EVERY_S.

A message begins with its layout and the number of its run, by which its slots are found. Slots that are in use have the newest
ticks; a slot that gets a newer one has just been sent.
"""

import json
import mmap
import random
import struct
import sys
import time
from pathlib import Path

# Of a header, in words: layout, run_id, settings, epoch, seq, tick, parameter_epoch.
TICK, PARAMETER_EPOCH = 5, 6
# Bytes of the smallest message; a flip stays within them.
MESSAGE = 59 * 8
NO_TICK = 2**64 - 1


class Segment:
    """The slots of a topic that have been written."""

    def __init__(self, path, run):
        with open(path, "r+b") as file:
            self.map = mmap.mmap(file.fileno(), 0)
        self.run = run
        self.look()

    def look(self):
        at, self.slots = self.map.find(self.run), []
        while at >= 0:
            self.slots.append(at - 8)
            at = self.map.find(self.run, at + MESSAGE)

    def tick(self, slot):
        return struct.unpack_from("<Q", self.map, slot + 8 * TICK)[0]

    def newest(self, count):
        ticks = [(self.tick(slot), slot) for slot in self.slots]
        return [slot for tick, slot in sorted((t for t in ticks if t[0] != NO_TICK), reverse=True)[:count]]


def segments(instance, run):
    """Those that hold messages of the run: large, and with its number at the second word of a slot."""
    found = []
    for path in Path("/dev/shm").glob(f"*_{instance}.*"):
        try:
            if path.stat().st_size > 1 << 20:
                found.append(Segment(path, run))
        except FileNotFoundError:
            # Of a process that has just ended.
            continue
    return [segment for segment in found if len(segment.slots) > 1]


def flip(instance, run_id, seconds, every_s):
    """Flips a bit every so often; returns how many."""
    draw = random.Random(1)
    found = segments(instance, struct.pack("<Q", run_id))
    until, flips = time.monotonic() + seconds, 0
    while time.monotonic() < until:
        segment = draw.choice(found)
        if flips % 50 == 0:
            for each in found:
                each.look()
        hot = [(slot, segment.tick(slot)) for slot in segment.newest(24)]
        give_up, sent = time.monotonic() + 0.01, None
        while sent is None and time.monotonic() < give_up:
            sent = next((slot for slot, tick in hot if segment.tick(slot) not in (tick, NO_TICK)), None)
        if sent is None:
            continue
        # Every other one where all later messages would carry it on if it were believed.
        at = sent + 8 * PARAMETER_EPOCH + draw.randrange(8) if flips % 2 else sent + draw.randrange(MESSAGE)
        segment.map[at] ^= 1 << draw.randrange(8)
        flips += 1
        time.sleep(every_s)
    return flips


if __name__ == "__main__":
    report = json.loads(Path(sys.argv[2]).read_text())
    if flip(sys.argv[1], report["run"]["run_id"], float(sys.argv[3]), float(sys.argv[4])) == 0:
        sys.exit("no slot in use was found")
