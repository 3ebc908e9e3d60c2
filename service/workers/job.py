"""What a worker is told when it begins, and what it tells while it works."""

from collections import Counter
from typing import NamedTuple

from drivers.events import VehicleId
from estimator.profile import Profile
from service.counts import Counts
from service.departures import DepartedCounts

# What comes between two ticks counts at the next one: a fifth of a period's delay costs little age,
# and a fleet's frames come a few times a tick instead of one by one.
GATHERED_SHARE = 0.2
LONGEST_GATHER_S = 0.008


class Inheritance(NamedTuple):
    """What a worker takes over of a vehicle from one that has died."""

    profile: Profile | None  # None: the one in the job
    counts: Counts


class Job(NamedTuple):
    """How to work. All workers tick at ``begin_s`` (monotonic clock) and whole periods after it.

    With ``as_records`` attitudes are handed back as records, with their samples, else as they are
    published.
    """

    profile: Profile
    gain: float | None
    rate_hz: float
    system_id: int | None
    fits_built_in: bool
    request_rate_hz: float | None
    references: bool
    as_records: bool
    begin_s: float
    inherited: dict[VehicleId, Inheritance]

    @property
    def gather_s(self) -> float:
        """How long the service, and each worker again, collects frames before handling them."""
        return min(LONGEST_GATHER_S, GATHERED_SHARE / self.rate_hz)


class Tally(NamedTuple):
    """What a worker has counted so far."""

    ticks: int = 0
    overruns: int = 0
    dropped: int = 0
    departed: DepartedCounts = DepartedCounts()
    vehicles: dict[VehicleId, Counts] = {}  # noqa: RUF012 - never changed
    refused: Counter[str] = Counter()  # noqa: RUF012 - likewise; frames

    def plus(self, other: "Tally") -> "Tally":
        """Both together; ``ticks`` are those of the one that has made more."""
        return Tally(
            max(self.ticks, other.ticks),
            self.overruns + other.overruns,
            self.dropped + other.dropped,
            self.departed.plus(other.departed),
            self.vehicles | other.vehicles,
            self.refused + other.refused,
        )


class ProfileRequest(NamedTuple):
    """A partial profile for a vehicle."""

    number: int
    vehicle: VehicleId
    partial: dict[str, object]


class ProfileAnswer(NamedTuple):
    """The whole profile, or None and why it stays what it was."""

    number: int
    profile: Profile | None
    refusal: str = ""
