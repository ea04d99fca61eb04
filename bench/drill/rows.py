"""The rows of the drill: each fault with its injector, what is expected, and how often it is tried."""

from dataclasses import dataclass, field
from typing import Callable

import bodies
import deaths
import files
import messages
import resources
import starts


@dataclass(frozen=True)
class Row:
    name: str
    fault: str
    # What is called with a rig's maker and the number of trials; yields a trial's figures, or raises Wrong.
    injector: Callable
    expected: str
    n: int
    # In the short form; 0 is not at all.
    short: int = 1
    arguments: dict = field(default_factory=dict)
    # Guards (shared/model/src/guards.rs) whose absence must turn this row red.
    guards: tuple = ()

    def injector_name(self):
        words = ", ".join(f"{value}" for value in self.arguments.values())
        return f"{self.injector.__module__}.{self.injector.__name__}({words})"


GROUPS = {
    "Processes": deaths.ROWS,
    "Starts and ends": starts.ROWS,
    "Messages": messages.ROWS,
    "Laws and airframes": bodies.ROWS,
    "Machine": resources.ROWS,
    "Files": files.ROWS,
}


def rows():
    return [(group, Row(**row)) for group, of in GROUPS.items() for row in of]
