"""Runs the executable `ironbird`: keywords become its flags, and its errors exceptions."""

from __future__ import annotations

import difflib
import functools
import inspect
import json
import os
import shutil
import signal
import subprocess
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any, ParamSpec, TypeAlias, TypeVar

import numpy as np

from ironbird._rig import SettingsError

Value: TypeAlias = str | float | os.PathLike[str]
Flag: TypeAlias = Value | None | Iterable[Value] | Mapping[str, Any]
"""The value of a flag: True for a flag without a value, a list for one that may be repeated, a mapping for KEY=VALUE."""


Keywords = ParamSpec("Keywords")
Result = TypeVar("Result")

# Flags whose value is true or false.
BOOLEANS = frozenset({"rehearse"})
PRINTING = {"help", "version", "print_config"}
"""Flags with which a command has no result."""


class CommandError(RuntimeError):
    """The executable failed; `code` is its exit code (`ironbird docs architecture`)."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


def hinting(function: Callable[Keywords, Result]) -> Callable[Keywords, Result]:
    """The same function; its error about an unknown keyword names the one that may have been meant."""
    known = list(inspect.signature(function).parameters)

    @functools.wraps(function)
    def checked(*arguments: Keywords.args, **keywords: Keywords.kwargs) -> Result:
        for name in keywords.keys() - known:
            like = difflib.get_close_matches(name, known, 1)
            hint = f"did you mean `{like[0]}`?" if like else f"there are {', '.join(known)}"
            raise TypeError(f"{function.__name__}() has no keyword `{name}`; {hint}")
        return function(*arguments, **keywords)

    return checked


def executable() -> str:
    """The executable: that of the variable IRONBIRD, else the one installed with this module, else `ironbird` on PATH."""
    if named := os.environ.get("IRONBIRD"):
        if found := shutil.which(named):
            return found
        raise FileNotFoundError(f"IRONBIRD={named} is no executable; name the executable `ironbird`, or unset the variable")
    try:
        files = metadata.files("ironbird") or []
    except metadata.PackageNotFoundError:
        files = []
    installed = (str(file.locate()) for file in files if file.name == "ironbird")
    on_path = shutil.which("ironbird")
    for path in (*installed, *([on_path] if on_path else [])):
        if os.access(path, os.X_OK) and not os.path.isdir(path):
            return path
    raise FileNotFoundError(
        "there is no executable `ironbird`: put it on PATH (cargo install --path bench/cli), or name it in the variable IRONBIRD"
    )


def run(*command: str | os.PathLike[str], **flags: Flag) -> subprocess.CompletedProcess[str]:
    """Runs a command to its end, whatever its exit code; Ctrl-C ends it in order.

    Raises:
        FileNotFoundError: there is no executable.
        SettingsError: a flag or a setting is unknown, or not what it may be.
        TypeError: a flag only prints, or its value is of no type that a flag has.
    """
    for name in {name for name in PRINTING if flags.get(name)}:
        raise TypeError(f"{name}: this flag prints a text and flies nothing: leave it out, or run `ironbird {command[0]} --{name.replace('_', '-')}`")
    line = [executable(), *(os.fspath(word) for word in command), *arguments(flags)]
    # In a group of its own, so that Ctrl-C reaches it once, from here; it ends with this process.
    process = subprocess.Popen(
        [*line, "--launcher", str(os.getpid())],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        process_group=0,
    )
    try:
        out, err = process.communicate()
    except BaseException:
        process.send_signal(signal.SIGINT)
        process.communicate()
        raise
    done = subprocess.CompletedProcess(line, process.returncode, out, err)
    if done.returncode == 2:
        raise SettingsError(_error(done))
    for text in err.splitlines():
        if text.startswith("warning: "):
            warnings.warn(text.removeprefix("warning: "), stacklevel=3)
    return done


def expect(done: subprocess.CompletedProcess[str], *codes: int) -> str:
    """What a command printed, if its exit code is one of these."""
    if done.returncode not in codes:
        raise failed(done)
    return done.stdout


def failed(done: subprocess.CompletedProcess[str]) -> CommandError:
    """The exception of a command that did not do what it was to do."""
    return CommandError(_error(done), done.returncode)


def place(out: str, key: str) -> str | None:
    """The directory that the RESULT line of a command ends with."""
    result = [line for line in out.splitlines() if line.startswith("RESULT ")]
    return result[-1].partition(f" {key}=")[2] if result else None


def _error(done: subprocess.CompletedProcess[str]) -> str:
    text = done.stderr[done.stderr.find("error: ") :].removeprefix("error: ").strip()
    return text or f"{Path(done.args[0]).name} {done.args[1]} ended with exit code {done.returncode}"


def arguments(flags: Mapping[str, Flag]) -> Iterator[str]:
    """Keywords as flags, in their order: `max_miss_rate=100` is `--max-miss-rate 100`."""
    for name, value in flags.items():
        value = _plain(value)
        flag = "--" + name.rstrip("_").replace("_", "-")
        if isinstance(value, Mapping):
            yield from (f"{flag}={key}={text}" for key, text in _settings(value))
        elif isinstance(value, bool) and name in BOOLEANS:
            yield f"{flag}={str(value).lower()}"
        elif value is True:
            yield flag
        elif value is None or value is False:
            continue
        elif isinstance(value, str | int | float):
            yield f"{flag}={value}"
        elif isinstance(value, Iterable):
            yield from (argument for one in value for argument in arguments({name: one}))
        else:
            raise TypeError(
                f"{name}: expected a text, a number, True, a list or a mapping, not {type(value).__name__}"
                + ("; a law in Python flies here from its file, a function in simulate()" if callable(value) else "")
            )


def _settings(values: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, str]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _settings(value, f"{path}{key}.")
        else:
            value = _plain(value)
            yield f"{path}{key}", value if isinstance(value, str) else json.dumps(value, default=_encoded)


def _encoded(value: Any) -> Any:
    """A value inside a list, which JSON does not know."""
    plain = _plain(value)
    if plain is value:
        raise TypeError(f"expected a text, a number, a list or a mapping, not {type(value).__name__}")
    return plain


def _plain(value: Any) -> Any:
    """A number or array of NumPy as Python's own, and a path as a text."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return os.fspath(value) if isinstance(value, os.PathLike) else value
