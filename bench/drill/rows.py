"""The rows of the drill: each fault with its injector, what is expected, and how often it is tried."""

from dataclasses import dataclass, field
from typing import Callable

import machine
import matrix
import messages
import processes


# What flies in lockstep or is refused before it flies: no busy machine makes it come out otherwise.
NOT_TIMED = (messages.forged, messages.missing, machine.small_disk, machine.read_only, machine.hostile_middleware,
             processes.tilted)
# What a trial is where it is not a flight of its own, and whether such trials share a flight.
TRIALS = {
    messages.forged: ("message", False), messages.flipped: ("flipped bit that reached a port", True),
    messages.flood: ("change", True), messages.killed_clients: ("client", True), messages.observers: ("observer", True),
    processes.in_a_row: ("failure", True), processes.pause: ("pause", True),
}


@dataclass(frozen=True)
class Row:
    name: str
    fault: str
    # What is called with a rig's maker and the number of trials; yields a trial's figures, or raises Wrong.
    injector: Callable
    expected: str
    n: int
    # In the short form; 0 is not at all, except where a page is written.
    short: int = 1
    arguments: dict = field(default_factory=dict)
    # Guards (shared/messages/src/checks.rs) whose absence must turn this row red.
    guards: tuple = ()

    @property
    def is_timed(self):
        """Whether it flies against the clock: one failed flight of it is flown again, and both are counted."""
        return self.injector not in NOT_TIMED

    @property
    def trial(self):
        return TRIALS.get(self.injector, ("flight", False))[0]

    @property
    def shares_flights(self):
        return TRIALS.get(self.injector, ("flight", False))[1]

    def injector_name(self):
        words = ", ".join(f"{value}" for value in self.arguments.values())
        return f"{self.injector.__module__}.{self.injector.__name__}({words})"


GROUPS = {"Processes": processes.ROWS, "Messages": messages.ROWS, "Machine": machine.ROWS, "Fault matrix": matrix.ROWS}


def rows():
    return [(group, Row(**row)) for group, of in GROUPS.items() for row in of]
