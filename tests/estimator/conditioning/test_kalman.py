"""Every update of conditioning beside a dense Kalman filter, on values without any symmetry."""

from math import radians, sqrt

import numpy as np
import pytest

from estimator.conditioning.field import calibration
from estimator.conditioning.field.magnetic import FieldLook
from estimator.conditioning.field.step import heading_noise, learn_heading
from estimator.conditioning.params import ACCELERATION_LASTS_S, FORGET_S, HEADING_REACH_RAD
from estimator.conditioning.state import initial_state
from estimator.conditioning.vertical import bias as bias_filter
from estimator.conditioning.vertical.lowpass import Smooth, coefficients
from estimator.conditioning.vertical.stillness import RestState, Stillness
from estimator.geometry.axes import FrameAxes, axes_of
from estimator.geometry.quaternion import exp, normalize, rotate
from tests.estimator.conditioning.motion import PARAMS

DT = 0.02
STILL = (0.0, 0.0, 0.0)
UPPER = np.triu_indices(4)


@pytest.fixture(params=range(12))
def rng(request):
    return np.random.default_rng(request.param)


def upper_of(p):
    return tuple(p[UPPER].tolist())


def square(covariance):
    p = np.zeros((4, 4))
    p[UPPER] = covariance
    return p + np.triu(p, 1).T


def hanging_together(rng, sigmas):
    """A covariance with these sigmas, all of whose values are correlated."""
    a = rng.normal(size=(len(sigmas), 2)) @ rng.normal(size=(2, len(sigmas)))
    p = a @ a.T + np.diag(rng.uniform(0.5, 1.0, len(sigmas)) * np.trace(a @ a.T))
    scale = np.array(sigmas) / np.sqrt(np.diag(p))
    return p * np.outer(scale, scale)


def updated(x, p, h, innovation, noises):
    """The dense filter: all rows of ``h`` at once, with the innovations of the same ``x``."""
    gain = np.linalg.solve(h @ p @ h.T + np.diag(noises), h @ p).T
    return x + gain @ innovation, p - gain @ h @ p


def estimate_of(rng):
    p = hanging_together(rng, rng.uniform(0.3, 1.0, 4) * (0.004, 0.007, 0.002, 0.3))
    return bias_filter.Estimate(
        tuple(rng.normal(0.0, 0.004, 3)), float(rng.uniform(-1.0, 1.0)), upper_of(p)
    )


def vector_of(estimate):
    return np.array([*estimate.bias_rad_s, estimate.heading_rad]), square(estimate.covariance)


def assert_is(estimate, x, p):
    now, covariance = vector_of(estimate)
    assert now == pytest.approx(x, rel=1e-9, abs=1e-13)
    scale = np.sqrt(np.outer(np.diag(p), np.diag(p)))
    assert covariance / scale == pytest.approx(p / scale, abs=1e-9)


def test_time_passes_as_in_matrices(rng):
    """The heading gathers what the bias's error turns about down, and takes its covariance."""
    k, before = coefficients(PARAMS, DT, 1.0), estimate_of(rng)
    down = rng.normal(size=3)
    x, p = vector_of(before)
    f = np.eye(4)
    f[3, :3] = -DT * down
    turning, unseen = rng.uniform(0.1, 2.0), rng.uniform(0.0, 1e-4)
    heading = k.heading_growth + PARAMS.heading_turning_noise_s * turning * DT + unseen
    grown = f @ p @ f.T + np.diag([k.bias_growth] * 3 + [heading])
    assert_is(bias_filter.predict(PARAMS, k, before, tuple(down), turning, unseen), x, grown)


def test_rest_shows_the_bias(rng):
    k, before = coefficients(PARAMS, DT, 1.0), estimate_of(rng)
    gyr = rng.normal(0.0, 0.004, 3)
    x, p = vector_of(before)
    turning, (level, down) = rng.normal(0.0, 0.002, 3), rng.uniform(0.0, 1e-4, 2)
    rest = RestState(gyr=Smooth(tuple(gyr), STILL))
    still = Stillness(turning=tuple(turning), level_variance=level, down_variance=down)
    axes = axes_of(normalize(tuple(rng.normal(size=4))))
    after = bias_filter.learn_at_rest(PARAMS, k, before, axes, rest, still)
    noises = k.rest_noise + np.array([level, level, down]) * PARAMS.rest_time_s / DT
    h = np.column_stack([axes, np.zeros(3)])
    assert_is(after, *updated(x, p, h, h[:, :3] @ (gyr - turning - x[:3]), noises))


