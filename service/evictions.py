"""Which vehicles have been silent for so long that they are forgotten, and what is kept of them."""

from collections import OrderedDict
from operator import add
from typing import NamedTuple

from drivers.events import VehicleId
from estimator.profile import Profile
from service.lines import LineLimit
from service.records import vehicle_name

# A battery is changed, a flight goes out of reach and comes back: that is still the same vehicle.
FORGOTTEN_US = 3_600_000_000
# Between two looks no more than this counts as silence: the host's clock may have been set.
LONGEST_LOOK_US = 60_000_000
MOST_PROFILES = 512  # of vehicles that are gone; the one that left first goes


class EvictedCounts(NamedTuple):
    """What is counted of the vehicles that were forgotten."""

    vehicles: int = 0
    samples: int = 0  # theirs, as in the counts of one that is there
    shed: int = 0
    rejected: int = 0
    attitudes: int = 0

    def plus(self, other: "EvictedCounts") -> "EvictedCounts":
        """Both together."""
        return EvictedCounts(*map(add, self, other))


class Evictions:
    """Counts silence by the time between looks. Times are given."""

    def __init__(self) -> None:
        self.counts = EvictedCounts()  # so far
        self._limit = LineLimit("vehicles")
        self._silence_us: dict[VehicleId, tuple[int, int]] = {}  # last arrival, and silence since
        self._looked_us: int | None = None
        self._profiles: OrderedDict[VehicleId, Profile] = OrderedDict()

    def look(self, heard_us: dict[VehicleId, int], now_us: int) -> list[VehicleId]:
        """The vehicles to forget, given when each was heard last."""
        step_us = 0 if self._looked_us is None else now_us - self._looked_us
        step_us = min(max(step_us, 0), LONGEST_LOOK_US)
        self._looked_us = now_us
        known = self._silence_us
        self._silence_us = {}
        for address, last_us in heard_us.items():
            before_us, silence_us = known.get(address, (None, 0))
            silence_us = silence_us + step_us if before_us == last_us else 0
            self._silence_us[address] = (last_us, silence_us)
        return [each for each, (_, us) in self._silence_us.items() if us >= FORGOTTEN_US]

    def lines(self, gone: list[VehicleId], now_us: int) -> list[str]:
        """Lines about vehicles that are forgotten, fewer of them where there are too many."""
        texts = [f"vehicle {vehicle_name(each)}: gone, and forgotten" for each in gone]
        return self._limit.lines(texts, now_us)

    def keep(self, address: VehicleId, profile: Profile) -> None:
        """Keep the parameters that somebody gave a vehicle, for when it comes back."""
        self._profiles[address] = profile
        if len(self._profiles) > MOST_PROFILES:
            self._profiles.popitem(last=False)

    def take_profile(self, address: VehicleId) -> Profile | None:
        """The parameters that were kept for a vehicle, once."""
        return self._profiles.pop(address, None)
