"""When equal readings, rails and leaps are faults, and when they are not: each limit pinned."""

import math
import random

import pytest

from drivers.samples.sensor_faults import Readings, SensorFaults
from estimator.geometry.quaternion import exp, multiply, rotate_inverse
from estimator.reasons import Reason
from estimator.types import IDENTITY, STANDARD_GRAVITY_M_S2, ZERO_VEC3
from tests.drivers.logs.writers import noisy

G = STANDARD_GRAVITY_M_S2
STEP_US = 20_000
DOWN, FIELD = (0.0, 0.0, -G), (0.2, 0.0, 0.4)


class Stream:
    """One IMU at 50 Hz: 2 s of noise at rest, then whatever a test feeds."""

    def __init__(self, mag=FIELD, *, noisy_x=True):
        self.faults, self.rng, self.now_us = SensorFaults(), random.Random(5), 1_000_000
        x = () if noisy_x else (0.0,)
        for _ in range(100):
            gyr, acc = (x + self.noise(v)[len(x) :] for v in (ZERO_VEC3, DOWN))
            field = self.noise(mag, 0.002) if mag != ZERO_VEC3 else mag
            assert self.feed(gyr, acc, field) is None

    def noise(self, vector, sigma=0.01):
        return noisy(self.rng, vector, sigma)

    def feed(self, gyr=None, acc=None, mag=None, step_us=STEP_US):
        """Why a reading is refused; what is not given is noise at rest."""
        self.now_us += step_us
        gyr = self.noise(ZERO_VEC3) if gyr is None else gyr
        acc = self.noise(DOWN) if acc is None else acc
        mag = self.noise(FIELD, 0.002) if mag is None else mag
        return self.faults.refusal(Readings(self.now_us, gyr, acc, mag))

    def first_refused(self, count, reading, step_us=STEP_US):
        """(reason, seconds) of the first of ``count`` that is refused, and not just held back."""
        for k in range(count):
            reason = self.feed(**reading(k), step_us=step_us)
            if reason not in (None, Reason.REPEATED):
                return reason, 1e-6 * k * step_us
        return None


