"""Every step of the aiding against the same filter in dense matrices, on data without symmetry."""

from math import exp, sqrt

import numpy as np
import pytest

from estimator.aiding import types
from estimator.aiding.beginning import blank_aiding
from estimator.aiding.inertial import Prediction, apply_corrections, predict_motion, watch_knocks
from estimator.aiding.search import UNKNOWN_RAD
from estimator.aiding.sources import field, unaided, velocity
from estimator.aiding.velocity_history import ROWS, new_velocity_history
from estimator.conditioning.field.magnetic import FieldLook
from estimator.conditioning.params import HEADING_REACH_RAD, LONGEST_STEP_S
from estimator.conditioning.vertical.bias import SETTLED_HEADING_RAD
from estimator.conditioning.vertical.tilt import LEAST_OFF_RAD
from estimator.geometry.quaternion import multiply, normalize
from estimator.types import NOTHING_BETWEEN, ZERO_VEC3, Between, Sample
from tests.estimator.aiding.dense_filter import (
    G_NED,
    Dense,
    field_rows,
    floats,
    matrix_of,
    predicted,
    sources,
    three,
    turned,
    velocity_row,
)

PARAMS = types.AidingParams()
BLANK, _, _ = blank_aiding(PARAMS)
NO_HISTORY = new_velocity_history(ZERO_VEC3)
# Of each error, in its own unit: what a flight leaves unknown, all different.
SIGMAS = np.array(
    [
        *(0.05, 0.08, 0.3, 0.4, 0.6, 0.2, 0.004, 0.007, 0.003, 0.04, 0.06, 0.03, 0.004, 0.02),
        *(0.06, 0.01, 0.03, 0.02, 0.02, 0.04, 0.03, 0.05, 0.012, 0.15, 0.25, 0.1, 0.3, 0.2, 0.15),
    ]
)


@pytest.fixture(params=range(4))
def rng(request):
    return np.random.default_rng(request.param)


def covariance(rng):
    """Every error tied to every other."""
    root = np.eye(types.SIZE) + 0.15 * rng.standard_normal((types.SIZE, types.SIZE))
    return SIGMAS[:, None] * (root @ root.T) * SIGMAS


def estimate(rng):
    return BLANK.estimate._replace(
        q_ned_frd=normalize(floats(rng.standard_normal(4))),
        velocity_ned_m_s=floats(10.0 * rng.standard_normal(3)),
        gyr_bias_rad_s=floats(0.01 * rng.standard_normal(3)),
        acc_bias_m_s2=floats(0.1 * rng.standard_normal(3)),
        imu_lag_s=0.013,
        acc_lead_s=0.034,
        field_lag_s=0.05,
        compass_turn_rad=0.4,
        hard_iron_gauss=floats(0.03 * rng.standard_normal(3)),
        earth_gauss=(0.17, 0.08, 0.41),
        receiver_lag_s=0.11,
        filter_lag_s=0.006,
        receiver_error_m_s=floats(0.2 * rng.standard_normal(3)),
        filter_error_m_s=floats(0.3 * rng.standard_normal(3)),
    )


def agreement(rng):
    scales, before = rng.uniform((0.5, 0.5, 20), (3.0, 3.0, 50)), (0.4, -2.0, 1.1)
    return types.Agreement(types.Scatter(*floats(scales), before, 0.3), 0.2, 0.1)


def velocity_history_of(rng, step_s):
    """Random accelerations, each step's gain by the trapezoid, newest first."""
    velocity_history = new_velocity_history(ZERO_VEC3)
    velocity_history[:, 0] = 5.0 - step_s * np.arange(ROWS)
    velocity_history[:, 4:] = 4.0 * rng.standard_normal((ROWS, 3))
    steps = 0.5 * step_s * (velocity_history[:-1, 4:] + velocity_history[1:, 4:])
    velocity_history[:, 1:4] = np.cumsum(np.vstack([np.zeros(3), steps[::-1]]), axis=0)[::-1]
    return velocity_history


def newest_deviation(velocity_history):
    """How far the newest acceleration lies off the line through the two before."""
    (t0, t1, t2), (a0, a1, a2) = velocity_history[:3, 0], velocity_history[:3, 4:]
    return a0 - a1 - min(1.0, (t0 - t1) / (t1 - t2)) * (a1 - a2)


