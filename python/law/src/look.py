"""Looks at a law in Python before it flies: where it stands, what it is called, its settings and its telemetry."""

import ast
import hashlib
import inspect
import math
import os
import pickle
import re
import sys
import textwrap
import traceback
import types

NAME = re.compile("[a-z][a-z0-9_]*")
LONGEST_NAME = 40
MOST_SIGNALS = 32
KEYS = ("default", "min", "max", "words", "unit", "meaning")
"""Places of laws that could not be saved: each is said once."""
UNSAVED = set()
TICK = {"outer": "tick(self, tick, measured, reference)", "inner": "tick(self, tick, measured, wanted, reference)"}


class Refused(Exception):
    """A law that cannot fly: its place, and what to do."""


def look(law, role):
    """What a function, an object with `tick`, or a class of such says of itself, for a role."""
    if inspect.isclass(law):
        return look_at_class(law, role)
    tick = getattr(law, "tick", law)
    if not callable(tick):
        expected = "a function, an object with `tick`, a class of such, or a name"
        raise TypeError(f"{role}: expected {expected}, not {type(law).__name__}")
    name = getattr(law, "__name__", type(law).__name__)
    place = f"{place_of(tick)}: `{name}`"
    return {
        "law": law,
        "file": place_of(tick),
        "path": path_of(tick),
        "role": role,
        "name": name,
        "version": "1",
        "summary": "",
        "source": "",
        "place": place,
        "telemetry": telemetry_of(law, place),
        "settings": [],
    }


def look_at_class(law, role=None):
    """What a class with `tick` says of itself."""
    tick = getattr(law, "tick", None)
    if not callable(tick):
        raise Refused(f"the class {law.__name__} has no `tick`: write {TICK[role or 'inner']}")
    place = place_of(tick)
    own = getattr(law, "role", role)
    if own not in TICK:
        raise Refused(f"{place_in(law, 'role')}: {law.__name__}.role = {own!r}: write role = 'outer' or role = 'inner'")
    if role is not None and own != role:
        raise Refused(f"{place_in(law, 'role')}: {law.__name__} is a law of the role {own}, and not of {role}")
    name = getattr(law, "name", law.__name__.lower())
    if not is_name(name):
        raise Refused(f"{place_in(law, 'name')}: name = {name!r}: {asked(name)}")
    return {
        "law": law,
        "file": place,
        "path": path_of(tick),
        "role": own,
        "name": name,
        "version": text_of(law, "version", "1"),
        "summary": text_of(law, "summary", (inspect.getdoc(law) or "").partition("\n")[0] or "a law in Python"),
        "source": text_of(law, "source", ""),
        "place": f"{place}: `{name}`",
        "telemetry": telemetry_of(law, place_in(law, "telemetry")),
        "settings": settings_of(law, place_in(law, "settings")),
    }


def make(law, rig, settings):
    """The `tick` of an object that flies as it is, or of a new one of a class."""
    if not inspect.isclass(law):
        return getattr(law, "tick", law)
    return (law() if law.__init__ is object.__init__ else law(rig, settings)).tick


def save(tick, size, place):
    """The state of the object of a `tick`, in at most `size` bytes: what its `save` gives, or all of its attributes."""
    try:
        law = tick.__self__
        state = bytes(law.save() if hasattr(law, "save") else pickle.dumps(vars(law)))
        if not 0 < len(state) <= size:
            raise ValueError(f"its state has {len(state)} bytes: allowed are 1 to {size}")
        return state
    except Exception as error:
        if place not in UNSAVED:
            UNSAVED.add(place)
            what = "cannot be saved, nor reintegrated after a restart"
            print(f"warning: {place} {what}: {type(error).__name__}: {error}", file=sys.stderr)
        return b""


def restore(tick, state):
    """Whether the object of a `tick` continues from a saved state."""
    try:
        law = tick.__self__
        if hasattr(law, "load"):
            law.load(state)
        else:
            law.__dict__ = pickle.loads(state)
        return True
    except Exception as error:
        print(f"warning: a saved state is not loaded: {type(error).__name__}: {error}", file=sys.stderr)
        return False


