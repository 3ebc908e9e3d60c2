"""The attitude found anew by velocity and the place's field, after what no sensor has shown."""

from dataclasses import replace
from math import degrees, nan

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimator.aiding.phase import Phase
from estimator.aiding.search import EMPTY_SEARCH, Push, solve_with_field
from estimator.conditioning.field.magnetic import NORM_SCALE
from estimator.estimator import Estimator
from estimator.geometry.earth import field_at, in_ned
from estimator.geometry.quaternion import exp
from estimator.profile import load_profile
from estimator.types import STANDARD_GRAVITY_M_S2
from tests.flight import (
    TOTAL,
    ZURICH,
    banked_flight,
    calibrated,
    changed,
    errors_deg,
    everywhere,
    flown,
)

FIELD_NED_GAUSS = in_ned(field_at(*ZURICH))
SECOND = 50  # samples


@pytest.fixture(scope="module")
def flight():
    """Banked turns in Zurich's field."""
    return changed(banked_flight(40.0), everywhere(*FIELD_NED_GAUSS))


def flown_in_zurich(flight, turn=None, at=0):
    """Errors (N, 3), deg, and sigmas of inclination and heading (N, 2), deg.

    The sensors miss ``turn`` behind sample ``at``.
    """
    one = calibrated(load_profile("imu"))

    def after(k):
        if k == 0:
            one.set_position(*ZURICH)
        if k == at and turn is not None:
            one.turn(exp(turn))

    attitudes = flown(one, flight, after=after)
    sigmas = [(a.sigma_inclination_rad, a.sigma_heading_rad) for a in attitudes]
    return errors_deg(flight, attitudes), np.degrees(sigmas)


def with_hole(flight, at, seconds):
    """The flight without the samples and reports of a time behind sample ``at``."""
    behind = at + round(seconds * SECOND)
    kept = [k for k in range(len(flight.samples)) if not at < k <= behind]
    places = {k: place for place, k in enumerate(kept)}
    return replace(
        flight,
        samples=[flight.samples[k] for k in kept],
        truth=[flight.truth[k] for k in kept],
        reports=[(places[k], report) for k, report in flight.reports if k in places],
    )


@pytest.mark.parametrize("at", [20 * SECOND, 24 * SECOND])
@pytest.mark.parametrize(
    "turn", [(1.1, 0, 0), (0, 1.1, 0), (0, 0, 1.1), (0.7, 0.7, -0.5), (3.0, 0, 0)]
)
def test_an_unsensed_turn_in_a_banked_turn_is_found_within_two_seconds(flight, turn, at):
    errors, sigmas = flown_in_zurich(flight, turn, at)
    assert errors[at + 1, TOTAL] > 60.0
    late = slice(at + 2 * SECOND, None)
    assert errors[late, TOTAL].max() < 3.0
    assert np.mean(errors[late, 1] <= sigmas[late, 1]) > 0.68
    assert sigmas[late].max() < 3.0  # nothing of the former attitude is left in it


@pytest.mark.parametrize(("at", "seconds"), [(830, 1.5), (830, 2.5), (830, 3.4), (800, 5.0)])
def test_what_a_hole_has_hidden_is_found_a_second_behind_it(flight, at, seconds):
    errors, _ = flown_in_zurich(with_hole(flight, at, seconds))
    assert errors[at + 1, TOTAL] > 60.0
    assert errors[at + round(1.8 * SECOND) :, TOTAL].max() < 2.0


def test_the_filter_is_moved_to_an_aided_attitude_that_is_right(flight):
    errors, _ = flown_in_zurich(with_hole(flight, 870, 2.8))
    assert errors[871, TOTAL] > 50.0
    assert errors[871 + 4 * SECOND :, TOTAL].max() < 5.0  # by itself it takes longer


