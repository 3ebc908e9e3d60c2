"""A whole step of the aiding: in what order its parts are put together."""

import numpy as np
import pytest

from estimator.aiding import Beginning, Report, aid, begin, blank_aiding
from estimator.aiding.acceleration_tilt import acceleration_tilt_angle
from estimator.aiding.consistency import Apart, average
from estimator.aiding.correction import apply_corrections
from estimator.aiding.course import STANDING
from estimator.aiding.inertial import predict_motion
from estimator.aiding.search import EMPTY_SEARCH, Evidence, Search, Window, add_report, add_sample
from estimator.aiding.sources.unaided import observe_unaided
from estimator.aiding.types import (
    HARD_IRON,
    NO_REPORT,
    SIZE,
    AccelerationTilt,
    Agreements,
    AidingParams,
    North,
    Roughness,
    Sigmas,
    StepInputs,
)
from estimator.aiding.unseen import add_unseen_turn, watch_turning
from estimator.conditioning.times import LONG_S
from estimator.filter.observation import ReferenceParams
from estimator.geometry.quaternion import exp, rotate_inverse
from estimator.live.aided import aided_vectors, is_worse
from estimator.live.core import UNSEEN
from estimator.types import IDENTITY, STANDARD_GRAVITY_M_S2, ZERO_VEC3, Sample

PARAMS = AidingParams()
STATE, _, TRAIL = blank_aiding(PARAMS)
OTHERS = StepInputs((0.1, -0.2, 0.97), 0.1, 0.0, North(False, (1.0, 0.0)))
SAMPLE = Sample((0.1, 0.2, -0.1), (0.5, -0.3, -9.7), ZERO_VEC3, False, 0.5)


def covariance():
    root = np.eye(SIZE) + 0.1 * np.random.default_rng(3).standard_normal((SIZE, SIZE))
    return 0.01 * root @ root.T


@pytest.mark.parametrize(
    ("dt_s", "wait_s", "lean_m_s2"),
    [(0.5, 0.0, 1.0), (0.5, 3.0, 0.0), (0.02, 3.0, 3.0)],  # reported, not believed, felt
)
def test_a_step_that_is_slow_or_without_reports_is_corrected_once(dt_s, wait_s, lean_m_s2):
    """By the unaided gravity, and nothing else comes with it: no report, no field."""
    P, sample = covariance(), SAMPLE._replace(dt_s=dt_s)
    agreement = Agreements(*(each._replace(wait_s=wait_s) for each in STATE.agreement))
    acceleration_tilt = AccelerationTilt((3.0, 0.0, 0.0), (1.0, 1.0, 9.0), (2.5, 3.0, 0.0))
    state = STATE._replace(agreement=agreement, acceleration_tilt=acceleration_tilt)
    after, after_P, _ = aid(PARAMS, state, P, TRAIL, sample, NO_REPORT, OTHERS)
    now, x = predict_motion(PARAMS, state, P, TRAIL, sample), np.zeros(SIZE)
    if dt_s == 0.5:
        watch_turning(PARAMS, state, now.covariance, sample, 0.0)
    lean_rad = lean_m_s2 / STANDARD_GRAVITY_M_S2
    observe_unaided(now, OTHERS.gravity_b, 0.1, lean_rad, x, 1.0, dt_s)
    assert np.abs(x[:3]).max() > 1e-4
    assert after.estimate == apply_corrections(now, x).estimate
    assert np.array_equal(after_P, now.covariance)


def test_a_step_remembers_the_velocity_that_it_was_told():
    report = Report(True, (1.0, -2.0, 0.5), True, 0.3, 0.0, 0.0)
    after, _, _ = aid(PARAMS, STATE, covariance(), TRAIL, SAMPLE, report, OTHERS)
    assert after.acceleration_tilt.latest_m_s == report.velocity_ned_m_s
    assert after.agreement.by_filter.wait_s == 0.0
    assert after.agreement.by_receiver.wait_s == SAMPLE.dt_s


def test_the_lean_is_the_lesser_acceleration_over_gravity():
    """Gained 2.5 m/s in the 2.5 s of the mean: 1 m/s^2, of 3 that were felt."""
    acceleration_tilt = AccelerationTilt((3.0, 0.0, 0.0), (1.0, 1.0, 9.0), (2.5, 3.0, 0.0))
    assert acceleration_tilt_angle(acceleration_tilt, is_silent=False, slow=0.0) == pytest.approx(
        1.0 / 9.80665
    )
    assert acceleration_tilt_angle(acceleration_tilt, is_silent=True, slow=0.0) == pytest.approx(
        3.0 / 9.80665
    )


def test_a_windows_evidence_is_half_as_old_as_the_window_is_long():
    """What turned G since it began has turned the mean of the window half as far."""
    search, _ = add_report(
        EMPTY_SEARCH, Report(True, ZERO_VEC3, True, 0.3, 0.0, 0.0), IDENTITY, DOWN
    )
    for _ in range(15):
        search = add_sample(search, IDENTITY, (1.0, 2.0, -9.0), 0.1, 0.0)
    closed, is_closed = add_report(
        search, Report(True, (2.0, 1.0, 0.3), True, 0.3, 0, 0.0), IDENTITY, DOWN
    )
    assert is_closed
    a, b = (2.0, 1.0, 0.3 - 9.80665 * 1.5), search.window.pushed_m_s
    np.testing.assert_allclose(closed.evidence.correlation, np.outer(a, b))
    np.testing.assert_allclose(closed.evidence.aged, 0.75 * np.outer(a, b))


