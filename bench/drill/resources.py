"""What the machine refuses or takes away: memory, disks, descriptors, rights, processors, clocks."""

import json
import os
import subprocess

from rig import demand, need, need_root

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


def in_own_mounts(rig, mount, *words, **options):
    need_root()
    return rig.launch(["unshare", "-m", "sh", "-c", f'{mount} && exec "$0" "$@"', *rig.command(*words)], **options)


def small_memory(make, n, options):
    """Starts in a /dev/shm that is too small: refused in words that say so, and never a SIGBUS."""
    for _ in range(n):
        with make() as rig:
            ended = in_own_mounts(rig, f"mount -t tmpfs -o {options} none /dev/shm", "fly", *SHORT).end()
            ended.expect(1, 2, 4, 5)
            demand("/dev/shm" in ended.err + ended.out, f"does not name /dev/shm: {ended}")
            rig.demand_nothing_left()
            yield {}


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


def limited(make, n, limit, user=None):
    """Starts with a limit that leaves no room: refused in words that name the limit, and nothing is left."""
    for _ in range(n):
        with make() as rig:
            command = rig.command("fly", *SHORT)
            if user:
                need_root()
                copy = rig.directory / "ironbird"
                subprocess.run(["cp", rig.executable, copy], check=True)
                for path in (rig.root, rig.out):
                    path.mkdir()
                    os.chown(path, 65534, 65534)
                rig.directory.chmod(0o755)
                command = ["setpriv", "--reuid", user, "--regid", user, "--clear-groups", "prlimit", limit, str(copy),
                           *command[1:]]
            else:
                command = ["prlimit", limit, *command]
            ended = rig.launch(command).end()
            demand(ended.code not in (0, None) and ended.code > 0, f"{limit}: {ended}")
            demand("panicked" not in ended.err, f"{limit}: {ended}")
            rig.demand_nothing_left()
            yield {}


def unprivileged(make, n, require):
    """Flies as a user to whom nothing is granted: labelled where real time is preferred, refused where it is required."""
    for _ in range(n):
        with make() as rig:
            need_root()
            copy = rig.directory / "ironbird"
            subprocess.run(["cp", rig.executable, copy], check=True)
            for path in (rig.root, rig.out):
                path.mkdir()
                os.chown(path, 65534, 65534)
            rig.directory.chmod(0o755)
            command = rig.command("fly", "--rt", "require" if require == "yes" else "prefer", *SHORT[2:])[1:]
            ended = rig.launch(["setpriv", "--reuid", "65534", "--regid", "65534", "--clear-groups", "prlimit",
                                "--memlock=65536", str(copy), *command]).end()
            if require == "yes":
                ended.expect(4).says("rtprio")
            else:
                demand(ended.expect(0, 3).result()["rt"] == "other", f"{ended}")
                demand(rig.report()["run"]["ending"] == "completed", rig.report()["run"]["ending"])
            rig.demand_nothing_left()
            yield {}


def processors(make, n):
    """Asks for a processor that there is not, and flies where only one may be used."""
    for _ in range(n):
        with make() as rig:
            ended = rig.run("fly", "--cpu", "99", "--duration", "1s")
            demand(ended.code not in (0, None) and "99" in ended.err + ended.out, f"{ended}")
            rig.end_completed(rig.launch(["taskset", "-c", "0", *rig.command("fly", *SHORT)]))
            rig.demand_nothing_left()
            yield {}


def hogs(make, n, policy):
    """Takes the loops' processor away for 0.2 s: ticks are missed and counted, nobody is killed, the replay is identical."""
    for _ in range(n):
        with make() as rig:
            flight = rig.take_off("--on-death", "restart", duration="3s", rt="prefer")
            last = max(os.sched_getaffinity(0))
            spin = "import time,sys\nend = time.monotonic() + 0.2\nwhile time.monotonic() < end: pass"
            if policy == "fifo":
                need_root()
            real_time = ["chrt", "-f", "90"] if policy == "fifo" else []
            for _ in range(2):
                rig.launch(["taskset", "-c", str(last), *real_time, "python3", "-c", spin]).end().expect(0)
            rig.end_completed(flight)
            report = rig.report()
            demand(not report["deaths"], f"killed: {report['deaths']}")
            rig.demand_replay()
            rig.demand_nothing_left()
            yield {"ticks skipped": report["ticks"]["skipped"]}


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


ROWS = [
    *({"name": f"memory.{options.replace('=', '_')}", "fault": f"/dev/shm with {options}", "injector": small_memory,
       "arguments": {"options": options}, "expected": "rejected, /dev/shm named; no SIGBUS", "n": 5,
       "short": int(options == "size=4m")} for options in ("size=64k", "size=1m", "size=4m", "nr_inodes=4")),
    {"name": "memory.fills_up", "fault": "/dev/shm fills up in flight", "injector": memory_fills_up,
     "expected": "completed", "n": 5},
    {"name": "disk.fills_up", "fault": "the log's disk fills up in flight", "injector": small_disk,
     "arguments": {"size": "7m"}, "expected": "completed, INCOMPLETE; dropped messages counted", "n": 3},
    {"name": "limit.fsize", "fault": "files of 8 KiB (ulimit -f)", "injector": limited,
     "arguments": {"limit": "--fsize=8192"}, "expected": "rejected", "n": 5},
    {"name": "limit.nofile", "fault": "16 open files (ulimit -n)", "injector": limited,
     "arguments": {"limit": "--nofile=16"}, "expected": "rejected", "n": 5},
    {"name": "limit.as", "fault": "60 MB address space (ulimit -v)", "injector": limited,
     "arguments": {"limit": "--as=60000000"}, "expected": "rejected", "n": 5, "short": 0},
    {"name": "limit.stack", "fault": "64 KiB stack (ulimit -s)", "injector": limited,
     "arguments": {"limit": "--stack=65536"}, "expected": "rejected", "n": 5, "short": 0},
    {"name": "limit.nproc", "fault": "no more processes (ulimit -u)", "injector": limited,
     "arguments": {"limit": "--nproc=1", "user": "65534"}, "expected": "rejected", "n": 5},
    {"name": "rights.preferred", "fault": "no real-time priority, 64 KiB locked memory, real time preferred",
     "injector": unprivileged, "arguments": {"require": "no"}, "expected": "completed, labelled `other`", "n": 5},
    {"name": "rights.required", "fault": "the same, real time required", "injector": unprivileged,
     "arguments": {"require": "yes"}, "expected": "rejected with code 4, limit named", "n": 5},
    {"name": "processor.absent", "fault": "an absent processor; a single one", "injector": processors,
     "expected": "rejected by name; completed on one processor", "n": 5},
    {"name": "processor.hog", "fault": "ordinary load on the loops' processor for 0.2 s", "injector": hogs,
     "arguments": {"policy": "other"}, "expected": "completed, nothing killed; replay identical", "n": 5},
    {"name": "processor.taken", "fault": "SCHED_FIFO 90 load on the loops' processor for 0.2 s", "injector": hogs,
     "arguments": {"policy": "fifo"}, "expected": "completed, nothing killed; replay identical", "n": 5, "short": 0},
    {"name": "traced", "fault": "strace attached to a loop for 0.5 s", "injector": traced,
     "expected": "completed; replay identical", "n": 5},
    {"name": "clock.stepped", "fault": "the wall clock steps by up to an hour at each reading (preloaded library)",
     "injector": wall_clock, "expected": "no tick lost or doubled; replay identical", "n": 5},
    {"name": "clock.old", "fault": "a monotonic clock of 30 years (time namespace)", "injector": old_machine,
     "expected": "completed; replay identical", "n": 5},
]