@pytest.mark.parametrize("error_m_s", [0.2, 3.0])
@pytest.mark.parametrize("seen", [False, True])
def test_prediction(rng, error_m_s, seen):
    """One step; ``seen``: others have seen the turning, and large errors last longer."""
    P, before, dt = covariance(rng), estimate(rng), 0.03
    before = before._replace(
        receiver_error_m_s=(error_m_s, -0.1, 0.2), filter_error_m_s=(0.1, 2.0 * error_m_s, 0.0)
    )
    gyr, earlier = rng.standard_normal(3), rng.standard_normal(3)
    force = np.array([1.0, -2.5, -9.0])
    last = types.LastStep(floats(gyr), floats(earlier), floats(force), ZERO_VEC3, 0.05)
    known = types.Agreements(by_filter=agreement(rng), by_receiver=agreement(rng))
    rough = BLANK.rough._replace(knocked=5.0)
    state = BLANK._replace(estimate=before, last=last, agreement=known, rough=rough)
    turn, change = rng.standard_normal(3), rng.standard_normal(3)
    between = Between(True, floats(turn), floats(change), 0.01) if seen else NOTHING_BETWEEN
    acc = floats(3.0 * rng.standard_normal(3))
    sample = Sample(floats(gyr), acc, ZERO_VEC3, False, dt, between)
    velocity_history = velocity_history_of(rng, 0.04)
    now = predict_motion(PARAMS, state, P, velocity_history, sample)
    watch_knocks(now.covariance, rough, now.velocity_history, dt)

    w = (turn if seen else gyr) - np.array(before.gyr_bias_rad_s)
    R = matrix_of(before.q_ned_frd) @ turned(w * dt)
    now_turning = gyr - np.array(before.gyr_bias_rad_s)
    felt = R @ turned(0.034 * now_turning) @ (np.array(acc) - before.acc_bias_m_s2)
    gained = 0.5 * dt * (felt + force)
    assert matrix_of(now.estimate.q_ned_frd) == pytest.approx(R, abs=1e-12)
    v = np.array(before.velocity_ned_m_s) + gained + dt * G_NED
    assert now.estimate.velocity_ned_m_s == pytest.approx(v)
    assert now.force_ned_m_s2 == pytest.approx(felt)

    seen_s = 0.01 if seen else dt
    second_difference = dt * (-(dt / 0.05) * (gyr - earlier))
    aliased_turn = R @ (sqrt(dt * seen_s) * change if seen else second_difference)
    newest = [velocity_history[0, 0] + dt, *np.zeros(3), *(felt + G_NED)]
    off = newest_deviation(np.vstack([newest, velocity_history[:2]]))
    keeps, variances = slow_errors(before, known, dt, force)
    fades = np.array([now.estimate.receiver_error_m_s, now.estimate.filter_error_m_s])
    slow = np.array([before.receiver_error_m_s, before.filter_error_m_s])
    assert fades == pytest.approx(slow * np.array(keeps)[:, None])
    unseen = (PARAMS.gyr_slow_noise_1_s * seen_s) ** 2 * (w @ w) * dt
    Q = noise_of_step(P, before.earth_gauss, dt, unseen, aliased_turn, off, variances)
    wanted = predicted(P, R, gained, dt, *keeps) + Q
    np.testing.assert_allclose(now.covariance, wanted, rtol=1e-9, atol=1e-14)


def slow_errors(before, known, dt, force):
    """Of a receiver's slow error and a filter's: the share that stays, and the variance added."""
    p, keeps, variances = PARAMS, [], []
    push = p.filter_turning_s**2 * (force[0] ** 2 + force[1] ** 2)
    for error, usual, agreement in (
        (before.receiver_error_m_s, p.receiver_error_m_s**2, known.by_receiver),
        (before.filter_error_m_s, p.filter_error_m_s**2 + push, known.by_filter),
    ):
        variance = usual * max(1.0, agreement.scatter.noise_scale)
        longer = min(16.0, max(1.0, np.dot(error, error) / (9.0 * variance)))
        keeps.append(exp(-dt / (5.0 * longer)))
        variances.append(variance * (1.0 - exp(-dt / 5.0) ** 2))
    return keeps, variances