def test_both_axes_of_a_tilt_become_usual():
    one = average(Apart(0.0, 0.0, 0.01), 0.02, 0.03, 1.0)
    assert (one.mean_north_rad, one.mean_east_rad) == pytest.approx((0.01, 0.015))
    square = 0.01**2 + 0.015**2
    assert one.usual_square == pytest.approx(0.01 + (square - 0.01) / (LONG_S + 1.0))


def test_the_beginning_is_as_uncertain_as_it_is_told():
    """About north and east by the tilt's sigma, about down by the heading's."""
    first = Beginning(IDENTITY, 0.1, 0.3, hard_iron_sigma_gauss=0.02, field_lag_s=0.05)
    _, P, _ = begin(PARAMS, first, SAMPLE, NO_REPORT)
    assert np.diag(P)[:3] == pytest.approx([0.01, 0.01, 0.09])
    assert np.diag(P)[HARD_IRON : HARD_IRON + 3] == pytest.approx([0.0004] * 3)
    assert np.array_equal(P, np.diag(np.diag(P)))


def test_an_unseen_turn_may_be_about_any_axis():
    P = np.zeros((SIZE, SIZE))
    add_unseen_turn(PARAMS, P, Roughness(1.0, 0.3, 0.0), (0.5, -0.2, 0.1), 0.5, 0.5)
    assert P[0, 0] == P[1, 1] == P[2, 2] > 0.0
    assert np.count_nonzero(P) == 3


DOWN = (0.0, 0.0, 1.0)
EVIDENCE = Evidence(
    correlation=((1.0, 2.0, 3.0), (4.0, 5.0, 6.0), (7.0, 8.0, 9.0)),
    aged=((0.3, 0.1, 0.2), (0.6, 0.4, 0.5), (0.9, 0.7, 0.8)),
    lagging=(0.2, -0.4, 0.6),
    squares=50.0,
    windows=3.0,
    rolled=STANDING,
    late_sigma_s=0.05,
)


@pytest.mark.parametrize("late_sigma_s", [0.0, 0.1])
@pytest.mark.parametrize("has_vertical", [True, False])
def test_a_closed_window_joins_faded_evidence(late_sigma_s, has_vertical):
    """Of 1.4 s; a report that does not know its age is older than it says by that age's sigma."""
    window = Window(
        (1.0, 2.0, -13.0), (0.3, 2.2, -9.5), (0.9, 1.0, -9.2), 1.4, (1.0, 2.0, 3.0), True
    )
    report = Report(True, (2.5, 1.0, 3.2), has_vertical, 0.3, 0.05, late_sigma_s)
    found, is_closed = add_report(Search(window, EVIDENCE), report, IDENTITY, DOWN)
    assert is_closed
    behind_s = 0.05 + late_sigma_s
    time_s = 1.4 - behind_s
    a = np.array((1.5, -1.0, (0.2 if has_vertical else 0.0) - 9.80665 * time_s))
    b = np.subtract(window.pushed_m_s, behind_s * np.array(window.force_m_s2))
    swing = np.subtract(window.force_m_s2, window.first_force_m_s2)
    keep, B = np.exp(-time_s / 30.0), np.array(EVIDENCE.correlation)
    now = found.evidence
    np.testing.assert_allclose(now.correlation, keep * B + np.outer(a, b))
    aged = keep * (np.array(EVIDENCE.aged) + time_s * B)
    np.testing.assert_allclose(now.aged, aged + 0.5 * time_s * np.outer(a, b))
    np.testing.assert_allclose(now.lagging, keep * np.array(EVIDENCE.lagging) + np.cross(b, swing))
    assert now.squares == pytest.approx(keep * 50.0 + a @ a + b @ b)
    assert now.windows == pytest.approx(keep * 3.0 + 1.0)
    assert now.late_sigma_s == max(0.05, late_sigma_s)
    assert found.window.time_s == behind_s
    np.testing.assert_allclose(found.window.pushed_m_s, behind_s * np.array(window.force_m_s2))


def test_confidences_fall_with_their_own_sigmas_and_north_is_where_the_field_points():
    """A place with declination, which nobody has told."""
    q = exp((0.3, -0.2, 2.0))
    estimate = STATE.estimate._replace(q_ned_frd=q, earth_gauss=(0.20, -0.15, 0.40))
    state = STATE._replace(estimate=estimate, sigma=Sigmas(0.05, 0.6))
    reference = ReferenceParams((0.6, 0.1, 0.79), (0.0, 0.0, 1.0), 2.0, 3.0, 0.5)
    vectors = aided_vectors(reference, state, False, 1.5)
    assert vectors.v1_frd == pytest.approx(rotate_inverse(q, (0.8, -0.6, 0.0)))
    assert vectors.v2_frd == pytest.approx(rotate_inverse(q, (0.0, 0.0, 1.0)))
    assert vectors.s1 == pytest.approx(1.5 * 2.0 / (1.0 + (0.6 / 0.2) ** 2))
    assert vectors.s2 == pytest.approx(1.5 * 3.0 / (1.0 + (0.05 / 0.1) ** 2))
    known = aided_vectors(reference, state, True, 1.5)
    assert known.v1_frd == pytest.approx(rotate_inverse(q, reference.magnetic_ned))


@pytest.mark.parametrize(("sigma_rad", "is_lost"), [(0.34, False), (0.36, True)])
def test_an_aided_vertical_is_lost_against_twice_the_unaided_sigma(sigma_rad, is_lost):
    seen = UNSEEN._replace(sigma_inclination_rad=0.05)
    state = STATE._replace(sigma=Sigmas(sigma_rad, 0.1))
    assert is_worse(state, seen) is is_lost
