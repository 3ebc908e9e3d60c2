"""What is published of one vehicle, and when: the next record, and the instant that it is of.

Each vehicle has a grid of fixed period that meets its stream: attitude k is due at the start, plus
k periods, plus an offset. The offset slides towards the arrivals of the vehicle's samples, so that
an attitude leaves as soon as its sample has been taken, and stays within half a period: the count
over any time is that of the period, give or take one.

From the vehicle's clock to the host's: a message that left at vehicle time t arrives at
t + offset + latency with latency >= 0, so the smallest (arrival - t) seen is the best bound of the
offset. The two clocks drift apart: an autopilot's clock was measured 44 to 136 ms a minute slow
under load. The bound therefore rises slowly with time, a little faster than that drift, and every
prompt message pulls it down again.

A host clock that is set forwards (or a vehicle's, backwards) makes every message late by the same
amount from then on. Messages that were held back come with less and less delay instead, so a second
of late messages with one lateness is a step, and the bound follows it. So is a quarter of a second
of messages that come as evenly as the vehicle has stamped them: an autopilot's clock that stands
still under load is noticed at once.
"""

from math import degrees, inf, isfinite, remainder

from estimator.geometry.frames import euler_rad
from estimator.types import Attitude, Quaternion, Vec3
from service.records import SCHEMA, AttitudeRecord, Confidence, Retuned, Sigma, State

STATUS_PERIOD_US = 1_000_000
# While samples are left out, an attitude of an old sample is repeated no more often than this.
REPEATED_US = 250_000
# How far the grid moves towards an arrival, as a share of what separates them.
SLIDE = 0.125
GOLDEN = 0.6180339887498949  # its multiples spread evenly over the unit interval


