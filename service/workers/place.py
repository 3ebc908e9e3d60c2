"""One of the places of a crew, and the process that has it now."""

import signal
from dataclasses import dataclass
from typing import NamedTuple

from service.workers.connection import Connection

# A worker that lives no longer than this has died quickly; after so many in a row the service ends.
QUICK_S = 5.0
MOST_QUICK_DEATHS = 4
# How a worker has ended is known so soon, or never: whoever could tell is gone, too.
KNOWN_S = 2.0


class Death(NamedTuple):
    """A worker that is gone; ``exit_code`` is known a little later, negative for a signal."""

    process: int | None
    failure: str
    at_s: float
    exit_code: int | None = None

    @property
    def cause(self) -> str:
        """Why, for a person."""
        if self.failure:
            return self.failure
        if self.exit_code is None:
            return "has ended"
        if self.exit_code < 0:
            return f"was killed by {_signal_name(-self.exit_code)}"
        return f"ended with status {self.exit_code}"


@dataclass(slots=True)
class Place:
    """A worker's place. ``process`` is None until its process has been born."""

    number: int
    connection: Connection
    process: int | None = None
    born_s: float = 0.0
    silent_s: float = 0.0
    quick_deaths: int = 0
    failure: str = ""
    death: Death | None = None  # of the one before, until it has been told

    @property
    def name(self) -> str:
        """What lines for a person call it."""
        return f"worker {self.number + 1}"

    def note_birth(self, process: int, now_s: float) -> None:
        """A process has been forked for this place."""
        self.process, self.born_s, self.silent_s = process, now_s, 0.0

    def note_death(self, connection: Connection, now_s: float) -> None:
        """Its process is gone; the next one gets ``connection``."""
        if self.process is not None:
            is_quick = now_s - self.born_s < QUICK_S
            self.quick_deaths = self.quick_deaths + 1 if is_quick else 0
            self.death = Death(self.process, self.failure, now_s)
        self.connection, self.process, self.failure = connection, None, ""
        self.silent_s = 0.0

    def take_line(self, now_s: float) -> str | None:
        """The line about a death, once it is known how it came and who goes on."""
        death = self.death
        if death is None or self.process is None:
            return None
        if not (death.failure or death.exit_code) and now_s - death.at_s < KNOWN_S:
            return None
        self.death = None
        return f"{self.name} (process {death.process}) {death.cause}; process {self.process}"


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
