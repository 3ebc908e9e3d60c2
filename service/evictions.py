"""Which vehicles have been silent for so long that they are forgotten, and what is kept of them."""

from collections import Counter

from drivers.events import VehicleId
from estimator.profile import Profile

# A battery is changed, a flight goes out of reach and comes back: that is still the same vehicle.
FORGOTTEN_US = 3_600_000_000
# Between two looks no more than this counts as silence: the host's clock may have been set.
LONGEST_LOOK_US = 60_000_000
MOST_PROFILES = 512  # of vehicles that are gone; the one that left first goes


class Evictions:
    """Counts silence by the time between looks. Times are given."""

    def __init__(self) -> None:
        # what was counted of the vehicles that were forgotten, as of one that is there
        self.counts = Counter(vehicles=0, samples=0, shed=0, rejected=0, attitudes=0)
        self._silence_us: dict[VehicleId, tuple[int, int]] = {}  # last arrival, and silence since
        self._looked_us: int | None = None
        self.profiles: dict[VehicleId, Profile] = {}  # kept of those that are gone

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

    def keep(self, address: VehicleId, profile: Profile) -> None:
        """Keep the parameters that somebody gave a vehicle, for when it comes back."""
        self.profiles[address] = profile
        if len(self.profiles) > MOST_PROFILES:
            del self.profiles[next(iter(self.profiles))]