class Publishing:
    """Counts of the records of one vehicle, and their grid. Times are the host's.

    ``number`` of the vehicles that came spreads their statuses over the second.
    """

    def __init__(self, rate_hz: float, number: int = 0) -> None:
        self.clock = HostClock()
        self.attitudes = 0
        self.statuses = 0
        self.retuned: Retuned | None = None
        self.status_due_us = 0
        self._rate_hz = rate_hz
        self._period_us = 1e6 / rate_hz  # of the grid
        self.due_us = 0.0  # when the next attitude is due
        self._grid_us = 0.0  # the same without the offset
        self._offset_us = 0.0
        self.wake_us = 0.0  # when to look next, as far as was known at the last look
        self._last = (-1, 0)  # samples at the last attitude, and when that was
        self._counted: tuple[float, int] = (inf, 0)  # the last status, and attitudes by then
        self._status_period_us = STATUS_PERIOD_US
        self._second_status = 1.0 - number * GOLDEN % 1.0  # a share of the period after the first

    def note_attitude(self, now_us: int, samples: int) -> None:
        """An attitude was published, after so many samples: the grid moves on."""
        late_us = now_us - self.due_us
        if self.attitudes == 0 or abs(late_us) > 2e6:  # the first, or the clock was set
            self._grid_us, self._offset_us = now_us + self._period_us, 0.0
        else:
            if samples != self._last[0]:  # the offset slides towards the sample's arrival
                half_us = 0.5 * self._period_us
                moved_us = self._offset_us + SLIDE * max(-half_us, min(half_us, late_us))
                self._offset_us = remainder(moved_us, self._period_us)
            self._grid_us += self._period_us
            behind_us = now_us - (self._grid_us + self._offset_us)
            missed = max(0.0, behind_us // self._period_us)  # during a stop
            self._grid_us += missed * self._period_us
        self.due_us = self._grid_us + self._offset_us
        self.attitudes += 1
        self._last = samples, now_us

    def is_stale(self, now_us: int, samples: int) -> bool:
        """Whether an attitude would bring nothing new: its sample was published just before."""
        before, attitude_us = self._last
        return samples == before and 0 <= now_us - attitude_us < REPEATED_US

    def is_status_due(self, now_us: int) -> bool:
        """Whether it is time for a status; right away after the host's clock was set."""
        return not 0 < self.status_due_us - now_us <= 2 * self._status_period_us

    def note_status(self, now_us: int, period_us: int = STATUS_PERIOD_US) -> None:
        """A status was published; the next one is due a period after this one was."""
        self.statuses += 1
        self._status_period_us = period_us
        if self.statuses == 1:
            self.status_due_us = now_us + round(self._second_status * period_us)
            return
        due_us = self.status_due_us + period_us
        is_steady = 0 < due_us - now_us <= period_us
        self.status_due_us = due_us if is_steady else now_us + period_us

    def published_hz(self, now_us: int, *, is_shedding: bool) -> float:
        """Attitudes a second since the last status; the rate asked for where nothing is shed."""
        (status_us, before), self._counted = self._counted, (now_us, self.attitudes)
        since_us, count = now_us - status_us, self.attitudes - before
        if not is_shedding or since_us <= 0:
            return self._rate_hz
        return min(self._rate_hz, round(1e6 * count / since_us, 1))

    def is_attitude_due(self, now_us: int) -> bool:
        """Whether the next attitude is due; at once if the host's clock was set back."""
        return not 0.0 < self.due_us - now_us <= 2.0 * self._period_us

    def meets(self, now_us: int, sample_period_us: float) -> bool:
        """Whether the sample taken at ``now_us`` is the one that the next attitude waits for."""
        early_us = min(0.5 * sample_period_us, 0.5 * self._period_us)
        return self.is_attitude_due(now_us) or self.due_us - now_us <= early_us

    def deadline_us(self, last_arrival_us: int, sample_period_us: float) -> float:
        """When the next attitude is published without a sample of its own.

        Where a sample is expected within half a period around the due time, it is waited for.
        """
        due_us, half_us = self.due_us, 0.5 * self._period_us
        expected_us = last_arrival_us + sample_period_us
        waits = sample_period_us > 0.0 and due_us - half_us < expected_us < due_us + half_us
        return due_us + half_us if waits else due_us


MAX_DRIFT = 3e-3  # s/s; 136 ms a minute is 2.3e-3
STEP_US = 100_000  # less counts as lateness; time services set a clock that is 128 ms off or more
STEP_SPREAD_US = 100_000  # the latenesses that show a step differ by this at most
STEP_SPREAD = 0.25  # and at most that part of the step
WINDOW_US = 1_000_000
WINDOW_SAMPLES = 3  # a window of fewer shows nothing
EVEN_US = 250_000  # evenly late messages for this long show a step, too
EVEN_SPREAD_US = 30_000  # they count as evenly late while they differ by this at most
EVEN_SAMPLES = 6
# A sample later than so many periods (and than STEP_US) is not made up for.
HELD_PERIODS = 2


class Offsets:
    """Least and most offset (host minus vehicle) since ``begin_us`` of the vehicle's clock."""

    def __init__(self, begin_us: int, seen_us: float) -> None:
        self.begin_us = begin_us
        self.least_us = self.most_us = seen_us
        self.samples = 1

    def add(self, seen_us: float) -> None:
        """Take one more."""
        self.least_us = min(self.least_us, seen_us)
        self.most_us = max(self.most_us, seen_us)
        self.samples += 1

    def shows_step(self, offset_us: float) -> bool:
        """Whether all are later than the offset by nearly the same: the host's clock was set."""
        step_us = self.least_us - offset_us
        spread_us = min(STEP_SPREAD_US, STEP_SPREAD * step_us)
        is_alike = self.most_us - self.least_us < spread_us
        return self.samples >= WINDOW_SAMPLES and step_us > STEP_US and is_alike


class HostClock:
    """The offset of the host's clock to the vehicle's."""

    def __init__(self) -> None:
        self.offset_us = 0.0  # host minus vehicle, at host time _at_us
        self._at_us: int | None = None  # None before the first message
        self._window = Offsets(0, 0.0)  # the offsets of the current second
        self._even = Offsets(0, 0.0)  # those since two last differed by EVEN_SPREAD_US

    def observe(self, vehicle_us: int, arrival_us: int) -> None:
        """Take a message of ``vehicle_us`` that arrived at ``arrival_us``."""
        offset_us = seen_us = float(arrival_us - vehicle_us)
        if self._at_us is None:
            self._window, self._even = Offsets(vehicle_us, seen_us), Offsets(vehicle_us, seen_us)
        else:
            bound_us = self.offset_us + MAX_DRIFT * max(0, arrival_us - self._at_us)
            offset_us = self._follow_steps(vehicle_us, seen_us, min(bound_us, seen_us))
        self.offset_us, self._at_us = offset_us, arrival_us

    def _follow_steps(self, vehicle_us: int, seen_us: float, offset_us: float) -> float:
        """The offset, moved if the latest messages show that a clock was set or stood still."""
        even, window = self._even, self._window
        even.add(seen_us)
        is_long = vehicle_us - even.begin_us >= EVEN_US and even.samples >= EVEN_SAMPLES
        if even.most_us - even.least_us > EVEN_SPREAD_US:
            self._even = Offsets(vehicle_us, seen_us)
        elif is_long and even.least_us - offset_us > STEP_US:
            offset_us = even.least_us
        if vehicle_us - window.begin_us < WINDOW_US:
            window.add(seen_us)
            return offset_us
        self._window = Offsets(vehicle_us, seen_us)
        return window.least_us if window.shows_step(offset_us) else offset_us

    def to_vehicle_us(self, host_us: int) -> int:
        """The vehicle's time at host time ``host_us``; needs a message before."""
        assert self._at_us is not None
        return round(host_us - self.offset_us)

    def propagated_to(
        self, taken_us: int, arrival_us: int, median_us: float, now_us: int
    ) -> tuple[int, int]:
        """The vehicle's time to publish at ``now_us``, and how old its last sample is then (us).

        The sample was of ``taken_us`` and arrived at ``arrival_us``; ``median_us`` is the interval
        of samples. If it came so late that the vehicle's clock may have stood still, the attitude
        is not propagated by that time: nobody knows whether it has passed.
        """
        since_us = now_us - arrival_us
        late_us = round(arrival_us - taken_us - self.offset_us)  # later than prompt ones
        if late_us <= max(STEP_US, HELD_PERIODS * median_us):
            late_us = 0
        time_us = taken_us + since_us if late_us > 0 else self.to_vehicle_us(now_us)
        return max(taken_us, time_us), since_us + late_us


def attitude_record(
    attitude: Attitude,
    *,
    time_unix_us: int,
    time_boot_us: int,
    state: State = State.RUNNING,
    age_us: int = 0,
    sequence: int,
) -> AttitudeRecord | None:
    """The record of an attitude whose sample is ``age_us`` old; None if it is not finite."""
    if not is_finite(attitude):
        return None
    return AttitudeRecord(
        schema=SCHEMA,
        time_unix_us=time_unix_us,
        time_boot_us=time_boot_us,
        q_ned_frd=attitude.q_ned_frd,
        euler_deg=euler_deg(attitude.q_ned_frd),
        rate_rad_s=attitude.rate_rad_s,
        gyro_bias_rad_s=attitude.gyro_bias_rad_s,
        error=attitude.error,
        error_rate=attitude.error_rate_1_s,
        gain=attitude.gain,
        confidence=Confidence(attitude.confidence_gravity, attitude.confidence_magnetic),
        sigma_deg=Sigma(
            # no angle can be further off than half a turn
            min(180.0, degrees(attitude.sigma_inclination_rad)),
            min(180.0, degrees(attitude.sigma_heading_rad)),
        ),
        heading_reference=attitude.heading_reference,
        state=str(state),
        age_ms=max(0, age_us) / 1e3,
        sequence=sequence,
    )


def euler_deg(q_ned_frd: Quaternion) -> Vec3:
    """Roll, pitch and yaw in degrees, yaw in [0, 360)."""
    roll_rad, pitch_rad, yaw_rad = euler_rad(q_ned_frd)
    return (degrees(roll_rad), degrees(pitch_rad), degrees(yaw_rad))


def is_finite(attitude: Attitude) -> bool:
    """Whether every number that must be finite is; an infinite sigma just means "unknown"."""
    # without the sigmas, and the north's name
    _, q, rate_rad_s, bias_rad_s, *others = attitude[:-3]
    # one that is not finite makes the sum so; none is large enough for the sum of the others
    return isfinite(sum((*q, *rate_rad_s, *bias_rad_s, *others)))
