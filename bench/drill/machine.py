"""What the machine takes away in flight: memory, disks, clocks, files and segments."""

import json
import os
import random
import shutil
import signal
import subprocess
import time

from rig import demand, need, need_root, wait_until

CLOCK = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <time.h>
// The wall clock steps by up to an hour at each look; other clocks go on.
int clock_gettime(clockid_t id, struct timespec *now) {
    static int (*real)(clockid_t, struct timespec *);
    static unsigned looks = 1;
    if (!real) real = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
    int result = real(id, now);
    if (id == CLOCK_REALTIME) now->tv_sec += (long)((looks = looks * 1664525 + 1013904223) % 7200) - 3600;
    return result;
}
"""
SHORT = ("--rt", "off", "--trajectory", "hover", "--duration", "1s")


def memory_fills_up(make, n):
    """Fills a private /dev/shm to the last byte in flight: all of the flight's pages are there already."""
    for _ in range(n):
        with make() as rig:
            need_root()
            inside = ('mount -t tmpfs -o size=200m none /dev/shm && ("$0" "$@"; echo $? > code) & '
                      "sleep 2.5; dd if=/dev/zero of=/dev/shm/full bs=1M 2>dd; df /dev/shm | tail -1 > full; wait")
            command = rig.command("fly", "--rt", "off", "--trajectory", "hover", "--duration", "5s")
            rig.launch(["unshare", "-m", "sh", "-c", inside, *command]).end().expect(0)
            demand((rig.directory / "code").read_text().strip() in "03", "the flight failed")
            demand("100%" in (rig.directory / "full").read_text(), "/dev/shm was not full")
            demand(rig.report()["run"]["ending"] == "completed", rig.report()["run"]["ending"])
            yield {}


def small_disk(make, n, size):
    """Records on a disk that fills up in flight: messages are dropped and counted, the flight is flown to its end."""
    for _ in range(n):
        with make() as rig:
            need_root()
            disk, kept = rig.directory / "disk", rig.directory / "kept"
            disk.mkdir()
            script = (f"mount -t tmpfs -o size={size} none {disk} && \"$0\" \"$@\"; code=$?; cp -rL {disk}/latest {kept}; "
                      "exit $code")
            command = rig.command("fly", "--pace", "lockstep", "--duration", "12s", "--out", disk)
            result = rig.launch(["unshare", "-m", "sh", "-c", script, *command]).end().expect(0).result()
            ending = json.loads((kept / "report.json").read_text())["run"]["ending"]
            demand(ending == "completed", ending)
            demand(result["status"] == "INCOMPLETE" and result["ticks"] == "12001", f"{result}")
            rig.demand_nothing_left()
            yield {"messages dropped": int(result["unlogged"])}


def traced(make, n):
    """Attaches strace to a loop for half a second: it is slow, and flies on."""
    for _ in range(n):
        with make() as rig:
            flight = rig.take_off("--on-death", "end", duration="3s")
            need("strace")
            tracer = rig.launch(["timeout", "-s", "INT", "0.5", "strace", "-f", "-p", str(rig.await_pid("inner")), "-o",
                                 "/dev/null"])
            tracer.end()
            rig.end_completed(flight)
            rig.demand_replay()
            rig.demand_nothing_left()
            yield {"ticks skipped": rig.report()["ticks"]["skipped"]}


def wall_clock(make, n):
    """Steps the wall clock of all processes of a flight at each look at it, by up to an hour: nothing comes of it."""
    for _ in range(n):
        with make() as rig:
            need("cc")
            source, shim = rig.directory / "clock.c", rig.directory / "clock.so"
            source.write_text(CLOCK)
            subprocess.run(["cc", "-O1", "-shared", "-fPIC", "-o", shim, source, "-ldl"], check=True)
            environment = {**rig.environment, "LD_PRELOAD": str(shim)}
            rig.end_completed(rig.fly(duration="2s", env=environment))
            ticks = rig.report()["ticks"]
            demand(ticks["run"] + ticks["skipped"] == 2001, f"ticks: {ticks}")
            rig.demand_replay()
            rig.demand_nothing_left()
            yield {}