def test_levelling_in_motion_shows_the_bias(rng):
    """Low-passed axes are neither unit vectors nor across each other."""
    k, before = coefficients(PARAMS, DT, 1.0), estimate_of(rng)
    axes = rng.normal(0.0, 0.5, (2, 3))
    drift, step = rng.normal(0.0, 0.003, 2), rng.normal(0.0, 1e-4, 2)
    lagged = bias_filter.Lagged(*(Smooth(tuple(v), STILL) for v in (*axes, (*drift, 0.0))))
    x, p = vector_of(before)
    # as uncertain as the bias is, so that the second axis has much to take off
    unseen = float(rng.uniform(1e-6, 1e-5))
    h = np.column_stack([axes, np.zeros(2)])
    after = bias_filter.learn_in_motion(PARAMS, k, before, lagged, tuple(step), unseen)
    noises = [k.motion_noise + unseen] * 2
    assert_is(after, *updated(x, p, h, -step / DT + drift - axes @ x[:3], noises))


def field_of(confidence, age_s):
    field = initial_state(PARAMS).field.magnetic
    reference = field.reference._replace(horizontal=0.2, down=0.42, age_s=age_s)
    return field._replace(look=FieldLook(0.2, 0.42, confidence), reference=reference)


def test_the_fields_heading_shows_heading_and_bias(rng):
    before, field = estimate_of(rng), field_of(0.7, 30.0)
    off, tilt_variance = float(rng.uniform(-0.4, 0.4)), float(rng.uniform(0.0, 0.01))
    x, p = vector_of(before)
    noise = heading_noise(PARAMS, field, 0.8) / DT + tilt_variance * (0.42 / 0.2) ** 2
    noise *= (1.0 + off**2 / (HEADING_REACH_RAD**2 + 9.0 * p[3, 3])) ** 2
    after = learn_heading(PARAMS, before, field, (0.2, 0.2 * off), 0.8, DT, tilt_variance)
    h = np.array([[0.0, 0.0, 0.0, 1.0]])
    assert_is(after, *updated(x, p, h, np.array([-off]), [noise]))


def test_inflating_the_heading_leaves_the_bias_as_it_is():
    before = estimate_of(np.random.default_rng(1))
    x, p = vector_of(before)
    assert_is(bias_filter.inflate_heading(before, 0.3), x, p + np.diag([0.0, 0.0, 0.0, 0.3]))


def body_that_has_turned(rng):
    """A calibration's state of 2 s, whose means are of other attitudes, and the axes of G now."""
    q = normalize(tuple(rng.normal(size=4)))
    past = FrameAxes(*(tuple(v) for v in rng.normal(0.0, 0.2, (3, 3))))
    p = hanging_together(rng, (0.03, 0.05, 0.08, 0.02))
    state = initial_state(PARAMS).field.calibration
    learnt = state.learnt._replace(
        lag_s=0.01, offset=tuple(rng.normal(0.0, 0.02, 3)), covariance=upper_of(p), scale=0.46
    )
    turning = tuple(rng.normal(0.0, 1.0, 3))
    return state._replace(learnt=learnt, axes=past, turning=turning, age_s=2.0), axes_of(q)


@pytest.mark.parametrize("turned", [True, False])
def test_a_turning_body_shows_lag_and_own_field(rng, turned):
    """Of a body that has not ``turned`` enough the axes show only the lag."""
    params = PARAMS._replace(
        calibration_reach=1e9, calibration_turn=0.0 if turned else 1e9, calibration_noise_s=0.0002
    )
    state, axes = body_that_has_turned(rng)
    norm, gyr = 0.46, rng.normal(0.0, 2.0, 3)
    y = rng.normal((0.4, 0.1, 0.7), 0.1)
    state = state._replace(field=tuple(y - rng.normal(0.0, 0.1, 3)), scatter=0.004)
    after = calibration.learn_calibration(
        params, state, axes, tuple(gyr), tuple((norm * y).tolist()), norm, DT, 0.0
    ).learnt

    share = 1.0 - DT / (2.0 + DT)  # what is left of a difference once the mean has taken it
    R = np.array(axes)
    dx = share * (np.cross(R @ gyr, y) - state.turning)
    dy = share * (y - state.field)
    rows = share * (R - np.array(state.axes)) * turned
    walk = DT / FORGET_S
    grown = [PARAMS.field_offset_sigma**2 * walk] * 3 + [PARAMS.field_lag_sigma_s**2 * walk]
    x, p = np.array([*state.learnt.offset, 0.01]), square(state.learnt.covariance)
    h = np.column_stack([rows, dx])
    high_pass_s = ACCELERATION_LASTS_S
    scatter = (1.0 - DT / (high_pass_s + DT)) * 0.004
    kept_on = x[:3] - calibration.own_field(state.learnt)[0]  # no error: it has not been taken off
    x, p = updated(
        x, p + np.diag(grown), h, dy - rows @ kept_on, [(0.0002 + high_pass_s * scatter) / DT] * 3
    )
    assert [*after.offset, after.lag_s] == pytest.approx(x, rel=1e-9, abs=1e-12)
    assert square(after.covariance) == pytest.approx(p, rel=1e-8, abs=1e-14)


