"""Transports between four processes in a ring, and ironbird's own flight."""

import functools
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from rounds import executable
from sides import (DEBIAN, HERE, PEERS, STEAL, Absent, Side, call, cargo, compare, debian, debian_libraries, figure, installed,
                   loops_processor, multiarch, table, times)

SOURCES = HERE / "ring"
PERIOD_US, PRIORITY, CHECKED_TICKS = 1000, 80, 1000
# Only this machine's processes, and no multicast.
CYCLONE = ("<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo'/></Interfaces><AllowMulticast>false</AllowMulticast>"
           "</General><Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address='127.0.0.1'/></Peers></Discovery>"
           "</Domain></CycloneDDS>")
STAGES = ("plant", "outer", "inner", "mixer")


def go_around(transport, ticks, period_us=PERIOD_US, is_check=False):
    """A ring's figures; a period of 0 sends again at once."""
    PEERS.mkdir(parents=True, exist_ok=True)
    others = shared_memory()
    with tempfile.TemporaryDirectory() as directory:
        libraries = os.pathsep.join(filter(None, [str(debian_libraries()), os.environ.get("LD_LIBRARY_PATH")]))
        environment = {**os.environ, "TMPDIR": directory, "CYCLONEDDS_URI": CYCLONE, "LD_LIBRARY_PATH": libraries}
        words = [ring(), transport, ticks, period_us, PRIORITY, loops_processor(), int(is_check)]
        process = subprocess.Popen([str(word) for word in words], env=environment, text=True,
                                   stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        said, complaint = process.communicate()
    for left in shared_memory() - others:
        left.unlink(missing_ok=True)
    if process.returncode:
        errors = [line for line in complaint.splitlines() if "error" in line.lower()]
        raise Absent((errors or complaint.splitlines() or ["?"])[0])
    return json.loads(said)


def shared_memory():
    """Files that zenoh leaves behind, and iceoryx2 where a process is killed."""
    return {file for pattern in ("*.zenoh", "ring*_*") for file in Path("/dev/shm").glob(pattern)}


@functools.cache
def ring():
    compiled(PEERS / "ring.program", "ring.c", "-ldl", "-lrt")
    return PEERS / "ring.program"


def compiled(result, *options):
    call(["cc", "-O2", "-I", SOURCES, "-o", result, *options], cwd=SOURCES)


def kernel():
    return f"Linux {platform.release()}", ""


def c_library(name, links, *packages, more=()):
    """A transport library written in C for a Debian package."""
    version, built = debian(*packages), PEERS / f"{name}.so"
    usr = DEBIAN / "usr"
    headers = [f"-I{it}" for it in (PEERS, usr / "include", usr / "include" / multiarch())]
    compiled(built, "-shared", "-fPIC", f"{name}.c", *more, *headers, f"-L{debian_libraries()}", f"-l{links}",
             "-Wl,--allow-shlib-undefined")
    return version, f"{built}:"


def cyclone():
    debian("cyclonedds-dev", "cyclonedds-tools")
    environment = {**os.environ, "LD_LIBRARY_PATH": str(debian_libraries())}
    call([DEBIAN / "usr/bin/idlc", SOURCES / "Sample.idl"], cwd=PEERS, env=environment)
    return c_library("cyclone", "ddsc", "cyclonedds-dev", "cyclonedds-tools", more=[PEERS / "Sample.c"])


def rust_library(package):
    version, built = cargo(SOURCES / "libraries" / "Cargo.toml", package, "--features", package)
    return version, f"{built}/libring_libraries.so:"


@functools.cache
def library(peer):
    """Version, and how `ring` names it but for the variant."""
    return {
        "kernel": kernel,
        "ZeroMQ": lambda: c_library("zeromq", "zmq", "libzmq3-dev"),
        "LCM": lambda: c_library("lcm", "lcm", "liblcm-dev"),
        "Cyclone DDS": cyclone,
        "iceoryx2": lambda: rust_library("iceoryx2"),
        "zenoh": lambda: rust_library("zenoh"),
    }[peer]()


TRANSPORTS = {
    ("kernel", "futex in shared memory"): "futex",
    ("kernel", "eventfd, data in shared memory"): "eventfd",
    ("kernel", "pipe"): "pipe",
    ("kernel", "POSIX message queue"): "queue",
    ("kernel", "unix datagram"): "unix",
    ("kernel", "UDP on loopback"): "udp",
    ("ZeroMQ", "push-pull, ipc"): "push",
    ("ZeroMQ", "publish-subscribe, ipc"): "publish",
    ("LCM", "UDP multicast"): "multicast",
    ("Cyclone DDS", "best effort"): "dds",
    ("iceoryx2", "its listener, blocking"): "blocking",
    ("iceoryx2", "its WaitSet"): "waitset",
    ("zenoh", "unix socket"): "unix",
    ("zenoh", "shared memory"): "shared-memory",
    ("zenoh", "TCP"): "tcp",
}
FLIGHTS = {"a whole flight": (), "no early wake-up, no warm-up run": ("--lead", "0", "--rehearse", "false")}
FLOOR = "kernel, futex in shared memory"


def fly(program, seconds, flags):
    """The same figures of a flight."""
    with tempfile.TemporaryDirectory() as out:
        flown = subprocess.run([program, "fly", "--duration", f"{seconds}s", "--out", out, *flags], capture_output=True, text=True)
        report = Path(out, "latest", "report.json")
        # A deadline that does not hold is no reason to leave the flight out.
        if flown.returncode not in (0, 3) or not report.exists():
            raise Absent((flown.stderr.strip().splitlines() or ["no flight"])[0])
        report = json.loads(report.read_text())
    curve = next(it["curve"] for it in report["distributions"] if it["name"] == "loop")
    quantiles = {"p50_us": 0.5, "p99_us": 0.99, "p999_us": 0.999}
    loop = {name: next(value for share, value in curve if share >= quantile) for name, quantile in quantiles.items()}
    cpu_us = sum(report["roles"][stage]["usage"]["cpu_per_tick_us"] for stage in STAGES)
    return {**loop, "cpu_us": cpu_us, "fifo": "rt=fifo" in flown.stdout}


def sides(seconds=3):
    def transport(peer, variant):
        version, named = library(peer)
        return version, lambda: go_around(named + variant, round(seconds * 1e6 / PERIOD_US))

    def flight(flags):
        program = executable()
        return call([program, "--version"]).split()[1], lambda: fly(program, seconds, flags)

    rings = [Side(peer, what, functools.partial(transport, peer, variant), FLOOR) for (peer, what), variant in TRANSPORTS.items()]
    return rings + [Side("ironbird", what, functools.partial(flight, flags), FLOOR) for what, flags in FLIGHTS.items()]


COLUMNS = [
    ("loop p50 [us]", figure("p50_us")),
    ("p99 [us]", figure("p99_us")),
    ("p99.9 [us]", figure("p999_us")),
    ("processor time per tick [us]", figure("cpu_us")),
    ("p50 / futex", times("p50_us")),
    ("p99 / futex", times("p99_us")),
    ("processor time / futex", times("cpu_us")),
    ("SCHED_FIFO", lambda results, _: "yes" if all(it["fifo"] for it in results) else "refused"),
    STEAL,
]


def check(without):
    """Fails where a transport loses or reorders messages, or changes one."""
    PEERS.mkdir(parents=True, exist_ok=True)
    rows, failed = [], False
    transports = [Side(side.peer, side.what, functools.partial(library, side.peer)) for side in sides() if side.peer != "ironbird"]
    for side, (version, named) in zip(transports, installed(transports, without).values()):
        result = version
        if named is not None:
            try:
                go_around(named + TRANSPORTS[side.peer, side.what], CHECKED_TICKS, is_check=True)
                result = f"{CHECKED_TICKS} messages around the ring, all in order and unchanged"
            except Absent as error:
                result, failed = f"FAILED: {error}", True
        rows.append([side.peer, side.what, result])
    print(table(["peer", "what", "result"], rows))
    sys.exit(1 if failed else 0)


def main(args):
    if args.check:
        check(args.without)
    # The ring and the loops of a flight choose their processor; a flight's recorder has another one.
    compare(args, "ring", sides(args.seconds), COLUMNS, is_pinned=False)