def old_machine(make, n):
    """Flies where the monotonic clock has run for 30 years."""
    for _ in range(n):
        with make() as rig:
            need_root()
            command = ["unshare", "-T", "--monotonic", str(30 * 365 * 86400), "--fork", "--", *rig.command("fly", *SHORT)]
            rig.end_completed(rig.launch(command))
            rig.demand_replay()
            rig.demand_nothing_left()
            yield {}


def leftovers(make, n, how):
    """Kills everything, breaks what it left in shared memory, and starts again: it flies, or says `ironbird clean`."""
    draw = random.Random(n)
    for _ in range(n):
        with make() as rig:
            rig.take_off(duration="60s")
            for pid in rig.processes():
                os.kill(pid, signal.SIGKILL)
            wait_until("killed processes to go", lambda: not rig.processes(), 10)
            for path in rig.segments():
                size = path.stat().st_size
                if how == "removed":
                    if draw.random() < 0.5:
                        path.unlink()
                elif how == "truncated":
                    os.truncate(path, draw.choice([0, 1, size // 2, draw.randrange(size + 1)]))
                else:
                    with open(path, "r+b") as file:
                        for _ in range(50):
                            file.seek(draw.randrange(max(1, size)))
                            file.write(draw.randbytes(draw.randrange(1, 64)))
                    os.truncate(path, size)
            ended = rig.run("fly", "--rt", "off", "--pace", "lockstep", "--duration", "50ms")
            if ended.code != 0:
                demand(ended.code > 0 and "ironbird clean" in ended.err, f"{ended}")
                rig.run("clean").expect(0)
                rig.demand_next_flight()
            rig.demand_nothing_left()
            yield {"by clean": int(ended.code != 0)}


def counter_left(make, n):
    """Puts the middleware's counter of nodes back after a flight: the next start removes it, or `ironbird clean` names it."""
    for i in range(n):
        with make() as rig:
            flight = rig.take_off(duration="500ms")
            [path] = [path for path in rig.segments() if path.suffix == ".global_mgmt"]
            counter = path.read_bytes()
            rig.end_completed(flight)
            rig.demand_nothing_left()
            path.touch(mode=0o600)
            path.write_bytes(counter)
            if i % 2 == 1:
                rig.run("clean").expect(0).says(f"removed {path}")
                rig.demand_nothing_left()
            rig.demand_next_flight()
            yield {}


def segments_in_use(make, n, how):
    """Removes or cuts off the segments of a flight in the air: it goes on or ends, and the next one flies."""
    draw = random.Random(n)
    for _ in range(n):
        with make() as rig:
            flight = rig.take_off(duration="3s")
            time.sleep(draw.random() * 0.2)
            paths = [path for path in rig.segments() if path.exists()]
            for path in paths if how == "removed" else draw.sample(paths, 1):
                if how == "removed":
                    path.unlink()
                else:
                    os.truncate(path, 0)
            begin = time.monotonic()
            ended = flight.end(60)
            took_s = time.monotonic() - begin
            wait_until("everybody to end", lambda: not rig.processes(), 45)
            following = rig.run("fly", "--rt", "off", "--pace", "lockstep", "--duration", "50ms")
            if following.code != 0:
                demand(following.code > 0 and "ironbird clean" in following.err, f"the next flight: {following}")
                rig.run("clean").expect(0)
                rig.demand_next_flight()
            rig.demand_nothing_left()
            yield {"s to the end": round(took_s, 2), "flights cut short": int(ended.code not in (0, 3))}


def directory_removed(make, n):
    """Removes the instance's directory in flight: the flight goes on or ends in order, and the next one flies."""
    for _ in range(n):
        with make() as rig:
            flight = rig.take_off(duration="3s")
            shutil.rmtree(rig.root, ignore_errors=True)
            flight.end(60)
            wait_until("everybody to end", lambda: not rig.processes(), 45)
            rig.run("clean").expect(0)
            rig.demand_next_flight()
            yield {}


def read_only(make, n):
    """Starts where the root path is read-only: refused in words that name it."""
    for _ in range(n):
        with make() as rig:
            rig.root.mkdir()
            command = rig.command("fly", "--rt", "off", "--duration", "100ms")
            need_root()
            mount = f'mount -t tmpfs -o ro none {rig.root} && exec "$0" "$@"'
            ended = rig.launch(["unshare", "-m", "sh", "-c", mount, *command]).end().expect(1, 2)
            demand(str(rig.root) in ended.err and "panicked" not in ended.err, f"{ended}")
            rig.demand_nothing_left()
            yield {}


def hostile_middleware(make, n):
    """Flies in a directory with a configuration of the middleware that would lead it astray: it is not read."""
    for _ in range(n):
        with make() as rig:
            poison = rig.directory / "config"
            poison.mkdir()
            (poison / "iceoryx2.toml").write_text('[global]\nroot-path = "/proc/none"\nprefix = "stolen_"\n')
            rig.run("fly", "--pace", "lockstep", "--duration", "500ms").expect(0)
            demand(not [path for path in os.listdir("/dev/shm") if path.startswith("stolen_")], "it was read")
            rig.demand_nothing_left()
            yield {}


ROWS = [
    {"name": "memory.fills_up", "fault": "/dev/shm fills up in flight", "injector": memory_fills_up,
     "expected": "completed", "n": 5},
    {"name": "disk.fills_up", "fault": "the log's disk fills up in flight", "injector": small_disk,
     "arguments": {"size": "7m"}, "expected": "completed, INCOMPLETE; dropped messages counted", "n": 3},
    {"name": "traced", "fault": "strace attached to a loop for 0.5 s", "injector": traced,
     "expected": "completed; replay identical", "n": 5},
    {"name": "clock.stepped", "fault": "the wall clock steps by up to an hour at each reading (preloaded library)",
     "injector": wall_clock, "expected": "no tick lost or doubled; replay identical", "n": 5},
    {"name": "clock.old", "fault": "a monotonic clock of 30 years (time namespace)", "injector": old_machine,
     "expected": "completed; replay identical", "n": 5},
    *({"name": f"leftovers.{how}", "fault": f"leftovers in shared memory {words}", "injector": leftovers,
       "arguments": {"how": how}, "expected": "next flight works, if need be after `ironbird clean`", "n": 20}
      for how, words in {"truncated": "truncated", "garbage": "overwritten", "removed": "half removed"}.items()),
    {"name": "leftovers.counter", "fault": "node counter of the middleware left by an orderly flight",
     "injector": counter_left, "expected": "next flight works and removes it; `ironbird clean` names it", "n": 10,
     "short": 2},
    {"name": "segments.removed", "fault": "all segments removed in flight", "injector": segments_in_use,
     "arguments": {"how": "removed"}, "expected": "no hang; next flight works", "n": 10},
    {"name": "segments.truncated", "fault": "a segment truncated in flight", "injector": segments_in_use,
     "arguments": {"how": "truncated"}, "expected": "no hang; next flight works", "n": 20},
    {"name": "directory.removed", "fault": "instance directory removed in flight", "injector": directory_removed,
     "expected": "no hang; next flight works after `ironbird clean`", "n": 10},
    {"name": "directory.read_only", "fault": "read-only root path", "injector": read_only,
     "expected": "rejected by name", "n": 5},
    {"name": "hostile_middleware", "fault": "a middleware configuration in the working directory",
     "injector": hostile_middleware, "expected": "not read; completed", "n": 5},
]
