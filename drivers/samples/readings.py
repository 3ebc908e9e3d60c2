"""One IMU message's vectors, and a sensor's equal readings in a row."""

from dataclasses import dataclass
from math import log
from typing import NamedTuple

from estimator.types import Vec3

NOISY_SAMPLES = 50  # that many changes before prove that a sensor has noise
STUCK_SAMPLES = 20  # equal readings
STUCK_US = 500_000
SHARE_CHANGES = 200  # the share of equal readings goes back over so many changes
# Equal readings are unlikely where chance would bring so many in a row less than once in 1e8
# times. So rarely, since a smooth motion in coarse digits repeats itself more often than chance.
BY_CHANCE = 1e-8
HELD_SAMPLES = 3  # at least


class Readings(NamedTuple):
    """One IMU message's vectors."""

    gyr_rad_s: Vec3
    acc_m_s2: Vec3
    mag_gauss: Vec3


@dataclass(slots=True)
class Repetition:
    """Counts a sensor's equal readings, and knows how often it repeats itself.

    ``is_proven`` is for whoever finds that what is repeated cannot be true; the next change of the
    reading takes it back.
    """

    changes: int = 0
    equal: int = 0  # readings since the last change
    begin_us: int = 0  # when they began
    is_proven: bool = False
    changed: float = 1.0  # pairs of readings, lately
    repeated: float = 1.0

    def observe(self, raw_us: int, *, repeats: bool) -> None:
        """Take a reading's time, and whether it repeats the last."""
        if repeats:
            self.equal += 1
            self.begin_us = min(self.begin_us, raw_us)  # the clock may have begun anew
            return
        self.changes += 1
        if self.changed >= SHARE_CHANGES:
            self.changed *= 0.5
            self.repeated *= 0.5
        self.changed += 1.0
        self.repeated += self.equal
        self.equal, self.begin_us, self.is_proven = 0, raw_us, False

    def is_long(self, raw_us: int) -> bool:
        """Whether a noisy sensor has repeated itself for long enough to look closer."""
        is_long = self.equal >= STUCK_SAMPLES and raw_us - self.begin_us >= STUCK_US
        return is_long and self.changes >= NOISY_SAMPLES

    def is_unlikely(self) -> bool:
        """Whether chance does not explain the equal readings."""
        if self.equal < HELD_SAMPLES or self.changes < NOISY_SAMPLES:
            return False
        share = self.repeated / (self.repeated + self.changed)
        return self.equal * log(share) < log(BY_CHANCE)
