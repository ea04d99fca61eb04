"""Files and segments that are broken, cut off, removed, or somebody else's."""

import os
import random
import shutil
import signal
import subprocess
import time

from rig import ROOT, demand, need_root, wait_until

NOBODY = ("setpriv", "--reuid", "65534", "--regid", "65534", "--clear-groups")


def broken(data, draw):
    """The bytes with something wrong: cut off, a part lost or doubled, bits flipped, garbage put in."""
    data = bytearray(data)
    kind, at = draw.randrange(5), draw.randrange(len(data) or 1)
    if kind == 0:
        return data[:at]
    if kind == 1:
        return data[:at] + data[at + draw.randrange(1, 200):]
    if kind == 2:
        return data[:at] + data[at:at + 300] + data[at:]
    if kind == 3:
        for _ in range(draw.randrange(1, 20)):
            data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
        return data
    return data[:at] + draw.randbytes(draw.randrange(1, 300)) + data[at:]


def garbage(make, n, kind):
    """Hands over a file with something wrong at a random place: it is read or refused; no signal, no panic, no hang."""
    draw = random.Random(kind)
    with make() as rig:
        rig.run("fly", "--pace", "lockstep", "--duration", "200ms").expect(0)
        run = (rig.out / "latest").resolve()
        whole = {
            "settings": (run / "settings.toml").read_bytes,
            "airframe": (ROOT / "bench/rig/airframes/crazyflie.toml").read_bytes,
            "points": lambda: b"t,x,y,z,yaw\n" + b"".join(b"%d,%d,0.5,1.0,0\n" % (i, i % 3) for i in range(40)),
            "log": (run / "flight.mcap").read_bytes,
            "report": (run / "report.json").read_bytes,
        }[kind]()
        for _ in range(n):
            file = rig.directory / {"log": "broken.mcap", "report": "report.json", "points": "p.csv"}.get(kind, "f.toml")
            file.write_bytes(broken(whole, draw))
            command = {
                "settings": ("simulate", "--config", file, "--duration", "10ms"),
                "airframe": ("simulate", "--airframe", file, "--duration", "10ms"),
                "points": ("simulate", "--trajectory", file, "--duration", "10ms"),
                "log": ("replay", "--out", rig.out, file, "--verify"),
                "report": ("report", "--out", rig.out, rig.directory),
            }[kind]
            ended = rig.launch([rig.executable, *map(str, command)]).end(30)
            # What rig.started keeps of a trial is not needed any more.
            rig.started.pop()
            demand(ended.code is not None and 0 <= ended.code < 100 and "panicked" not in ended.err, f"{ended}")
            if kind == "log":
                demand(ended.code != 0 or file.read_bytes() == whole, "a broken log is replayed as identical")
            yield {"share refused": int(ended.code != 0)}


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


def in_the_way(make, n, what):
    """Puts something into the place of the instance's directory: refused in words that name it, and it stays."""
    for _ in range(n):
        with make() as rig:
            rig.root.mkdir(mode=0o777)
            rig.root.chmod(0o1777)
            place = rig.root / rig.instance
            if what == "link":
                place.symlink_to("/etc")
            elif what == "foreign":
                need_root()
                place.mkdir()
                os.chown(place, 65534, 65534)
            elif what == "pipe":
                os.mkfifo(place)
            there = place.lstat().st_ino
            rig.run("fly", "--rt", "off", "--duration", "100ms").expect(2).says(str(place))
            demand(place.lstat().st_ino == there, "it is gone")
            rig.demand_nothing_left()
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


def other_user(make, n):
    """Another user looks at, writes to, removes and joins a flight: refused, and the flight loses nothing."""
    for _ in range(n):
        with make() as rig:
            need_root()
            rig.directory.chmod(0o755)
            copy = rig.directory / "ironbird"
            subprocess.run(["cp", rig.executable, copy], check=True)
            flight = rig.take_off(duration="4s")
            tries = [["cat", str(path)] for path in rig.segments()]
            tries += [["truncate", "-s", "0", str(path)] for path in rig.segments()]
            tries += [["rm", "-f", str(path)] for path in rig.segments()[:3]]
            tries += [["kill", str(rig.pid("plant"))], [str(copy), *rig.command("inject", "mass_kg=0.6")[1:]],
                      [str(copy), *rig.command("inner", "--rt", "off")[1:]]]
            for words in tries:
                done = subprocess.run([*NOBODY, *words], env=rig.environment, cwd=rig.directory, capture_output=True,
                                      check=False, timeout=30)
                demand(done.returncode != 0, f"another user may: {words[:2]}")
            result = rig.end_completed(flight).result()
            demand(result["lost"] == "0", f"{result}")
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
    *({"name": f"garbage.{kind}", "fault": f"{words} with random damage", "injector": garbage,
       "arguments": {"kind": kind}, "expected": "read or rejected; no signal, panic or hang", "n": 1000, "short": 10}
      for kind, words in {"settings": "a settings file", "airframe": "an airframe file", "points": "a trajectory file",
                          "log": "a flight log (replay)", "report": "report.json"}.items()),
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
    *({"name": f"in_the_way.{what}", "fault": f"{words} in place of the instance directory", "injector": in_the_way,
       "arguments": {"what": what}, "expected": "rejected by name with code 2; it stays", "n": 5, "short": int(what == "link")}
      for what, words in {"link": "a link", "foreign": "another user's directory", "pipe": "a pipe"}.items()),
    {"name": "directory.read_only", "fault": "read-only root path", "injector": read_only,
     "expected": "rejected by name", "n": 5},
    {"name": "other_user", "fault": "another user reads, writes, removes, signals and joins", "injector": other_user,
     "expected": "rejected each time; completed, nothing lost", "n": 5},
    {"name": "hostile_middleware", "fault": "a middleware configuration in the working directory",
     "injector": hostile_middleware, "expected": "not read; completed", "n": 5},
]
