"""The executable whose word the module is held to."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
ADAPTER = TARGET / "release" / "libironbird_python.so"
"""python/build makes it; a machine that has all tools has it."""
needs_adapter = pytest.mark.skipif(
    not ADAPTER.exists() and "IRONBIRD_TEST_ALL" not in os.environ, reason=f"there is no {ADAPTER}"
)
Ironbird = Callable[..., subprocess.CompletedProcess[str]]


def executable() -> Path:
    """That of `IRONBIRD`; else the newest of this checkout."""
    built = [path for profile in ("release", "debug") if (path := TARGET / profile / "ironbird").exists()]
    said = [Path(os.environ["IRONBIRD"])] if "IRONBIRD" in os.environ else []
    if not (said or built):
        pytest.fail("there is no executable: cargo build --release, or name one in IRONBIRD")
    return (said or sorted(built, key=lambda path: path.stat().st_mtime))[-1]


@pytest.fixture(autouse=True)
def adapter(monkeypatch: pytest.MonkeyPatch) -> None:
    """The adapter that python/build has built, and this Python."""
    monkeypatch.setenv("IRONBIRD_PYTHON_ADAPTER", str(ADAPTER))
    monkeypatch.setenv("IRONBIRD_PYTHON", sys.executable)


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Commands of the module run that executable in an empty directory, with instances of their own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("IRONBIRD", str(executable()))
    with tempfile.TemporaryDirectory(prefix="ironbird-") as root:
        monkeypatch.setenv("IRONBIRD_ROOT", root)
        yield


@pytest.fixture
def ironbird_command(tmp_path: Path) -> Iterator[Ironbird]:
    """Runs `ironbird` in an empty directory, with an instance of its own."""

    # Its path must be short.
    with tempfile.TemporaryDirectory(prefix="ironbird-") as root:

        def run(*arguments: object) -> subprocess.CompletedProcess[str]:
            environment = os.environ | {"IRONBIRD_ROOT": root}
            command = [str(executable()), *map(str, arguments)]
            return subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120)

        yield run
