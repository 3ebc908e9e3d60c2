"""The vertical where a slow turn looks like rest, and where a stream is slow."""

from math import cos, degrees, pi, radians

import numpy as np
import pytest

from estimator.conditioning.vertical.tilt import slowness
from estimator.geometry.frames import from_euler_rad
from estimator.geometry.metrics import rms
from estimator.geometry.quaternion import angle_between_vectors, rotate_inverse
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3
from estimator.types import Sample as Reading
from tests.estimator.conditioning.motion import (
    FIELD_NED,
    GRAVITY_M_S2,
    PARAMS,
    Sample,
    Stage,
    conditioned,
    fly,
    inclinations,
    resting,
    vector_errors_rad,
)

BIAS = (radians(0.3), radians(-0.2), radians(0.25))
AXES = {"down": (0.0, 0.0, 1.0), "right": (0.0, 1.0, 0.0), "diagonal": (0.6, 0.0, 0.8)}


def turn_slowly(
    rate, seconds, dt, *, shown=lambda _t: BIAS, mag_every=1, has_mag=True, noises=(0.002, 0.03)
):
    """Errors (N, 2) of gravity and north, deg, and that of the bias at the end, deg/s.

    The gyroscope shows ``shown``, the time's, besides the rate.
    """
    rng = np.random.default_rng(5)

    def noisy(k, s):
        gyr = np.add(s.gyr, shown(k * dt)) + rng.normal(0.0, noises[0], 3)
        acc, mag = s.acc + rng.normal(0.0, noises[1], 3), s.mag + rng.normal(0.0, 0.003, 3)
        has_field = has_mag and k % mag_every == 0
        return Sample(s.q_ned_frd, tuple(gyr), tuple(acc), tuple(mag), has_field)

    samples = (noisy(k, s) for k, s in enumerate(fly(rate, seconds, dt)))
    seen = list(conditioned(samples, dt))
    vertical = seen[-1][2].known.vertical
    assert vertical.rest.resting
    off = np.abs(np.subtract(vertical.estimate.bias_rad_s, shown(seconds))).max()
    return np.degrees([vector_errors_rad(out, s.q_ned_frd) for s, out, _ in seen]), np.degrees(off)


def after(begin_s, axis, deg_s):
    """A rate about an axis, from a time on."""
    w = tuple(radians(deg_s) * a for a in AXES[axis])
    return lambda t: w if t >= begin_s else (0.0, 0.0, 0.0)


@pytest.mark.parametrize(("dt", "mag_every"), [(0.02, 1), (0.02, 5), (0.25, 1)])
@pytest.mark.parametrize(("axis", "deg_s"), [("down", 1.5), ("down", 0.3), ("diagonal", 1.0)])
def test_a_slow_turn_after_a_rest_is_no_bias(axis, deg_s, dt, mag_every):
    errors, off = turn_slowly(after(15.0, axis, deg_s), 60.0, dt, mag_every=mag_every)
    assert off < 0.024
    # measured 0.24 deg (gravity, slow stream) and 0.89
    assert np.all(errors[round(10.0 / dt) :].max(axis=0) < (0.3, 1.05))


@pytest.mark.parametrize(("axis", "deg_s"), [("down", 0.3), ("right", 0.5), ("diagonal", 1.5)])
def test_a_slow_turn_from_the_start_on_is_no_bias(axis, deg_s):
    errors, off = turn_slowly(after(0.0, axis, deg_s), 60.0, 0.02)
    assert off < 0.044
    assert np.all(errors[500:].max(axis=0) < (0.56, 2.5))  # measured 0.47 and 2.06


@pytest.mark.parametrize("has_mag", [True, False])
def test_a_bias_that_steps_at_rest_is_found(has_mag):
    def shown(t):
        return np.add(BIAS, (radians(1.0) * (t > 20.0), 0.0, radians(1.0) * has_mag * (t > 20.0)))

    errors, off = turn_slowly(resting, 50.0, 0.02, shown=shown, has_mag=has_mag)
    assert off < 0.08
    assert np.all(errors.max(axis=0) < (2.9, 8.4))


def test_without_a_field_a_known_bias_does_not_follow_a_slow_turn_about_down():
    assert turn_slowly(after(15.0, "down", 1.0), 45.0, 0.02, has_mag=False)[1] < 0.073


POOR = (radians(0.8), radians(-4.3), radians(-2.4))


def test_a_poor_gyroscope_rests_where_gravity_and_field_stand_still():
    """Its bias is larger than any usual one."""
    errors, off = turn_slowly(resting, 20.0, 0.02, shown=lambda _t: POOR)
    assert off < 0.047
    assert np.all(errors[300:].max(axis=0) < (2.9, 3.9))  # measured 2.4 and 3.2 deg
    assert np.all(errors[900:].max(axis=0) < (0.1, 0.4))


@pytest.mark.parametrize("shake_m_s2", [0.0, 0.2])
def test_without_a_field_gravity_shows_a_poor_gyroscope(shake_m_s2):
    """It errs by 4.4 deg/s about level axes, so 2.4 about down are an error, too."""
    shown, noises = (lambda _t: POOR), (0.015, 0.02 + shake_m_s2)
    assert turn_slowly(resting, 8.0, 0.005, shown=shown, has_mag=False, noises=noises)[1] < 0.2