@pytest.mark.parametrize(
    ("gyr", "acc", "is_stuck"),
    [
        *(((rate, 0.0, 0.0), DOWN, rate > 0.05) for rate in (0.04, 0.06)),
        *((ZERO_VEC3, (0.0, 0.0, -G + x), abs(x) > 0.5) for x in (-0.6, -0.4, 0.4, 0.6)),
    ],
)
@pytest.mark.parametrize(("step_us", "seconds"), [(STEP_US, 0.5), (100_000, 2.0)])
def test_equal_readings_of_both_that_no_vehicle_at_rest_gives(gyr, acc, is_stuck, step_us, seconds):
    """Half a second, and 20 of them. At rest they may be true; after 3 s 0.04 rad/s would show."""
    stream, same = Stream(), {"gyr": gyr, "acc": acc, "mag": FIELD}
    found = stream.first_refused(3_000_000 // step_us, lambda _: same, step_us)
    stuck = Reason.STUCK, pytest.approx(seconds, abs=1.01e-6 * step_us)
    assert found == (stuck if is_stuck else None)


@pytest.mark.parametrize(("rate_rad_s", "seconds"), [(1.0, 0.5), (0.2, 1.75)])
def test_a_gravity_that_stays_while_the_gyroscope_turns_by_a_third_of_a_radian(rate_rad_s, seconds):
    stream = Stream()
    found = stream.first_refused(
        500, lambda _: {"gyr": stream.noise((rate_rad_s, 0.0, 0.0), 0.001), "acc": DOWN}
    )
    assert found == (Reason.ACCELEROMETER_STUCK, pytest.approx(seconds, abs=0.05))


@pytest.mark.parametrize(
    ("rate_rad_s", "mag"), [(0.5, FIELD), (0.1, FIELD), (0.1, ZERO_VEC3), (-0.06, FIELD)]
)
def test_a_rate_that_stays_while_nothing_turns(rate_rad_s, mag):
    stream, gyr, sigma = Stream(mag), (rate_rad_s, 0.0, 0.0), 2e-4 if any(mag) else 0.0
    found = stream.first_refused(500, lambda _: {"gyr": gyr, "mag": stream.noise(mag, sigma)})
    assert found == (Reason.GYROSCOPE_STUCK, pytest.approx(0.3, abs=0.05))


@pytest.mark.parametrize("rate_rad_s", [0.0, 0.02])
def test_a_small_rate_that_stays_while_the_vehicle_turns(rate_rad_s):
    """A platform that is pushed and turned, beside a gyroscope that has stopped."""
    stream = Stream()

    def reading(k):
        angle = 0.012 * k  # 0.6 rad/s
        acc = (0.0, G * math.sin(angle), -G * math.cos(angle))
        return {"gyr": (rate_rad_s, 0.001, 0.0), "acc": stream.noise(acc)}

    reason, after_s = stream.first_refused(135, reading)
    assert reason == Reason.GYROSCOPE_STUCK
    assert after_s < 0.4
    stream.first_refused(10, reading)
    assert stream.feed(**reading(11)) == Reason.GYROSCOPE_STUCK
    assert stream.feed() is None
    assert stream.faults.take_blindness()[0] == Reason.GYROSCOPE_STUCK


@pytest.mark.parametrize("mag", [FIELD, ZERO_VEC3])
def test_a_fast_turn_that_goes_on_otherwise_than_a_rate_that_stays(mag):
    """For a moment it may be that turn; after more than a second it is not."""
    stream, q = Stream(mag), IDENTITY
    frozen = (0.3, -0.7, 1.0)
    for k in range(135):
        time_s = 0.02 * k
        rate = (0.6 * math.cos(1.3 * time_s), 0.8 * math.sin(time_s - 1.0), 1.0)
        q = multiply(q, exp(tuple(0.02 * x for x in rate)))
        force, field = (rotate_inverse(q, v) for v in (DOWN, mag))
        found = stream.feed(frozen, stream.noise(force), field if any(mag) else mag)
        if found not in (None, Reason.REPEATED):
            break
    assert (found, time_s < 2.0) == (Reason.GYROSCOPE_STUCK, True)


@pytest.mark.parametrize("rate_rad_s", [0.5, -0.5])
def test_a_steady_turn_that_the_others_confirm_is_none(rate_rad_s):
    """v' = v x w: to the last digit the same rate, and gravity and field go round."""
    stream = Stream()

    def turned(k, vector):
        x, y, z = vector
        angle = rate_rad_s * 1e-6 * STEP_US * k
        sine, cosine = math.sin(angle), math.cos(angle)
        return stream.noise((x, y * cosine + z * sine, z * cosine - y * sine), 1e-3)

    def reading(k):
        return {"gyr": (rate_rad_s, 0.0, 0.0), "acc": turned(k, DOWN), "mag": turned(k, FIELD)}

    assert stream.first_refused(1000, reading) is None


@pytest.mark.parametrize("step_us", [10_000, STEP_US, 100_000])
@pytest.mark.parametrize("is_both", [True, False])
def test_what_chance_does_not_repeat_is_held_back_at_once(step_us, is_both):
    stream = Stream()
    same = {"gyr": stream.noise(ZERO_VEC3), "acc": stream.noise(DOWN) if is_both else None}
    readings = max(20, 500_000 // step_us)
    reasons = [stream.feed(**same, step_us=step_us) for _ in range(readings)]
    assert reasons == [None] * 4 + [Reason.REPEATED] * (readings - 4)
    assert stream.feed(**same, step_us=step_us) is None  # at rest it may be true
    assert stream.feed() is None
    assert stream.faults.take_blindness() is None  # no longer than a gap


def test_coarse_readings_at_rest_are_held_back_for_seconds_at_most():
    """After a flight with noise: of whole mrad/s, where noise is half of one, many are equal."""
    stream, held = Stream(), []
    for _ in range(1500):
        gyr = tuple(1e-3 * round(1e3 * x) for x in stream.noise(ZERO_VEC3, 3e-4))
        held.append(stream.feed(gyr=gyr) is not None)
    assert sum(held[:250]) < 60  # measured 41
    assert sum(held[500:]) < 15  # measured 11 of 1000


def test_a_gyroscope_that_freezes_after_a_long_saturation_is_found_as_soon():
    """Readings at a range's end repeat themselves: they show nothing of what is usual."""
    stream, end = Stream(), (34.9, 34.9, 34.9)
    reasons = [stream.feed(gyr=end) for _ in range(500)]
    assert set(reasons[4:]) == {Reason.GYROSCOPE_SATURATED}
    for _ in range(60):
        stream.feed()
    found = stream.first_refused(500, lambda _: {"gyr": (1.0, 0.0, 0.0)})
    assert found == (Reason.GYROSCOPE_STUCK, pytest.approx(0.3, abs=0.05))


@pytest.mark.parametrize("sign", [1, -1])
def test_equal_large_values_are_the_end_of_a_range(sign):
    """Four in a row; the first one leaps."""
    stream = Stream()
    reasons = [stream.feed(gyr=(sign * 34.9, *stream.noise((0.0, 0.0)))) for _ in range(10)]
    assert reasons[0] in (Reason.GYROSCOPE_SPIKE, Reason.GYROSCOPE_SATURATED)
    assert set(reasons[4:]) == {Reason.GYROSCOPE_SATURATED}
    reasons = [stream.feed(acc=(*stream.noise((0.0, 0.0)), sign * 4.0 * G)) for _ in range(10)]
    assert reasons[:3] == [None] * 3
    assert set(reasons[4:]) == {Reason.ACCELEROMETER_SATURATED}


@pytest.mark.parametrize("sensor", ["gyr", "acc"])
def test_an_axis_without_noise_has_no_end_whatever_the_others_have(sensor):
    """A simulator's rotor axis, or one that does not exist."""
    stream = Stream(noisy_x=False)
    large = {"gyr": 5.0, "acc": 4.0 * G}[sensor]
    for _ in range(30):
        assert stream.feed(**{sensor: (large, *stream.noise((0.0, -G)))}) is None


def test_below_every_range_equal_values_are_no_end():
    stream = Stream()
    # each axis but one changes, so that nothing else is wrong with it
    for k in range(15):
        gyr, acc = (4.2, *stream.noise((0.0, 0.0))), (*stream.noise((0.0, 0.0)), -3.8 * G)
        assert stream.feed(gyr=gyr, acc=acc) is None, k


@pytest.mark.parametrize(
    ("rate_rad_s", "step_us", "is_spike"),
    [
        (9.5, 20_000, False),
        (10.5, 20_000, True),
        (19.0, 40_000, False),
        (21.0, 40_000, True),
        (30.0, 250_000, False),
    ],
)
def test_a_lone_rate_that_nobody_can_reach(rate_rad_s, step_us, is_spike):
    """10 rad/s, or 500 rad/s^2 since the last good reading."""
    stream = Stream()
    gyr = (rate_rad_s, 0.01, 0.02)
    assert (stream.feed(gyr=gyr, step_us=step_us) == Reason.GYROSCOPE_SPIKE) is is_spike
    assert stream.feed() is None


@pytest.mark.parametrize(
    ("rate_rad_s", "shaking_rad_s", "seconds"),
    [(1.0, 0.0, 0.12), (0.1, 0.0, 2.0), (0.03, 0.0, 16.7), (0.2, 1.0, 0.68), (0.0, 4.0, 2.0)],
)
def test_a_field_that_stays_while_the_vehicle_turns(rate_rad_s, shaking_rad_s, seconds):
    """By 0.1 rad beyond a bias, or shaking for 2 s, as a field follows shaking, too."""
    stream, k = Stream(), 0
    while not stream.faults.stuck.mag.is_proven and k < 1000:
        now_rad_s = rate_rad_s + shaking_rad_s * (-1) ** k
        gyr = stream.noise((0.0, 0.0, now_rad_s), 0.001)
        assert stream.feed(gyr=gyr, mag=FIELD) is None
        k += 1
    assert 1e-6 * STEP_US * (k - 1) == pytest.approx(seconds, rel=0.05)
    stream.feed()
    assert not stream.faults.stuck.mag.is_proven


def test_a_slow_compass_in_a_fast_stream_is_not_stuck_while_it_turns():
    """At 3 Hz of 200 the same field comes 66 times, as often as it always does."""
    stream, mag = Stream(), FIELD
    for k in range(4000):
        rate_rad_s = 0.8 * (k >= 1000)
        mag = stream.noise(FIELD, 0.002) if k % 66 == 0 else mag
        stream.feed(gyr=stream.noise((0.0, 0.0, rate_rad_s), 0.001), mag=mag, step_us=5000)
        assert not stream.faults.stuck.mag.is_proven


def test_a_clock_that_is_set_back_makes_no_compass_stuck():
    stream = Stream()
    for k in range(600):
        gyr = stream.noise((0.0, 0.0, 0.04), 0.001)
        stream.feed(gyr=gyr, mag=FIELD, step_us=-300_000_000 if k == 300 else STEP_US)
        assert not stream.faults.stuck.mag.is_proven or k >= 625  # 0.5 rad in all


@pytest.mark.parametrize(
    ("readings", "blindness"), [(1, None), (2, (Reason.GYROSCOPE_SATURATED, pytest.approx(0.04)))]
)
def test_blindness_is_reported_once_from_30_ms_on(readings, blindness):
    stream = Stream()
    for _ in range(readings):
        assert stream.feed(gyr=(32.767, 0.0, 0.0)) == Reason.GYROSCOPE_SATURATED
    assert stream.feed() is None
    assert stream.faults.take_blindness() == blindness
    assert stream.faults.take_blindness() is None


WRAPS = {
    "mrad/s": ("gyr", 1e-3, 0.0, 38.0),
    "0.1 deg/s": ("gyr", math.radians(0.1), 0.0, 66.0),
    "mg": ("acc", 1e-3 * G, -G, -37.0 * G),
}


@pytest.mark.parametrize("step_us", [2_500, 10_000, 40_000])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("sensor", "unit", "rest", "peak"), WRAPS.values(), ids=WRAPS)
def test_a_sensor_that_wraps_is_at_its_end_until_it_is_back(
    sensor, unit, rest, peak, sign, step_us
):
    """Integers of 16 bits hold 32767 units; up to 38 rad/s in mrad/s they show up to -27.5."""
    stream, reasons = Stream(), []
    for k in range(round(4_000_000 / step_us)):
        true = sign * (rest + (peak - rest) * math.sin(math.pi * 1e-6 * step_us * k / 4.0) ** 2)
        shown = unit * ((round(true / unit) + 32768) % 65536 - 32768)
        reading = {sensor: (*stream.noise((0.0, 0.0)), shown)}
        reasons.append((abs(true) > 32770 * unit, stream.feed(**reading, step_us=step_us)))
    why = Reason.GYROSCOPE_SATURATED if sensor == "gyr" else Reason.ACCELEROMETER_SATURATED
    assert {reason for is_beyond, reason in reasons if is_beyond} == {why}
    assert sum(reason is not None for is_beyond, reason in reasons if not is_beyond) <= 2
    assert (stream.faults.take_blindness() is not None) is (sensor == "gyr")


def test_a_turn_the_other_way_round_is_no_wrap():
    """From 20 to -20 rad/s between two samples of a slow stream: nobody knows, it is taken."""
    stream = Stream()
    for rate in (20.0, -20.0, 20.0, -20.0):
        assert stream.feed(gyr=(*stream.noise((0.0, 0.0)), rate), step_us=250_000) is None


@pytest.mark.parametrize("before", [5, 15])
def test_a_fault_that_lasts_while_the_clock_begins_anew_is_found_by_the_new_one(before):
    stream, equal = Stream(), {"gyr": (0.06, 0.0, 0.0), "acc": DOWN}
    assert stream.first_refused(before, lambda _: equal) is None
    stream.now_us = 0
    found = stream.first_refused(100, lambda _: equal)
    assert found == (Reason.STUCK, pytest.approx(0.5, abs=0.05))
    stream.now_us = 0
    assert stream.feed() is None
    assert stream.faults.take_blindness() == (Reason.STUCK, 0.0)
