"""The table of a comparison: its sides are installed, measured in turn on one processor, and written with their ratios."""

import functools
import os
import platform
import re
import shutil
import statistics
import venv
from dataclasses import dataclass
from pathlib import Path
from typing import Callable

from rounds import (Absent, alternate, call, commit, conditions, loops_processor, ratios, spread, table, target, write_part)

HERE = Path(__file__).resolve().parent
PEERS = target() / "peers"
DEBIAN = PEERS / "debian"


@dataclass
class Side:
    peer: str
    what: str
    # Gives the version and a function that measures once; raises Absent where the peer is not available.
    install: Callable
    # Key of the side that this one is compared with.
    base: str = ""

    @property
    def key(self):
        return f"{self.peer}, {self.what}"


def figure(name, form=".1f"):
    return lambda results, _: spread([result[name] for result in results], form)


def times(name, form=".2f"):
    """A side's figure over that of its base in the same round."""
    def cell(results, base):
        if base is None or base is results:
            return "-" if base is None else "1"
        return spread(ratios(*([result[name] for result in side] for side in (results, base))), form)

    return cell


STEAL = ("steal %", lambda results, _: f"{statistics.mean(result['steal_percent'] for result in results):.1f}")


def compare(args, name, sides, columns, is_pinned=True):
    """Measures the sides that are there, on one processor if pinned, prints their table, and writes it with --write."""
    PEERS.mkdir(parents=True, exist_ok=True)
    found = installed(sides, args.without)
    facts = conditions()
    if is_pinned:
        os.sched_setaffinity(0, {loops_processor()})
    results = alternate({key: measure for key, (_, measure) in found.items() if measure}, args.rounds)
    rows, numbers = [], []
    for side in sides:
        version, measure = found[side.key]
        measured = results[side.key] if measure else version
        is_there = isinstance(measured, list)
        base = results.get(side.base) if isinstance(results.get(side.base), list) else None
        cells = [cell(measured, base) for _, cell in columns] if is_there else ["-"] * len(columns)
        rows.append([side.peer, side.what, version if is_there else measured, *cells])
        numbers.append({"peer": side.peer, "what": side.what, "version": version, "measured": measured})
    facts = f"{facts}; Python {platform.python_version()}; {args.rounds} rounds"
    text = f"{table(['peer', 'what', 'version', *(heading for heading, _ in columns)], rows)}\n\nMeasured at {facts}."
    print(text)
    if args.write:
        write_part(args.write, f"bench/peers/run {name}", name, text, {"facts": facts, "sides": numbers})


def installed(sides, without):
    """Version and function to measure by the key of each side; the reason and None where there is none."""
    found = {}
    for side in sides:
        try:
            found[side.key] = ("left out", None) if side.peer in without else side.install()
        except Absent as error:
            found[side.key] = (f"not installed: {error}", None)
    return found


def pip(environment, *packages, command="install"):
    """Installs packages from PyPI into an environment of their own; its interpreter."""
    python = PEERS / environment / "bin" / "python"
    if not python.exists():
        venv.create(PEERS / environment, with_pip=True)
    path = os.pathsep.join([os.environ["PATH"], str(python.parent)])
    call([python, "-m", "pip", command, "--quiet", "--disable-pip-version-check", *packages], env={**os.environ, "PATH": path})
    return python


@functools.cache
def debian(*packages):
    """Unpacks packages of this system's release, with what they need and the system lacks; the version of the first."""
    said = call(["apt-get", "install", "--simulate", "--no-install-recommends", *packages])
    needed = re.findall(r"^Inst (\S+)", said, re.MULTILINE)
    archives = DEBIAN / "archives"
    archives.mkdir(parents=True, exist_ok=True)
    if not all(list(archives.glob(f"{package}_*.deb")) for package in needed):
        call(["apt-get", "download", *needed], cwd=archives)
        for archive in archives.glob("*.deb"):
            call(["dpkg-deb", "--extract", archive, DEBIAN])
    shown = re.search(r"Version: (\S+)", call(["apt-cache", "show", "--no-all-versions", packages[0]]))
    return shown[1]


@functools.cache
def multiarch():
    """The system's name in the paths of Debian's packages."""
    return call(["cc", "-print-multiarch"]).strip()


def debian_libraries():
    """Where the unpacked libraries are."""
    return DEBIAN / "usr" / "lib" / multiarch()


def cargo(manifest, package, *options, **environment):
    """Builds a crate that is not part of the workspace; the version of its package, and the directory of what is built."""
    directory = PEERS / "-".join([manifest.parent.name, *options[1:]])
    command = ["cargo", "build", "--release", "--locked", "--manifest-path", manifest, "--target-dir", directory, *options]
    call(command, env={**os.environ, **environment})
    version = re.search(f'name = "{package}"\nversion = "([^"]+)"', manifest.with_name("Cargo.lock").read_text())[1]
    return version, directory / "release"


def qdldl(archives, package):
    """A CMake file that points the build of peng_quad's solver, which clones QDLDL from GitHub, to the copy on PyPI."""
    pointer = archives / "qdldl.cmake"
    if not pointer.exists():
        pip("cmake", "--no-deps", "--no-binary", "qdldl", "--dest", archives, package, command="download")
        (archive,) = archives.glob("qdldl-*.tar.gz")
        shutil.unpack_archive(archive, archives)
        sources = archives / archive.name.removesuffix(".tar.gz") / "c" / "qdldl"
        pointer.write_text(f'set(FETCHCONTENT_SOURCE_DIR_QDLDL "{sources}" CACHE PATH "" FORCE)\n')
    return pointer
