"""Body rates of another messenger between IMU samples."""

from math import cos, pi, sin
from types import SimpleNamespace

import pytest

from estimator.estimator import Estimator
from estimator.geometry.quaternion import add, angle_between, exp, multiply, scale
from estimator.live import turning
from estimator.live.core import in_arrays, initial_core
from estimator.live.settings import settings_of
from estimator.live.turning import NO_AXES, Turning, keep_rate, stand_in, take_between
from estimator.profile import load_profile, merge_profile
from estimator.types import IDENTITY, NOTHING_BETWEEN, ZERO_VEC3, ImuSample, RateSample

BIAS = 0.05
STEP_S = 0.5
SECOND = 1_000_000
SETTINGS = settings_of(load_profile("imu"))


def handle():
    """The state before any sample and any rate, in plain Python."""
    core = in_arrays(initial_core(SETTINGS))
    return SimpleNamespace(params=SETTINGS, **core._asdict())


def taken(state, time_us, gyr):
    """What the rates show of the turning up to a sample, which is the last one then."""
    shown, _ = take_between(state, time_us, gyr)
    state.time_us = time_us
    return shown


def rate_at(time_s):
    """To and fro, three times a second about x and slower about y: 2 Hz sees nothing of it."""
    x = 18.0 * time_s + 3.0 * sin(0.7 * time_s)
    y = 5.0 * time_s + 2.0 * cos(0.4 * time_s)
    return (1.5 * sin(x), 0.8 * cos(y), 0.0)


def flown(seconds, *, late_s=0.0, every_s=0.05):
    """The turning between samples 0.5 s apart; the rates' clock is ``late_s`` off."""
    state, shown, next_rate = handle(), [], 1
    for k in range(1, round(seconds / STEP_S)):
        while next_rate * every_s <= k * STEP_S:
            stamp = round((next_rate * every_s + late_s) * SECOND)
            keep_rate(state, stamp, rate_at(next_rate * every_s))
            next_rate += 1
        at = round(k * STEP_S * SECOND)
        gyr = add(rate_at(k * STEP_S), (BIAS,) * 3)
        shown.append(taken(state, at, gyr))
    return shown


def test_the_turn_is_integrated_through_the_rates_with_the_samples_bias():
    shown = flown(120.0)
    assert all(one.given for one in shown[1:])
    begin_s, dt, truth = STEP_S * (len(shown) - 1), STEP_S / 400, IDENTITY
    for k in range(400):
        truth = multiply(truth, exp(scale(dt, rate_at(begin_s + (k + 0.5) * dt))))
    q = exp(scale(STEP_S, tuple(w - BIAS for w in shown[-1].turn_rad_s)))
    assert angle_between(q, truth) < 0.02
    assert shown[-1].step_s == pytest.approx(0.05)


def test_rates_at_the_samples_own_times_change_nothing():
    assert flown(60.0, every_s=STEP_S) == [NOTHING_BETWEEN] * 119


@pytest.mark.parametrize("late_s", [2.4, -2.4, 0.17])
def test_rates_of_another_time_are_noticed(late_s):
    assert not any(one.given for one in flown(120.0, late_s=late_s)[20:])