def test_a_compass_that_nobody_vouches_for_shows_no_attitude_with_velocity(flight):
    one, phases = Estimator(load_profile("imu")), []

    def after(k):
        if k == 0:
            one.set_position(*ZURICH)
        phases.append(one.snapshot.context.phase)

    flown(one, replace(flight, samples=flight.samples[: 2 * SECOND]), after=after)
    assert Phase.AIDED not in phases


def test_a_hole_that_hides_nothing_changes_nothing(flight):
    errors, sigmas = flown_in_zurich(with_hole(flight, 1040, 1.5))
    assert errors[1040:, TOTAL].max() < 1.0
    assert sigmas[1040 + 2 * SECOND :].max() < 3.0


def test_a_compass_that_is_turned_in_flight_does_not_take_the_heading_along(flight):
    """Force and velocity agree with the attitude, so that nothing has turned unsensed."""
    begin_us = flight.samples[20 * SECOND].time_us

    def turned(sample, _):
        x, y, z = sample.mag_gauss
        return sample._replace(mag_gauss=(-x, -y, z)) if sample.time_us > begin_us else sample

    errors, _ = flown_in_zurich(changed(flight, turned))
    assert errors[20 * SECOND :, TOTAL].max() < 3.0


TOO_STEEP = Rotation.from_rotvec([0.0, 1.2 * NORM_SCALE, 0.0])
PUSH_NED = np.array((3.0, -1.0, -STANDARD_GRAVITY_M_S2))


def evidence_of(g_ned, push_ned=PUSH_NED):
    """A window of a push, as seen in G, which a rotation takes to NED."""
    push = Push(tuple(PUSH_NED.tolist()), tuple(g_ned.inv().apply(push_ned).tolist()))
    return EMPTY_SEARCH.evidence._replace(windows=1.0, latest=push)


@pytest.mark.parametrize("seed", range(4))
def test_one_window_with_the_field_is_scipys_solution(seed):
    rng = np.random.default_rng(seed)
    g_ned = Rotation.random(random_state=seed)
    push = PUSH_NED + 0.1 * rng.standard_normal(3)
    field = g_ned.inv().apply(FIELD_NED_GAUSS) + 0.02 * rng.standard_normal(3)
    evidence = evidence_of(g_ned, push)
    found = solve_with_field(evidence, 0.1, FIELD_NED_GAUSS, tuple(field.tolist()), 0.05)
    seen = [evidence.latest.force_g_m_s, field / np.linalg.norm(field)]
    wanted = [PUSH_NED, FIELD_NED_GAUSS / np.linalg.norm(FIELD_NED_GAUSS)]
    expected, _ = Rotation.align_vectors(wanted, seen, weights=[1.0, 4.0])
    w, x, y, z = found.q_ned_g
    assert (Rotation.from_quat((x, y, z, w)) * expected.inv()).magnitude() < 1e-9
    error = degrees((Rotation.from_quat((x, y, z, w)) * g_ned.inv()).magnitude())
    assert error < 2.0 * degrees(np.hypot(found.sigma_tilt_rad, found.sigma_heading_rad))


@pytest.mark.parametrize(
    ("push", "place", "field"),
    [
        (1.2 * PUSH_NED, FIELD_NED_GAUSS, FIELD_NED_GAUSS),  # too large
        (PUSH_NED, FIELD_NED_GAUSS, TOO_STEEP.apply(FIELD_NED_GAUSS)),
        (PUSH_NED, -PUSH_NED, -PUSH_NED),  # nothing shows the turn about it
        (nan * PUSH_NED, FIELD_NED_GAUSS, FIELD_NED_GAUSS),
    ],
)
def test_a_push_and_a_field_that_do_not_fit_together_show_nothing(push, place, field):
    g_ned = Rotation.random(random_state=1)
    evidence, seen = evidence_of(g_ned, push), g_ned.inv().apply(field)
    assert solve_with_field(evidence, 0.1, tuple(place), tuple(seen.tolist()), 0.1) is None
