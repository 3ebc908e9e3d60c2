"""Readings that look like data and are none: of sensors that are stuck, at their end, or leap."""

from dataclasses import dataclass, field
from typing import NamedTuple

from drivers.samples.range_end import (
    MICROSECOND,
    RATE_STEP_RAD_S,
    RATE_STEP_RAD_S2,
    RangeEnd,
    accelerometer_end,
    gyroscope_end,
)
from drivers.samples.readings import NOISY_SAMPLES, Readings
from drivers.samples.steady_turn import largest
from drivers.samples.stuck import NOTHING, StuckImu
from estimator.geometry.quaternion import subtract
from estimator.reasons import Reason
from estimator.types import ZERO_VEC3, Vec3

# While readings are refused for one of these the vehicle may turn unseen, and the first of them
# were believed, until the fault showed.
BLINDING = frozenset(
    {
        Reason.STUCK,
        Reason.GYROSCOPE_STUCK,
        Reason.ACCELEROMETER_STUCK,
        Reason.GYROSCOPE_SATURATED,
    }
)
BLIND_US = 30_000  # from the first refused reading on

MAG_STUCK_SAMPLES = 20
MAG_STUCK_US = 2_000_000
MAG_TURN_RAD = 0.5  # turned so far, the field cannot be what it was


class Blindness(NamedTuple):
    """A stretch of refused readings: why, and for how long."""

    reason: Reason
    span_us: int


@dataclass(slots=True)
class StuckField:
    """Finds a field that does not follow the vehicle's turning."""

    changes: int = 0
    equal: int = 0
    since_us: int = 0
    turn_rad: float = 0.0  # without a new field
    is_stuck: bool = False  # by the last reading

    def observe(self, now: Readings, last: Readings, raw_us: int, step_us: int) -> None:
        """Take the reading behind ``last``."""
        mag = now.mag_gauss
        if mag != last.mag_gauss or mag == ZERO_VEC3:
            self.changes += 1
            self.equal, self.since_us, self.turn_rad = 0, raw_us, 0.0
            self.is_stuck = False
            return
        self.equal += 1
        step_s = MICROSECOND * min(max(step_us, 0), MAG_STUCK_US)
        self.turn_rad += step_s * largest(now.gyr_rad_s)
        self.is_stuck = (
            self.turn_rad >= MAG_TURN_RAD
            and raw_us - self.since_us >= MAG_STUCK_US
            and self.equal >= MAG_STUCK_SAMPLES
            and self.changes >= NOISY_SAMPLES
        )


@dataclass(slots=True)
class SensorFaults:
    """Follows one IMU stream and finds the faults of its sensors."""

    gyr_end: RangeEnd = field(default_factory=gyroscope_end)
    acc_end: RangeEnd = field(default_factory=accelerometer_end)
    stuck: StuckImu = field(default_factory=StuckImu)
    mag: StuckField = field(default_factory=StuckField)
    last: Readings = NOTHING
    last_us: int = 0
    good_gyr: Vec3 = ZERO_VEC3  # the last good rate
    good_us: int = 0
    blinding: Reason | None = None  # why and since when the vehicle may turn unseen
    blinding_us: int = 0
    blinded: Blindness | None = None  # the last such stretch

    def refusal(self, readings: Readings, raw_us: int) -> Reason | None:
        """Why a reading at ``raw_us`` on the vehicle's clock is no data; None if it is."""
        step_us = raw_us - self.last_us
        why = self._saturation(readings, MICROSECOND * step_us)
        if why is None:
            why = self.stuck.refusal(readings, self.last, raw_us)
        if why is None and self.gyr_end.is_large and self._is_spike(readings.gyr_rad_s, raw_us):
            why = Reason.GYROSCOPE_SPIKE
        self.mag.observe(readings, self.last, raw_us, step_us)
        self.last, self.last_us = readings, raw_us
        if why is None:
            self.good_gyr, self.good_us = readings.gyr_rad_s, raw_us
            if self.blinding is not None:
                self._see_again(self.blinding, raw_us)
        elif self.blinding is None and why in BLINDING:
            self.blinding, self.blinding_us = why, raw_us
        return why

    def take_blindness(self) -> Blindness | None:
        """The stretch that ended with this reading, if it hides a rotation; given once."""
        blinded, self.blinded = self.blinded, None
        return blinded

    @property
    def mag_is_stuck(self) -> bool:
        """Whether the field of the last reading has not followed the vehicle's turning."""
        return self.mag.is_stuck

    def _saturation(self, readings: Readings, step_s: float) -> Reason | None:
        gyr_is_at_end = self.gyr_end.is_reached(readings.gyr_rad_s, step_s)
        if self.acc_end.is_reached(readings.acc_m_s2, step_s):
            return Reason.ACCELEROMETER_SATURATED
        return Reason.GYROSCOPE_SATURATED if gyr_is_at_end else None

    def _is_spike(self, gyr: Vec3, raw_us: int) -> bool:
        """Whether the rate leapt away from the last good one, and the reading before did not."""
        if not (self.gyr_end.is_noisy and self.acc_end.is_noisy):
            return False
        elapsed_s = MICROSECOND * max(raw_us - self.good_us, 0)
        limit = max(RATE_STEP_RAD_S, RATE_STEP_RAD_S2 * elapsed_s)
        if largest(subtract(gyr, self.good_gyr)) <= limit:
            return False
        off = subtract(gyr, self.last.gyr_rad_s)
        # an axis that agrees to the last digit is at the end of its range, and no witness
        return largest(off) > limit or 0.0 in off

    def _see_again(self, reason: Reason, raw_us: int) -> None:
        """A good reading ends the stretch in which the vehicle may have turned unseen."""
        span_us = raw_us - self.blinding_us
        if span_us >= BLIND_US or span_us < 0:  # or the clock began anew
            self.blinded = Blindness(reason, max(span_us, 0))
        self.blinding = None
