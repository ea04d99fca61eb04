"""docs/python.md and the examples: what they show is done here."""

import os
import re
import shlex
import subprocess
import sys
import tempfile

import pytest

import ironbird
from conftest import ROOT, executable, needs_adapter

PAGE = ROOT / "docs" / "python.md"
BLOCKS = re.findall(r"^```(\w+)(?: file=(\S+))?\n(.*?)^```$", PAGE.read_text(), flags=re.DOTALL | re.MULTILINE)


def test_a_python_that_is_not_there_is_named(monkeypatch):
    monkeypatch.setenv("IRONBIRD_PYTHON", "/nowhere/python")
    result = subprocess.run([ROOT / "python/build"], capture_output=True, text=True)
    assert result.returncode == 2 and result.stderr == "error: there is no Python: /nowhere/python\n", result


def test_what_is_no_python_is_named(monkeypatch):
    monkeypatch.setenv("IRONBIRD_PYTHON", "/bin/ls")
    result = subprocess.run([ROOT / "python/build"], capture_output=True, text=True)
    said = "error: /bin/ls is no Python: name one in IRONBIRD_PYTHON, or unset it\n"
    assert result.returncode == 2 and result.stderr == said, result


@needs_adapter
@pytest.mark.filterwarnings("ignore:this build has uncommitted changes")
def test_the_page_does_what_it_shows(rig, ironbird_command, tmp_path, capsys):
    scope: dict = {}
    shown = [line for language, _, text in BLOCKS if language == "sh" for line in text.splitlines()]
    for language, file, text in BLOCKS:
        if file:
            (tmp_path / file).write_text(text)
        elif language == "python":
            exec(compile(text, str(PAGE), "exec"), scope)
        for line in text.splitlines() if language == "sh" else []:
            command, *flags = shlex.split(line)
            if flags[:2] == ["-m", "venv"]:
                subprocess.run([command, *flags], check=True)
                continue
            if command == ".":
                subprocess.run(["sh", "-e", "-c", f'{line}; test "$VIRTUAL_ENV" -ef .venv'], check=True)
                continue
            # The gate runs the first of them; the other one has a test of its own.
            if command in ("python/build", "python/measure"):
                continue
            assert command == "ironbird", line
            result = ironbird_command(*flags)
            # A busy machine can throw a flight in real time; a law that fails ends it with another code.
            allowed = (0, 3) if flags[0] == "fly" else (0,)
            assert result.returncode in allowed, f"{line}\n{result.stderr}"
    assert shown.index("python3 -m venv .venv") < shown.index(". .venv/bin/activate") < shown.index("python/build")
    assert (tmp_path / "flight.png").read_bytes()[1:4] == b"PNG"
    assert capsys.readouterr().out.startswith("<Flight lissajous, 20001 ticks, estimating + adaptive + roll_pitch_first: completed, ")
    law = next(text for _, file, text in BLOCKS if file == "my_law.py")
    assert law == (ROOT / "python" / "examples" / "angles.py").read_text()


@needs_adapter
def test_a_law_in_python_flies_as_the_tutorial_says(tmp_path):
    page = (ROOT / "docs" / "your-law.md").read_text()
    section = page.split("\n## In Python\n")[1].split("\n## ")[0]
    commands = [line.strip() for line in section.splitlines() if line.startswith("    ")]
    assert len(commands) >= 5
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "ironbird").symlink_to(executable())
    with tempfile.TemporaryDirectory(prefix="ironbird-") as root:
        path = f"{tmp_path / 'bin'}:{os.environ['PATH']}"
        typed = subprocess.run(
            ["sh", "-e", "-c", "\n".join(commands)],
            cwd=tmp_path,
            env=os.environ | {"IRONBIRD_ROOT": root, "PATH": path},
            capture_output=True,
            text=True,
            timeout=300,
        )
    assert typed.returncode == 0, typed.stdout + typed.stderr
    assert "identical" in typed.stdout, typed.stdout


@pytest.mark.parametrize("has_matplotlib", [True, False])
def test_the_sweep_draws_or_prints(tmp_path, has_matplotlib):
    if not has_matplotlib:
        (tmp_path / "matplotlib.py").write_text("raise ImportError\n")
    example = ROOT / "python" / "examples" / "sweep.py"
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "MPLBACKEND": "svg"}
    command = [sys.executable, str(example)]
    result = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, result.stderr
    if has_matplotlib:
        assert "estimating" in (tmp_path / "sweep.svg").read_text()
    else:
        head, *rows = (line.split() for line in result.stdout.splitlines())
        assert head[2:] == ["-20", "-10", "+0", "+10", "+20", "+30"]
        sags = {law: dict(zip(head[2:], map(float, values), strict=False)) for law, *values in ([*row[:7]] for row in rows)}
        # The outer loop that learns the mass returns to its height.
        assert sags["pd"]["+10"] > 20 > abs(sags["estimating"]["+30"])
    assert len(example.read_text().splitlines()) <= 30


@needs_adapter
def test_loops_are_measured(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- python/measure -->\nold\n<!-- end -->\nafter\n")
    environment = os.environ | {"IRONBIRD": str(executable())}
    command = [sys.executable, str(ROOT / "python" / "measure"), "--pairs", "1", "--seconds", "1", "--page", str(page)]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, result.stderr
    text = page.read_text()
    assert text.startswith("before\n<!-- python/measure -->\n| inner law") and text.endswith("<!-- end -->\nafter\n")
    row = next(line for line in text.splitlines() if "angles.py" in line)
    assert all(float(cell) >= 0 for cell in row.strip("| ").split(" | ")[1:])


def test_the_module_says_what_it_has():
    for name in ironbird.__all__:
        assert getattr(ironbird, name).__doc__ or name in ("Array", "InnerLaw", "OuterLaw"), name