def load(path):
    """The class of a file: `Law`, or the one class in it that has a `tick`; and the SHA-256 of the file."""
    try:
        with open(path, "rb") as file:
            source = file.read()
    except OSError as error:
        raise Refused(f"cannot read {path}: {error.strerror}") from None
    # By its path: it is found by who asks for a class's module, as dataclasses do, and hides no other one.
    module = sys.modules[path] = types.ModuleType(path)
    module.__file__ = path
    # What stands beside it can be imported, as for a script.
    folder = os.path.dirname(os.path.abspath(path))
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        exec(compile(source, path, "exec"), module.__dict__)
    except SyntaxError as error:
        raise Refused(f"{error.filename}:{error.lineno}: {error.msg}") from None
    except (Exception, SystemExit) as error:
        raise Refused(describe(error, path)) from None
    own = [thing for thing in vars(module).values() if inspect.isclass(thing) and thing.__module__ == module.__name__]
    laws = [thing for thing in own if callable(getattr(thing, "tick", None))]
    chosen = [thing for thing in laws if thing.__name__ == "Law"] or laws
    if len(chosen) != 1:
        what = f"has {len(chosen)}: {', '.join(thing.__name__ for thing in chosen)}" if chosen else "has none"
        raise Refused(f"{path}: a law is the class `Law`, or the only class with a `tick`; the file {what}")
    look_at_class(chosen[0])
    return chosen[0], hashlib.sha256(source).hexdigest()


def describe(error, path, trace=None):
    """An exception in a line, with its place in the law's file if it was raised there."""
    lines = [frame.lineno for frame in traceback.extract_tb(trace or error.__traceback__) if frame.filename == path]
    place = f"{path}:{lines[-1]}: " if lines else ""
    return f"{place}{type(error).__name__}: {error}"


def settled(law, role, given):
    """The settings of a law: those that are given, each checked, over its defaults."""
    said = look(law, role)
    settings = {setting[0]: setting for setting in said["settings"]}
    for name in given:
        if name not in settings:
            raise Refused(f"settings: {role}.{name}: the law `{said['name']}` has no such setting")
    return {name: value_of(setting, given.get(name), role) for name, setting in settings.items()}


def value_of(setting, given, role):
    """The value of a setting: a number, an array of three, or a word."""
    import numpy

    name, unit, _, numbers, low, high, words = setting
    key = f"settings: {role}.{name} = {given!r}"
    if words:
        if given is not None and given not in words:
            raise Refused(f"{key} is out of range: allowed is {' or '.join(map(repr, words))}")
        return words[0] if given is None else given
    try:
        value = numpy.array(numbers if given is None else given, dtype=float).reshape(-1)
    except (TypeError, ValueError):
        value = numpy.array([])
    if len(value) != len(numbers):
        raise Refused(f"{key}: expected {'a number' if len(numbers) == 1 else 'three numbers'}")
    if not (numpy.isfinite(value).all() and (value >= low).all() and (value <= high).all()):
        raise Refused(f"{key} is out of range: allowed is {low:g} to {high:g} {unit}".rstrip())
    return float(value[0]) if len(numbers) == 1 else value


def code_of(function):
    """The code of a function; none of one that is not written in Python."""
    return getattr(inspect.unwrap(function), "__code__", None)


def path_of(function):
    """File of a function; its name where it has none."""
    code = code_of(function)
    return code.co_filename if code else getattr(function, "__name__", type(function).__name__)


def place_of(function):
    """File and line of a function; its name where it has none."""
    code, path = code_of(function), path_of(function)
    return f"{path}:{code.co_firstlineno}" if code else path