def test_what_changes_the_field_of_a_body_that_stands_still_is_scatter():
    """Three axes share it."""
    axes = axes_of((1.0, 0.0, 0.0, 0.0))
    state = initial_state(PARAMS).field.calibration
    for field in ((0.2, 0.0, 0.42), (0.23, 0.0, 0.40)):
        state = calibration.learn_calibration(PARAMS, state, axes, STILL, field, 0.46, DT, 0.0)
    change = 0.5 * np.array((0.03, 0.0, -0.02)) / 0.46
    share = DT / (ACCELERATION_LASTS_S + DT)
    assert state.scatter == pytest.approx(share * np.dot(change, change) / 3.0)


@pytest.mark.parametrize(("sigma", "share"), [(0.0, 1.0), (0.05, 0.75), (0.15, 0.25)])
def test_of_an_own_field_the_share_counts_that_is_no_error(sigma, share):
    covariance = (sigma**2, 0.3, 0.2, 0.1, sigma**2, 0.1, 0.2, sigma**2, 0.3, 0.1)
    learnt = calibration.Calibration(0.0, (0.03, 0.0, 0.04), covariance, 0.48)
    found, left = calibration.own_field(learnt)
    assert found == pytest.approx((share * 0.03, 0.0, share * 0.04))
    assert left == pytest.approx(share * sigma**2 / 9.0)
    assert calibration.own_field(learnt._replace(offset=STILL)) == (STILL, 0.0)


def test_a_field_is_taken_without_the_own_one_and_turned_on_by_its_age(rng):
    """It is 40 ms old, which leaves an error of third order in the turn."""
    w, m = rng.normal(0.0, 1.2, 3), rng.normal(size=3)
    learnt = calibration.Calibration(0.04, tuple(rng.normal(0.0, 0.1, 3)), (0.05,) * 10, 0.48)
    own, _ = calibration.own_field(learnt)  # the share of it that is no error
    found = calibration.correct_field(tuple(m + 0.48 * np.array(own)), tuple(w), learnt)
    now = rotate(exp(tuple(-0.04 * w)), tuple(m))
    third_order = np.linalg.norm(0.04 * w) ** 3 / 6.0 * np.linalg.norm(m)
    assert np.linalg.norm(np.subtract(found, now)) < 1.01 * third_order


@pytest.mark.parametrize(("lasts_s", "sigma_deg", "expected"), [(0.3, 4.0, 1.0), (1.0, 1.5, 0.48)])
def test_variance_is_that_of_the_errors_of_a_field_that_drifts(lasts_s, sigma_deg, expected):
    """The density of its errors, 2 sigma^2 tau, is as the filter assumes, or half of it."""
    rng = np.random.default_rng(7)
    step_s = 0.05
    k = coefficients(PARAMS, step_s, 1.0)
    field = field_of(1.0, 1e5)  # nothing is early any more
    first = initial_state(PARAMS).vertical.estimate
    first = first._replace(covariance=(*first.covariance[:9], radians(5.0) ** 2))
    sigma, left = radians(sigma_deg), np.exp(-step_s / lasts_s)
    ratios = []
    for _ in range(100):
        estimate = first
        truth, bias = rng.normal(0.0, radians(5.0)), rng.normal(0.0, radians(0.5))
        error = rng.normal(0.0, sigma)
        for drift, noise in rng.normal(size=(1200, 2)):
            estimate = bias_filter.predict(PARAMS, k, estimate, (0.0, 0.0, 1.0), 0.0, 0.0)
            truth -= step_s * (bias - estimate.bias_rad_s[2])
            truth += drift * sqrt(k.heading_growth)
            error = left * error + sqrt(1.0 - left * left) * sigma * noise
            off = estimate.heading_rad - truth + error
            estimate = learn_heading(PARAMS, estimate, field, (0.2, 0.2 * off), 1.0, step_s, 0.0)
        ratios.append((estimate.heading_rad - truth) ** 2 / estimate.covariance[9])
    assert np.mean(ratios) == pytest.approx(expected, rel=0.2)
