"""Checks of one vehicle's estimate: is it finite, does anything contradict it, what of its compass.

Each check that begins or ceases to fail is reported once.
"""

from math import degrees

from estimator.aiding.compass import CONTRADICTED
from estimator.estimator import Estimator
from estimator.profile import Profile
from estimator.types import Attitude, ImuSample
from service.alarms import LEANING_DEG, MEANINGS, Alarm, Alarms

# A compass that is this far off may be mounted otherwise than its orientation says; iron does less.
LEAST_TURNED_DEG = 40


class EstimateChecks:
    """The alarms of one vehicle, and what has been reported of them."""

    def __init__(self) -> None:
        self.profile_is_unfit = False  # by the vehicle's own word
        self._alarms = Alarms()
        self._reported: frozenset[Alarm] = frozenset()
        self._compass_reported: set[str] = set()

    @property
    def words(self) -> frozenset[Alarm]:
        """The alarms that stand now."""
        return frozenset(self._alarms.words)

    @property
    def in_words(self) -> str:
        """The same for a person; empty without any."""
        return " and ".join(sorted(MEANINGS[each] for each in self._alarms.words))

    def restart(self) -> None:
        """Forget what was seen of another estimate."""
        self._alarms = Alarms()

    def is_due(self, time_us: int) -> bool:
        """Whether it is time to look, twice a second of the vehicle's clock."""
        return self._alarms.is_due(time_us)

    def look(
        self,
        sample: ImuSample,
        arrival_us: int,
        attitude: Attitude,
        profile: Profile,
        estimator: Estimator,
    ) -> tuple[list[str], bool]:
        """Look once; lines for a person, and whether the gyroscope is contradicted."""
        # what contradicts the vertical is in sigma, and costs more to ask for
        is_sure = degrees(attitude.sigma_inclination_rad) < LEANING_DEG
        leaning_rad = 0.0 if is_sure else estimator.leaning_rad
        axes, place = estimator.contradicted_axes, estimator.place_field
        self._alarms.look(sample, arrival_us, attitude, profile, place, leaning_rad, axes)
        return [*self._compass_lines(estimator), *self._alarm_lines()], any(axes)

    def _compass_lines(self, estimator: Estimator) -> list[str]:
        """Why the compass does not give the heading, once for each reason."""
        why = estimator.compass_doubt
        if not why or why in self._compass_reported:
            return []
        self._compass_reported.add(why)
        if why == CONTRADICTED:
            off_deg = round(degrees(estimator.compass_off_rad))
            asked = "; is its orientation set rightly?" * (abs(off_deg) >= LEAST_TURNED_DEG)
            return [f"velocity shows the heading, not the compass, which is {off_deg}° off{asked}"]
        return [f"heading ±45° until velocity shows it: {why}"]

    def _alarm_lines(self) -> list[str]:
        """The alarms that have begun or ended since the last look."""
        before, now = self._reported, self.words
        if now == before:
            return []
        self._reported = now
        begun = [f"warning: {MEANINGS[word]}" for word in sorted(now - before)]
        ended = [f"no more: {MEANINGS[word]}" for word in sorted(before - now)]
        return [*begun, *ended]
