"""Sensors that have reached the end of their range, or of the field that carries the reading.

Beyond the one, readings stay where they are: an equal large value on one axis. Beyond the other,
an integer of 16 bits wraps, and the value goes on from the field's other end.
"""

from dataclasses import dataclass, field

from drivers.samples.readings import NOISY_SAMPLES
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, Vec3

MICROSECOND = 1e-6
RAIL_SAMPLES = 4  # equal large values
LONGEST_STEP_S = 0.05  # over a longer one a wrapped value and a fast change look alike
# No vehicle changes its rate faster.
RATE_STEP_RAD_S = 10.0
RATE_STEP_RAD_S2 = 500.0


@dataclass(slots=True)
class RangeEnd:
    """Follows one sensor's three axes.

    ``rail`` is where ranges begin to end: below it equal values are none. ``field_end`` is where
    the messages' 16-bit fields end, ``most`` what the sensor can read at all, and ``step`` with
    ``step_a_s`` what it can change by between two readings.
    """

    rail: float
    field_end: float
    most: float
    step: float
    step_a_s: float = 0.0
    last: Vec3 = ZERO_VEC3
    changes: list[int] = field(default_factory=lambda: [0, 0, 0])  # of each axis: it has noise
    equal: list[int] = field(default_factory=lambda: [0, 0, 0])  # readings at a rail in a row
    wraps: list[int] = field(default_factory=lambda: [0, 0, 0])  # over the field's end so far
    is_noisy: bool = False  # on all axes
    is_large: bool = False  # the latest reading, or not as small as it seems

    def is_reached(self, now: Vec3, step_s: float) -> bool:
        """Whether a reading, ``step_s`` after the last, is at an end or beyond."""
        x, y, z = now
        rail, last, self.last = self.rail, self.last, now
        if -rail < x < rail and -rail < y < rail and -rail < z < rail:
            if self.is_noisy and not self.is_large:  # nearly always
                return False
            self.is_large = False
        else:
            self.is_large = True
        self.is_noisy = True
        is_reached = False
        for axis in range(3):
            if self._is_at_rail(axis, now[axis], last[axis]):
                is_reached = True
            if self._has_wrapped(axis, now[axis], last[axis], step_s):
                is_reached = self.is_large = True
        return is_reached

    def _is_at_rail(self, axis: int, value: float, last: float) -> bool:
        size = abs(value)
        if value != last:
            self.changes[axis] += 1
        is_equal = value == last and size >= self.rail
        self.equal[axis] = self.equal[axis] + 1 if is_equal else 0
        is_noisy = self.changes[axis] >= NOISY_SAMPLES
        self.is_noisy = self.is_noisy and is_noisy
        # -32768 is further than 32767
        at_end = (1 - 1e-9) * self.field_end <= size <= (1 + 1e-4) * self.field_end
        return at_end or (is_noisy and self.equal[axis] >= RAIL_SAMPLES)

    def _has_wrapped(self, axis: int, value: float, last: float, step_s: float) -> bool:
        """Whether the true value is beyond the field's end: only there it goes on from the last."""
        span = 2.0 * self.field_end * (32768 / 32767)
        true_last = last + span * self.wraps[axis]
        wraps = round((true_last - value) / span)
        if wraps == 0 or not 0.0 < step_s <= LONGEST_STEP_S:
            self.wraps[axis] = 0
            return False
        true = value + span * wraps
        goes_on = abs(true - true_last) <= max(self.step, self.step_a_s * step_s)
        self.wraps[axis] = wraps if goes_on and abs(true) <= self.most else 0
        return self.wraps[axis] != 0


def gyroscope_end() -> RangeEnd:
    """Of common ones ranges begin at 250 deg/s; no more than 4000 deg/s are sold."""
    return RangeEnd(4.3, 32.767, 70.0, RATE_STEP_RAD_S, RATE_STEP_RAD_S2)


def accelerometer_end() -> RangeEnd:
    """Of common ones ranges begin at 4 g; a shock may change it by 10 g between two readings."""
    g = STANDARD_GRAVITY_M_S2
    return RangeEnd(3.9 * g, 32.767 * g, 41.0 * g, 10.0 * g)