def place_in(law, attribute):
    """File and line of a class's attribute; else of the class, or of its `tick` where there is no source to look at."""
    said = next((base for base in law.__mro__ if attribute in vars(base)), law)
    try:
        lines, first = inspect.getsourcelines(said)
        body = ast.parse(textwrap.dedent("".join(lines))).body[0].body
        file = inspect.getsourcefile(said)
    except Exception:
        return place_of(law.tick)
    for line in body:
        targets = line.targets if isinstance(line, ast.Assign) else [getattr(line, "target", None)]
        if any(isinstance(target, ast.Name) and target.id == attribute for target in targets):
            return f"{file}:{first + line.lineno - 1}"
    return f"{file}:{first}"


def is_name(name):
    return isinstance(name, str) and len(name) <= LONGEST_NAME and NAME.fullmatch(name) is not None


def asked(name):
    """What is asked of a name, and the letter that it may not have."""
    snake = f"write it in snake_case, with at most {LONGEST_NAME} letters"
    if not isinstance(name, str):
        return snake
    odd = [letter for letter in name if not re.fullmatch("[a-z0-9_]", letter)]
    if odd:
        return f"{snake}, without {'the capital ' if odd[0].isupper() else ''}{odd[0]!r}"
    return snake if re.match("[a-z]", name) else f"{snake}, and a letter first"


def text_of(law, key, default):
    text = getattr(law, key, default)
    if not isinstance(text, str):
        raise Refused(f"{place_in(law, key)}: {key} = {text!r}: expected a string")
    return text


def telemetry_of(law, place):
    """Names with units: of a mapping from one to the other, or of names alone."""
    shown = getattr(law, "telemetry", ())
    pairs = list(shown.items()) if isinstance(shown, dict) else [(name, "") for name in shown]
    for name, unit in pairs:
        if isinstance(name, str) and not is_name(name):
            raise Refused(f"{place}: telemetry has {name!r}: {asked(name)}")
        if not (isinstance(name, str) and isinstance(unit, str)):
            raise Refused(f"{place}: telemetry has {name!r}: {unit!r}: write names and units as {{'tilt_rad': 'rad'}}")
    if len(pairs) > MOST_SIGNALS:
        raise Refused(f"{place}: telemetry has {len(pairs)} names: a law shows at most {MOST_SIGNALS} numbers")
    return pairs


def settings_of(law, place):
    """(name, unit, meaning, numbers, min, max, words) of each setting: of a number or three the default, or words."""
    settings = getattr(law, "settings", {})
    if not isinstance(settings, dict):
        raise Refused(f"{place}: settings = {settings!r}: expected a dict, as {{'gain_1_s': 8.0}}")
    return [setting_of(name, said, f"{place}: settings") for name, said in settings.items()]


def setting_of(name, said, place):
    if name in ("law", "sha256"):
        raise Refused(f"{place} has the name {name!r}, which is the rig's: give it another one")
    if not is_name(name):
        raise Refused(f"{place} has the name {name!r}: {asked(name)}")
    said = said if isinstance(said, dict) else {"default": said}
    place = f"{place}[{name!r}]"
    unknown = [key for key in said if key not in KEYS]
    if unknown or "default" not in said:
        what = f"an unknown key {unknown[0]!r}" if unknown else "no 'default'"
        raise Refused(f"{place} has {what}: its keys are {', '.join(KEYS)}")
    default, unit, meaning = said["default"], said.get("unit", ""), said.get("meaning", name.replace("_", " "))
    low, high = said.get("min", -sys.float_info.max), said.get("max", sys.float_info.max)
    if isinstance(default, str):
        # The first word is the default.
        words = [default, *(word for word in said.get("words", ()) if word != default)]
        return (name, unit, meaning, [], 0.0, 0.0, words)
    try:
        numbers = [float(number) for number in (default if isinstance(default, (list, tuple)) else [default])]
        low, high = float(low), float(high)
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) not in (1, 3):
        raise Refused(f"{place} has default = {default!r}: write a number, three of them, or a word")
    if not all(math.isfinite(number) and low <= number <= high for number in numbers):
        raise Refused(f"{place} has default = {default!r}, which is not within {low:g} to {high:g}")
    return (name, unit, meaning, numbers, low, high, [])