def test_without_a_field_nothing_separates_an_error_about_down_from_a_turn():
    samples = fly(resting, 10.0, 0.02, bias=(0.0, 0.0, radians(4.0)))
    *_, (_, _, memory) = conditioned((s._replace(has_mag=False) for s in samples), 0.02)
    assert not memory.known.vertical.rest.resting


@pytest.mark.parametrize("has_field", [True, False])
@pytest.mark.parametrize("bank_deg", [10.0, 45.0])
def test_a_banked_turn_is_no_rest(bank_deg, has_field):
    """The force stands still in the body, and the gyroscope shows 6 deg/s."""
    bank = radians(bank_deg)

    def circling(k):
        q = from_euler_rad(bank, 0.0, radians(6.0) * 0.02 * k)
        gyr = rotate_inverse(q, (0.0, 0.0, radians(6.0)))
        acc = (0.0, 0.0, -GRAVITY_M_S2 / cos(bank))
        return Sample(q, gyr, acc, rotate_inverse(q, FIELD_NED), has_field)

    for _, _, memory in conditioned(map(circling, range(2000)), 0.02):
        assert not memory.known.vertical.rest.resting


# --- slow streams: what a step misses, and how far the force counts

FIXED = PARAMS._replace(use_step_noise=False, use_averaging=False)
LEVEL = (0.0, 0.0, -STANDARD_GRAVITY_M_S2)
DOWN = (0.0, 0.0, 1.0)


def test_a_stream_is_slow_by_its_steps_unless_they_are_averages():
    assert slowness(PARAMS, 1 / 25) == 0.0
    assert slowness(PARAMS, 1 / 15) == pytest.approx((1 / 15 - 0.04) / 0.11)
    assert slowness(PARAMS, 1 / 4) == 1.0
    assert slowness(PARAMS._replace(averaged_samples=True), 1 / 4) == 0.0
    assert slowness(FIXED, 1 / 4) == 0.0


def test_after_a_hole_with_a_fast_turn_a_vehicle_at_rest_is_upright_within_two_seconds():
    times = np.concatenate([np.arange(0.0, 20.0, 0.4), [21.0], np.arange(22.0, 30.0, 0.4)])

    def seen_by(params):
        stage = Stage(params)
        for time_s, dt in zip(times, np.diff(times, prepend=0.0).tolist(), strict=True):
            gyr, acc = ZERO_VEC3, LEVEL
            if time_s == 21.0:
                gyr, acc = (radians(-154.0), 0.0, 0.0), (4.0, -4.0, -11.0)
            yield stage.take(Reading(gyr, acc, ZERO_VEC3, False, dt))[0]

    seen, fixed = [*seen_by(PARAMS)], [*seen_by(FIXED)]
    off = np.degrees([angle_between_vectors(s.gravity_b, DOWN) for s in seen])
    sigma = np.degrees([s.sigma_inclination_rad for s in seen])
    in_hole = int(np.flatnonzero(times == 21.0)[0])
    assert sigma[in_hole - 1] == pytest.approx(0.633, rel=0.2)
    assert sigma[in_hole] == pytest.approx(14.8, rel=0.2)
    assert off[times >= 24.0].max() < 0.01  # measured 0.0014
    assert sigma[times >= 26.0].max() == pytest.approx(5.82, rel=0.2)
    off_fixed = degrees(angle_between_vectors(fixed[in_hole + 1].gravity_b, DOWN))
    assert off_fixed == pytest.approx(119.0, rel=0.2)


SLOW_S = 0.6


def in_vehicle(tilt_rad, shaken_m_s2):
    """Errors and sigmas of the inclination from 20 s on; after a rest any rate at all is shown."""
    rng = np.random.default_rng(1)

    def sample(k):
        t, moves = SLOW_S * k, SLOW_S * k > 10.0
        wobble = radians(4.0) * rng.standard_normal(2) * moves
        q = from_euler_rad(tilt_rad(t) + wobble[0], wobble[1], 0.3)
        gyr = tuple((3.0 * moves * rng.standard_normal(3)).tolist())
        acc = rotate_inverse(q, LEVEL) + (shaken_m_s2 * moves + 0.02) * rng.standard_normal(3)
        return Sample(q, gyr, tuple(acc.tolist()), has_mag=False)

    params = PARAMS._replace(in_vehicle=True)
    return inclinations(map(sample, range(200)), SLOW_S, params)[:, round(20.0 / SLOW_S) :]


def test_a_shaken_vehicle_is_held_at_its_usual_tilt():
    error, sigma = in_vehicle(lambda _t: radians(10.0), 6.0)
    assert rms(error) < 19.0
    assert np.mean(error < sigma) > 0.8


def test_the_vertical_of_a_vehicle_that_tilts_follows_its_force():
    error, sigma = in_vehicle(lambda t: 1.2 * np.sin(2.0 * pi * t / 40.0) * (t > 10.0), 0.3)
    assert rms(error) < 3.2
    assert np.mean(error < sigma) > 0.8
