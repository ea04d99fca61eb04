"""Flips bits of messages in the shared memory of a flight in the air, right after they were sent.

Where the slots are is read off their content: a message begins with its layout and its run. The slots that are in use
are those whose ticks are the newest; the instant is that in which a slot gets a newer one.
"""

import mmap
import random
import struct
import time

from rig import demand, wait_until

# Of an envelope, in words: layout, run_id, settings, epoch, seq, tick, parameter_epoch.
TICK, PARAMETER_EPOCH = 5, 6
# Bytes of the smallest message; a flip stays within them.
MESSAGE = 59 * 8
NO_TICK = 2**64 - 1


class Segment:
    """The slots of a topic that have been written."""

    def __init__(self, path, run):
        with open(path, "r+b") as file:
            self.map = mmap.mmap(file.fileno(), 0)
        self.run, self.slots = run, []
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


def segments(rig, run):
    """Those that hold messages of the run: large, and with its number at the second word of a slot."""
    found = []
    for path in rig.segments():
        try:
            segment = Segment(path, run) if path.stat().st_size > 1 << 20 else None
        except FileNotFoundError:
            # Of a process that has just ended.
            continue
        if segment and len(segment.slots) > 1:
            found.append(segment)
    return found


def flip(rig, seconds, every_s):
    """Flips a bit every so often; how many."""
    draw = random.Random(1)
    number = wait_until("the run's number", lambda: run_of(rig))
    run = struct.pack("<Q", number)
    found = wait_until("messages in shared memory", lambda: segments(rig, run))
    until, flips = time.monotonic() + seconds, 0
    while time.monotonic() < until:
        segment = draw.choice(found)
        if flips % 50 == 0:
            for each in found:
                each.look()
        hot = segment.newest(24)
        ticks = [segment.tick(slot) for slot in hot]
        give_up = time.monotonic() + 0.01
        struck = None
        while struck is None and time.monotonic() < give_up:
            for slot, tick in zip(hot, ticks):
                now = segment.tick(slot)
                if now != tick and now != NO_TICK:
                    struck = slot
                    break
        if struck is None:
            continue
        # Every other one where it would be carried on by all that follow, were it believed.
        at = struck + 8 * PARAMETER_EPOCH + draw.randrange(8) if flips % 2 else struck + draw.randrange(MESSAGE)
        segment.map[at] ^= 1 << draw.randrange(8)
        flips += 1
        time.sleep(every_s)
    demand(flips > 0, "no slot in use was found")
    return flips


def run_of(rig):
    """The number of the run in the air, of which a first report is there soon."""
    try:
        return rig.report()["run"]["run_id"]
    except (OSError, ValueError):
        return None