def test_rates_too_far_apart_show_nothing():
    state = handle()
    keep_rate(state, SECOND // 10, (0.1, 0.0, 0.0))
    assert taken(state, SECOND, ZERO_VEC3) == NOTHING_BETWEEN


def roll_after(profile_rates):
    """The roll error of a vehicle rocked at 2 Hz of samples and 20 Hz of rates, and the word."""
    estimator = Estimator(merge_profile(load_profile("imu"), {"rates": profile_rates}))
    worst, q = 0.0, 0.0
    for k in range(1200):
        time_s = 0.05 * k
        q = 1.5 / 18.0 * (1.0 - cos(18.0 * time_s))
        rate = (1.5 * sin(18.0 * time_s), 0.0, 0.0)
        time_us = round(time_s * SECOND)
        estimator.update_report(RateSample(time_us, rate))
        if k % 10 == 0:
            push = (0.0, -9.81 * sin(q) + 3.0 * sin(1.7 * time_s), -9.81 * cos(q))
            estimator.update(ImuSample(time_us, rate, push, ZERO_VEC3, has_mag=False))
            if k > 400:
                w, x, _, _ = estimator.attitude(time_us).q_ned_frd
                worst = max(worst, abs(2.0 * x / w - q))
    return worst, estimator.rates


def test_the_profile_decides_whether_they_are_used():
    with_rates, word = roll_after("imu+attitude")
    without, alone = roll_after("imu")
    assert (word, alone) == ("imu+attitude", "imu")
    assert with_rates < 0.7 * without


def test_rates_that_are_none_are_refused():
    estimator = Estimator(load_profile("imu"))
    assert estimator.update_report(RateSample(0, (float("nan"), 0.0, 0.0))) is not None
    assert estimator.update_report(RateSample(0, (0.0, 1e9, 0.0))) is not None
    assert estimator.update_report(RateSample(0, (0.1, 0.0, 0.0))) is None


@pytest.mark.parametrize(("samples_hz", "most_rad_s"), [(10, 0.06), (25, 0.02)])
def test_a_vibration_at_the_samples_own_rate_is_no_turn(samples_hz, most_rad_s):
    """Each sample sees the same phase, a turn of 1 rad/s; rates between show that it ends."""
    step_us = SECOND // samples_hz
    state, turns = handle(), []
    for k in range(1, 50):
        for since_us in range(SECOND // 50, step_us + 1, SECOND // 50):
            at_us = (k - 1) * step_us + since_us
            phase = 2.0 * pi * samples_hz * at_us / SECOND
            keep_rate(state, at_us, (cos(phase), 0.0, 0.0))
        shown = taken(state, k * step_us, (1.0, 0.0, 0.0))
        turns.append(shown.turn_rad_s[0] if shown.given else 1.0)
    assert abs(turns[-1]) < most_rad_s


def test_the_first_samples_show_their_bias_at_once():
    """A mean of the differences so far, and not a twentieth of a second's after a second."""
    state, bias = handle(), (0.01, -0.03, 0.02)
    for k in range(1, 9):
        at_us = k * SECOND // 2
        keep_rate(state, at_us, ZERO_VEC3)
        taken(state, at_us, bias)
        assert state.turning.offset_rad_s == pytest.approx(bias)


X_AXIS, EACH = (True, False, False), (True, True, True)
STANDS_IN = {"stands_in": X_AXIS}
SAME, X_DIFFERS, Z_DIFFERS = (1e-3, 0.0, 0.0), (0.09, 0.0, 0.0), (0.09, 0.01, 0.0)


@pytest.mark.parametrize(
    ("contradicted", "known", "does"),
    [
        (X_AXIS, {}, True),
        (NO_AXES, STANDS_IN, True),  # until both agree about it again
        (NO_AXES, {}, False),
        (NO_AXES, {**STANDS_IN, "misfit": SAME}, False),
        (X_AXIS, {"before_us": 600_000}, False),
        (X_AXIS, {"misfit": Z_DIFFERS}, False),  # wrong about another one
        (EACH, {"misfit": (0.09, 0.09, 0.09)}, False),
        # they show the same: a compass that is turned contradicts any gyroscope
        (X_AXIS, {"misfit": SAME}, False),
    ],
)
def test_when_rates_stand_in_for_a_contradicted_axis(contradicted, known, does):
    before = Turning(
        before_us=980_000,
        before_rad_s=(0.3, 0.2, 0.1),
        offset_rad_s=(0.01, 0.0, 0.0),
        misfit=X_DIFFERS,
        compared_s=20.0,
    )
    state, gyr = stand_in(before._replace(**known), 1_000_000, (0.8, 0.25, 0.15), contradicted)
    assert state.stands_in == (X_AXIS if does else NO_AXES)
    assert gyr == pytest.approx((0.31 if does else 0.8, 0.25, 0.15))


def test_of_more_rates_than_are_kept_the_oldest_go():
    state = handle()
    for k in range(1, turning.MOST_WAITING + 4):
        keep_rate(state, k, (1e-3 * k, 0.0, 0.0))
    keep_rate(state, k, ZERO_VEC3)  # not later: dropped
    assert len(state.rates) == turning.MOST_WAITING
    assert state.rates[[0, -1], :2].tolist() == [[4, 4e-3], [k, 1e-3 * k]]