def noise_of_step(P, earth_gauss, dt, unseen, aliased_turn, off, slow_variances):
    """(SIZE, SIZE) of one step, whose newest force lies ``off`` the line through two others."""
    p, E, aliased_push = PARAMS, np.array(earth_gauss), dt * off
    Q = np.zeros((types.SIZE, types.SIZE))
    d = np.einsum("ii->i", Q)
    d[three(types.TURN)] = unseen + (p.integration_noise * aliased_turn) ** 2
    d[three(types.VELOCITY)] = p.acc_noise**2 * dt + (p.integration_noise * aliased_push) ** 2
    d[three(types.GYR_BIAS)] = p.gyr_bias_sigma**2 * dt / 2500.0
    d[three(types.ACC_BIAS)] = p.acc_bias_sigma**2 * dt / 2500.0
    iron = p.hard_iron_sigma_gauss**2
    d[three(types.HARD_IRON)] = np.where(
        np.diag(P)[three(types.HARD_IRON)] < iron, iron * dt / 2500.0, 0.0
    )
    H, walk = E[:2] @ E[:2], 0.1**2 * dt / 600.0
    Q[types.EARTH : types.EARTH + 2, types.EARTH : types.EARTH + 2] = (
        walk * (1.0 + E[2] ** 2 / H) * np.outer(E[:2], E[:2])
    )
    d[types.EARTH + 2] = walk * (E @ E)
    d[three(types.RECEIVER_ERROR)], d[three(types.FILTER_ERROR)] = slow_variances
    knock = max(0.0, 1.0 - 16.0 * 5.0 / (off @ off)) * aliased_push**2  # usual: 5 (m/s^2)^2
    for own, sign in (
        (types.VELOCITY, 1.0),
        (types.FILTER_ERROR, -1.0),
    ):  # the filter's slow error is the same
        for k in range(3):
            Q[own + k, types.VELOCITY + k] += sign * knock[k]
            Q[own + k, types.FILTER_ERROR + k] -= sign * knock[k]
    return Q


@pytest.mark.parametrize("is_receiver", [True, False])
@pytest.mark.parametrize(("off_m_s", "is_alone"), [(0.3, False), (12.0, False), (12.0, True)])
@pytest.mark.parametrize("dt", [0.04, 0.25])
def test_velocity(rng, is_receiver, off_m_s, is_alone, dt):
    """Three updates in a row, each with what the one before has left; some reports are far off."""
    known, P = estimate(rng), covariance(rng)
    velocity_history, q = velocity_history_of(rng, 0.04), known.q_ned_frd
    now = Prediction(known, ZERO_VEC3, ZERO_VEC3, velocity_history, P.copy())
    off = off_m_s * rng.standard_normal(3)
    report = types.Report(
        True, floats(known.velocity_ned_m_s + off), True, 0.5, 0.07, 0.1 * is_receiver
    )
    before, other = agreement(rng), agreement(rng)._replace(wait_s=9.0 if is_alone else 0.0)
    both = types.Agreements(other, before) if is_receiver else types.Agreements(before, other)
    x = (x0 := SIGMAS * rng.standard_normal(types.SIZE) * 0.1).copy()
    after = velocity.take_report(PARAMS, both, now, dt, report, (0.0, 0.0, 1.0), x)

    error_at, lag_at = sources()[is_receiver]
    slow = known.receiver_error_m_s if is_receiver else known.filter_error_m_s
    age = 0.07 + (known.receiver_lag_s if is_receiver else known.filter_lag_s) - known.imu_lag_s
    age += known.acc_lead_s
    times, accelerations = (
        velocity_history[::-1, 0] - velocity_history[0, 0],
        velocity_history[::-1, 4:],
    )
    p = PARAMS
    sigma = p.receiver_noise_m_s if is_receiver else p.filter_noise_m_s
    sigma *= max(1.0, 0.5 / p.report_sigma_m_s)
    aliasing = p.integration_noise * dt * min(1.0, 0.07 / dt) * newest_deviation(velocity_history)
    dense = Dense(P.copy(), x0.copy())
    noise_scale, innovation, reports, last, together = before.scatter
    units = []
    share = 0.2 / (0.2 + 15.0) / 3.0
    far = noise_scale > 30.0 and matrix_of(q)[2, 2] < 0.7
    for i in range(3):
        v = np.array(known.velocity_ned_m_s)
        expected_m_s, h = velocity_row(
            times, accelerations, age, v, slow, i, error_at, lag_at, knows_lag=dt < LONGEST_STEP_S
        )
        innovation_m_s = report.velocity_ned_m_s[i] - expected_m_s
        noise = noise_scale * sigma**2 + aliasing[i] ** 2
        left = innovation_m_s - h @ dense.x
        square = left**2 / (h @ dense.P @ h + noise)
        reports += 1.0
        innovation += max(share, 1.0 / reports) * (min(square, 9.0) - innovation)
        units.append(np.sign(left) * sqrt(min(square, 9.0)))
        together += max(share, 1.0 / reports) * (units[i] * last[i] - together)
        noise_scale *= 1.0 + (min(square, 25.0) - 1.0) / 300.0
        noise_scale = min(max(noise_scale, 1.0 / 9.0 if is_receiver else 1.0), 100.0)
        if square > 16.0:
            far = True
            loose = (types.VELOCITY if is_alone else error_at) + i
            dense.P[loose, loose] += left**2
        dense.learn(h, innovation_m_s, noise)
    np.testing.assert_allclose(x, dense.x, rtol=1e-6, atol=1e-8 * off_m_s)
    np.testing.assert_allclose(now.covariance, dense.P, rtol=1e-5, atol=1e-8)
    assert np.linalg.eigvalsh(now.covariance).min() > 0.0
    mine, untouched = (after.by_receiver, after.by_filter)[:: 1 if is_receiver else -1]
    assert untouched == other
    assert mine.scatter[:3] == pytest.approx((noise_scale, innovation, reports), rel=1e-6)
    assert (*mine.scatter.latest, mine.scatter.together) == pytest.approx((*units, together))
    assert (mine.wait_s, mine.far_off_s) == (0.0, pytest.approx(0.3 if far else 0.0))
    assert far == (off_m_s > 1.0)


