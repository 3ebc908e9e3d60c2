"""The attitude found anew by velocity and the place's field, after what no sensor has shown."""

from dataclasses import replace
from math import degrees, nan

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimator.aiding.phase import Phase
from estimator.aiding.push_and_field import PushAndField, misfits, solve_with_field
from estimator.aiding.search import Push
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


def with_hole(flight, at, seconds, step=1):
    """The flight without a time behind sample ``at``; of the others each ``step``-th is left."""
    behind = at + round(seconds * SECOND)
    kept = [k for k in range(0, len(flight.samples), step) if not at < k <= behind]
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


HOLES = [(830, 1.5), (830, 2.5), (830, 3.4), (800, 5.0), (870, 2.8), (950, 4.0), (760, 3.0)]


@pytest.mark.parametrize(("at", "seconds"), HOLES)
def test_what_a_hole_has_hidden_is_found_by_the_first_reports_behind_it(flight, at, seconds):
    errors, sigmas = flown_in_zurich(with_hole(flight, at, seconds))
    assert errors[at + 1, TOTAL] > 50.0
    late = slice(at + 11, None)  # at the third report
    assert errors[late, TOTAL].max() < 1.5
    soon = slice(at + 11, at + 11 + SECOND)
    assert np.mean(errors[soon, 1:] <= sigmas[soon, ::-1]) > 0.68


@pytest.mark.parametrize(("step", "most_deg"), [(2, 2.0), (3, 2.0), (5, 8.0)])
@pytest.mark.parametrize(("at", "seconds"), HOLES)
def test_so_it_is_in_slower_streams_within_a_second(flight, at, seconds, step, most_deg):
    """At 25, 17 and 10 Hz, with 5, 3 and 10 reports a second."""
    errors, _ = flown_in_zurich(with_hole(flight, at, seconds, step))
    behind = at // step + 1
    assert errors[behind, TOTAL] > 40.0
    assert errors[behind + SECOND // step :, TOTAL].max() < most_deg


def test_a_push_of_two_sources_is_not_one_of_their_first_reports(flight):
    """The receiver is 0.4 m/s off the filter, as slow errors are: 22 deg of the push in 0.1 s."""
    holed, at = with_hole(flight, 830, 1.5), 830

    def by_receiver(report):
        north, east, down = report.velocity_ned_m_s
        return report._replace(velocity_ned_m_s=(north + 0.4, east, down), late_sigma_s=0.02)

    reports = [
        (k, by_receiver(report) if (k // 5) % 2 and k > at else report)
        for k, report in holed.reports
    ]
    errors, _ = flown_in_zurich(replace(holed, reports=reports))
    assert errors[at + 1, TOTAL] > 50.0
    assert errors[at + 16 :, TOTAL].max() < 5.0


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


def seen_from(g_ned, push_ned=PUSH_NED, field_g=None, sigma_rad=0.05):
    """A push and a field, as seen in G, which a rotation takes to NED."""
    push = Push(tuple(PUSH_NED.tolist()), tuple(g_ned.inv().apply(push_ned).tolist()))
    field_g = g_ned.inv().apply(FIELD_NED_GAUSS) if field_g is None else field_g
    return PushAndField(push, 0.1, 0.0, FIELD_NED_GAUSS, tuple(field_g.tolist()), sigma_rad)


@pytest.mark.parametrize("seed", range(4))
def test_one_window_with_the_field_is_scipys_solution(seed):
    rng = np.random.default_rng(seed)
    g_ned = Rotation.random(random_state=seed)
    push = PUSH_NED + 0.1 * rng.standard_normal(3)
    field = g_ned.inv().apply(FIELD_NED_GAUSS) + 0.02 * rng.standard_normal(3)
    seen = seen_from(g_ned, push, field)
    found = solve_with_field(seen)
    vectors = [seen.push.force_g_m_s, field / np.linalg.norm(field)]
    wanted = [PUSH_NED, FIELD_NED_GAUSS / np.linalg.norm(FIELD_NED_GAUSS)]
    expected, _ = Rotation.align_vectors(wanted, vectors, weights=[1.0, 4.0])
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
    seen = seen_from(g_ned, push, g_ned.inv().apply(field), sigma_rad=0.1)
    assert solve_with_field(seen._replace(field_ned=tuple(place))) is None


def test_a_short_push_may_be_off_by_as_much_as_its_reports():
    """Of 1 m/s: by 0.2 m/s, and 13 degrees of the angle to the field."""
    g_ned = Rotation.random(random_state=3)
    short = 0.1 * PUSH_NED + (0.2, 0.0, 0.0)
    push = Push(tuple((0.1 * PUSH_NED).tolist()), tuple(g_ned.inv().apply(short).tolist()))
    seen = seen_from(g_ned)._replace(push=push)
    found = solve_with_field(seen)
    assert 0.05 < found.sigma_tilt_rad < 0.1 / np.linalg.norm(short)
    assert solve_with_field(seen._replace(change_sigma_m_s=0.01)) is None


def test_reports_of_an_unsure_age_show_an_attitude_as_unsure():
    """By as much as a push that began later turns it."""
    late_s, swing = 0.01, np.array((9.0, -4.0, 2.0))
    seen = seen_from(Rotation.random(random_state=4))
    push = seen.push._replace(swing_g_m_s2=tuple(swing.tolist()))
    found = solve_with_field(seen._replace(push=push))
    unsure = solve_with_field(seen._replace(push=push, late_sigma_s=late_s))
    force = np.array(push.force_g_m_s) + late_s * swing
    later = solve_with_field(seen._replace(push=push._replace(force_g_m_s=tuple(force.tolist()))))
    (w, x, y, z), (a, b, c, d) = found.q_ned_g, later.q_ned_g
    moved = Rotation.from_quat((b, c, d, a)) * Rotation.from_quat((x, y, z, w)).inv()
    down_rad = np.sqrt(unsure.sigma_heading_rad**2 - found.sigma_heading_rad**2)
    assert down_rad == pytest.approx(abs(moved.as_rotvec()[2]), rel=0.1)


@pytest.mark.parametrize("axis", [PUSH_NED, np.array(FIELD_NED_GAUSS)])
def test_a_turn_about_one_of_the_two_misfits_the_other(axis):
    g_ned = Rotation.random(random_state=2)
    seen = seen_from(g_ned)
    turned = Rotation.from_rotvec(0.3 * axis / np.linalg.norm(axis)) * g_ned
    x, y, z, w = turned.as_quat()
    push, field = PUSH_NED, np.array(FIELD_NED_GAUSS)
    other, sigma_rad = (field, 0.05) if axis is PUSH_NED else (push, 0.1 / np.linalg.norm(push))
    moved = turned * g_ned.inv()
    cosine = other @ moved.apply(other) / (other @ other)
    by_push, by_field = misfits(seen, (w, x, y, z))
    of_it, of_other = (by_push, by_field) if axis is PUSH_NED else (by_field, by_push)
    assert of_it == pytest.approx(0.0, abs=1e-4)
    assert of_other == pytest.approx(np.arccos(cosine) / sigma_rad)