@pytest.mark.parametrize("is_known", [True, False])
@pytest.mark.parametrize(
    ("unfelt_rad", "off_rad"), [(0.1, 0.02), (0.1, 0.9), (-0.9, 0.02), (2.0, -0.9)]
)
def test_field(rng, is_known, unfelt_rad, off_rad):
    """Across, along and down, and the declination: up to four updates in a row."""
    known, P, p = estimate(rng), covariance(rng), PARAMS
    rate, dt = 2.0 * rng.standard_normal(3), 0.1
    E = np.array(known.earth_gauss)
    w = rate - np.array(known.gyr_bias_rad_s)
    t = -known.field_lag_s * w
    angle = np.linalg.norm(t)
    back = floats([np.cos(angle / 2), *(np.sin(angle / 2) / angle * t)])
    q_then = multiply(known.q_ned_frd, back)
    R = matrix_of(q_then) @ turned([0.0, 0.0, -known.compass_turn_rad])
    seen = turned([0.02, -0.03, unfelt_rad]) @ E * 1.02
    m = R.T @ seen
    sample = Sample(floats(rate), ZERO_VEC3, floats(m + known.hard_iron_gauss), True, dt)
    look = FieldLook(horizontal=0.2, down=0.38, confidence=0.7)
    state = types.FieldState(look, off_rad, 30.0, dt, 0.4, 0.0)
    now = Prediction(known, ZERO_VEC3, ZERO_VEC3, NO_HISTORY, P.copy())
    north = types.North(is_known, floats((np.cos(0.4), np.sin(0.4))))
    others = types.StepInputs((0.0, 0.0, 1.0), 0.1, 0.0, north)
    x = (x0 := SIGMAS * rng.standard_normal(types.SIZE) * 0.1).copy()
    after = field.observe_heading(p, state, now, others, sample, x)

    F, rows = field_rows(q_then, known.compass_turn_rad, w, m, E)
    H, n = np.hypot(E[0], E[1]), np.linalg.norm(E)
    c, s = E[:2] / H
    across, along = np.array([-s, c, 0.0]), np.array([c, s, 0.0])
    angle = np.arctan2(across @ F, along @ F)
    h = across / H @ rows
    h[three(types.TURN)] = [-c * F[2] / H, -s * F[2] / H, 1.0]
    h[types.COMPASS_TURN] = -h[three(types.TURN)] @ R[:, 2]
    noise = p.heading_noise**2 / (dt * after.look.confidence)
    heading = h @ P @ h
    # what nothing explains is noise, a first order process of 4 s, and as much the heading's
    unexplained = max(0.0, off_rad**2 - heading - p.heading_noise**2 / 8.0)
    noise += 8.0 * unexplained / dt
    P[types.TURN + 2, types.TURN + 2] += after.look.confidence * unexplained * dt / 4.0
    noise *= (1.0 + angle**2 / (HEADING_REACH_RAD**2 + 9.0 * heading)) ** 2
    is_near = along @ F >= 0.5 * abs(across @ F)
    dense, off = Dense(P.copy(), x0.copy()), -(across @ F) / H
    if not is_near and P[types.TURN + 2, types.TURN + 2] > SETTLED_HEADING_RAD**2:
        flat = np.array([-F[1], F[0], 0.0]) / (F[0] ** 2 + F[1] ** 2)
        h = flat @ rows
        h[types.EARTH : types.EARTH + 2] = np.array([E[1], -E[0]]) / H**2
        off = -angle
    dense.learn(h, off, noise)
    tilt = 0.0 if is_near else 0.5 * (dense.P[0, 0] + dense.P[1, 1])
    for axis, shows in ((along, E[2]), (np.array([0.0, 0.0, 1.0]), H)):
        h = axis / n @ rows
        if not is_near:
            h[three(types.TURN)] = h[types.COMPASS_TURN] = 0.0
        dense.learn(h, axis @ (E - F) / n, noise + tilt * (shows / n) ** 2)
    if is_known:
        h = np.zeros(types.SIZE)
        h[types.EARTH : types.EARTH + 2] = np.array([-E[1], E[0]]) / H**2
        wanted_rad = 0.4 - np.arctan2(E[1], E[0])
        dense.learn(h, wanted_rad, LEAST_OFF_RAD**2 * 100.0 / dt)
    np.testing.assert_allclose(x, dense.x, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(now.covariance, dense.P, rtol=1e-7, atol=1e-12)
    is_far = abs(angle) > UNKNOWN_RAD + 2.0 * sqrt(heading)
    far_off_s = 0.4 + dt * after.look.confidence if is_far else 0.4 - dt
    assert after.far_off_s == pytest.approx(far_off_s)
    slow = off_rad + dt / (dt + 4.0) * (max(-0.2, min(0.2, off)) - off_rad)
    assert after.off_rad == pytest.approx(slow)


@pytest.mark.parametrize("tilt_rad", [(0.3, -0.5, 0.0), (-2.4, 1.4, 0.0)])
def test_unaided_gravity(rng, tilt_rad):
    """Both updates, of an attitude whose errors about north and east are tied; upside down, too."""
    known, P, dt = estimate(rng), covariance(rng), 0.3
    R = matrix_of(known.q_ned_frd)
    d = turned(tilt_rad) @ [0.0, 0.0, 1.0]
    gravity_b = floats(R.T @ d)
    now = Prediction(known, ZERO_VEC3, ZERO_VEC3, NO_HISTORY, P.copy())
    level = np.hypot(d[0], d[1])
    others = types.StepInputs(gravity_b, 0.1, 0.0, types.North(False, (1.0, 0.0)))
    after, _ = unaided.level(now, BLANK.correction_cusum, others, 0.2, 0.6, dt)
    turn = np.arctan2(level, d[2]) / level
    noise = (0.1**2 * (1.0 / dt) + 0.2**2 * (3.0 / dt)) / 0.6
    dense = Dense(P.copy(), np.zeros(types.SIZE))
    # the turn that takes down to where it was seen points along d x down
    for axis, innovation in ((1, -turn * d[0]), (0, turn * d[1])):
        dense.learn(np.eye(types.SIZE)[types.TURN + axis], innovation, noise)
    wanted = np.hstack(apply_corrections(now, dense.x).estimate)
    np.testing.assert_allclose(np.hstack(after.estimate), wanted, rtol=1e-9, atol=1e-13)
    np.testing.assert_allclose(after.covariance, dense.P, rtol=1e-8, atol=1e-13)
