"""What contradicts an aided attitude: measured vectors, and turns that no gyroscope has felt."""

from math import degrees, e, hypot, radians, sin, sqrt

import numpy as np
import pytest

from estimator.aiding import types
from estimator.aiding.beginning import Start, begin, blank_aiding
from estimator.aiding.consistency import NEW_CONSISTENCY, compare, compare_report, inflated, watch
from estimator.aiding.correction_cusum import add_correction, known, pass_time
from estimator.aiding.uncertainty import with_dip_error
from estimator.conditioning.field.magnetic import FieldLook
from estimator.conditioning.vertical.tilt import LEAST_OFF_RAD
from estimator.estimator import Estimator
from estimator.geometry.quaternion import exp, multiply, rotate_inverse
from estimator.profile import load_profile, merge_profile
from estimator.types import NO_SAMPLE, STANDARD_GRAVITY_M_S2, ZERO_VEC3
from tests.flight import HEADING, TRUE_NORTH, banked_flight, changed, errors_deg, flown, north_known

PARAMS = types.AidingParams()
DT = 0.02
REPORT_EVERY = 5  # samples
EARTH_GAUSS = (0.22, 0.0, 0.42)
IRON_GAUSS = (0.05, -0.03, 0.02)
TRUTH = exp((0.3, -0.2, 2.0))
SIGMAS = types.Sigmas(inclination_rad=radians(0.2), heading_rad=radians(0.3))
PUSHED_M_S2 = 2.0
CERTAIN = np.zeros((types.SIZE, types.SIZE))


def aided(q_ned_frd):
    """An aiding that knows everything but, perhaps, the attitude."""
    state, _, _ = begin(PARAMS, Start(q_ned_frd, 0.0), NO_SAMPLE, types.NO_REPORT)
    estimate = state.estimate._replace(
        hard_iron_gauss=IRON_GAUSS,
        earth_gauss=EARTH_GAUSS,
        imu_lag_s=0.0,
        receiver_lag_s=0.0,
        field_lag_s=0.0,
    )
    return state._replace(estimate=estimate, last=state.last._replace(rate_rad_s=ZERO_VEC3))


def watched(state, *, seconds=12.0, with_mag=True, silent_from=1e9, receiver=False):
    """A consistency check of a vehicle, held at ``TRUTH``, pushed to and fro."""
    consistency, velocity = NEW_CONSISTENCY, np.zeros(3)
    mag = np.array(rotate_inverse(TRUTH, EARTH_GAUSS)) + IRON_GAUSS
    for k in range(round(seconds / DT)):
        push = PUSHED_M_S2 * np.array([sin(0.9 * k * DT), sin(0.4 * k * DT), 0.0])
        force = push - (0.0, 0.0, STANDARD_GRAVITY_M_S2)
        velocity += push * DT
        sample = NO_SAMPLE._replace(
            acc_m_s2=rotate_inverse(TRUTH, tuple(force)), mag=tuple(mag), has_mag=with_mag, dt_s=DT
        )
        report = types.NO_REPORT
        if k % REPORT_EVERY == 0 and k * DT < silent_from:
            late_sigma_s = 0.1 * receiver
            report = types.Report(True, tuple(velocity), not receiver, 0.3, 0.0, late_sigma_s)
        consistency = watch(PARAMS, consistency, state, CERTAIN, sample, report)
        consistency = compare(consistency, state.estimate.q_ned_frd, DT, 0.3)
    return consistency


@pytest.mark.parametrize("receiver", [False, True])
@pytest.mark.parametrize(
    # e is sin^2 of half of 5 deg, and less for a heading, which a field that dips hardly shows
    ("turn_deg", "measured_e"),
    [((4.0, -3.0, 0.0), 0.0016), ((0.0, 0.0, 8.0), 0.00059)],
)
def test_a_turned_attitude_is_inflated_by_as_much(receiver, turn_deg, measured_e):
    """R_true = exp(turn) R: the mean turn is the one that is missing, sigma about twice that."""
    wrong = multiply(exp(tuple(-radians(a) for a in turn_deg)), TRUTH)
    consistency = watched(aided(wrong), receiver=receiver)
    found = np.degrees(consistency.tilt.mean_rad[:2])
    # pushes of 2 m/s^2 let a heading of 8 deg show as 1.5 deg of tilt
    assert np.abs(found - turn_deg[:2]).max() < 1.6
    angle = np.linalg.norm(turn_deg)
    sigma = inflated(SIGMAS, consistency)
    widened = sigma.heading_rad if turn_deg[2] else sigma.inclination_rad
    assert degrees(widened) == pytest.approx(1.8 * angle, rel=0.2)
    assert consistency.error == pytest.approx(measured_e, rel=0.2)


def test_without_reports_and_field_nothing_is_inflated():
    wrong = multiply(exp((radians(10.0), 0.0, 0.0)), TRUTH)
    consistency = watched(aided(wrong), seconds=30.0, with_mag=False, silent_from=6.0)
    assert consistency.error == 0.0
    assert inflated(SIGMAS, consistency) == pytest.approx(SIGMAS)


def test_an_autopilots_filter_counts_only_while_there_is_no_receiver():
    state = aided(TRUTH)
    by_receiver = types.Report(True, ZERO_VEC3, False, 0.3, 0.0, 0.1)
    by_filter = by_receiver._replace(late_sigma_s=0.0)

    def after(consistency, report):
        return compare_report(PARAMS, consistency, state, CERTAIN, report)

    assert not (consistency := after(NEW_CONSISTENCY, by_filter)).by_receiver
    assert (consistency := after(consistency, by_receiver)).by_receiver
    assert after(consistency, by_filter) is consistency
    assert not after(consistency._replace(report_wait_s=4.0), by_filter).by_receiver


def test_what_is_usual_is_learnt_slowly():
    """A fault of 10 deg for 12 s is not usual: it counts for twice what was so before."""
    wrong = multiply(exp((radians(10.0), 0.0, 0.0)), TRUTH)
    consistency = watched(aided(wrong))
    assert consistency.tilt.mean_square**0.5 == pytest.approx(LEAST_OFF_RAD * 1.15, rel=0.1)


def test_a_step_of_the_gyroscopes_bias_widens_sigma():

    def step(sample, _):
        off = 0.02 * (sample.time_us > 30e6)
        return sample._replace(gyr_rad_s=tuple(w + off for w in sample.gyr_rad_s))

    flight, certain = changed(banked_flight(), step), []
    one = Estimator(merge_profile(load_profile("imu"), TRUE_NORTH))
    attitudes = flown(
        one, flight, after=lambda _: certain.append(one.snapshot.core.aided.sigma.heading_rad)
    )
    times_s = np.array([s.time_us for s in flight.samples]) * 1e-6
    heading = np.radians(errors_deg(flight, attitudes)[:, HEADING])
    sigma = np.array([a.sigma_heading_rad for a in attitudes])
    e = np.array([a.error for a in attitudes])
    before, after = (times_s > 20.0) & (times_s < 30.0), (times_s > 32.0) & (times_s < 40.0)
    assert np.degrees(heading[after].max()) == pytest.approx(7.16, rel=0.2)
    assert np.mean((heading <= certain)[after]) == pytest.approx(0.298, rel=0.2)
    assert np.mean((heading <= sigma)[after]) == pytest.approx(0.519, rel=0.2)
    assert np.array_equal(sigma[before], np.array(certain)[before])
    assert np.median(e[before]) == pytest.approx(2.25e-6, rel=0.2)
    assert np.median(e[after]) == pytest.approx(4.07e-4, rel=0.2)


BLANK, _, _ = blank_aiding(PARAMS)
NOTHING = types.CorrectionCusum(ZERO_VEC3, ZERO_VEC3, 0.0, 0.0, 0.0)
KNOWN = np.zeros((types.SIZE, types.SIZE))
SIGMA = types.Sigmas(inclination_rad=0.01, heading_rad=0.02)
PLACE = (0.21, 0.01, 0.43)


def covariance(level, heading):
    P = np.zeros((types.SIZE, types.SIZE))
    P[types.TURN, types.TURN] = P[types.TURN + 1, types.TURN + 1] = 0.5 * level
    P[types.TURN + 2, types.TURN + 2] = heading
    return P


def test_a_bias_that_has_changed_turns_the_attitude_until_its_mean_has_followed():
    changed = BLANK.estimate._replace(gyr_bias_rad_s=(0.0, 0.0, 0.01))
    found, largest = NOTHING, 0.0
    for _ in range(3000):
        found = pass_time(PARAMS, found, changed, KNOWN, 0.1)
        largest = max(largest, abs(found.turn_rad[2]))
    assert largest == pytest.approx(0.01 * 30.0 / e, rel=0.01)
    assert abs(found.turn_rad[2]) < 0.02 * largest
    assert found.bias_rad_s[2] == pytest.approx(0.01, rel=1e-3)


def test_white_corrections_of_a_true_covariance_are_as_expected():
    """A Kalman filter of a walk: the sum's mean square is what is expected."""
    rng, found, ratios = np.random.default_rng(5), NOTHING, []
    true = estimate = 0.0
    variance, walk, noise = 0.01, 1e-5, 1e-3
    for _ in range(20_000):
        true, variance = true + sqrt(walk) * rng.standard_normal(), variance + walk
        gain = variance / (variance + noise)
        step = gain * (true + sqrt(noise) * rng.standard_normal() - estimate)
        before, variance = variance, (1.0 - gain) * variance
        estimate += step
        before, after = known(covariance(0.0, before)), known(covariance(0.0, variance))
        found = add_correction(
            pass_time(PARAMS, found, BLANK.estimate, KNOWN, 0.1), (0, 0, step), before, after
        )
        ratios.append(found.turn_rad[2] ** 2 / found.heading)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.25)
    assert np.mean(np.array(ratios) > 4.0) == pytest.approx(0.046, abs=0.03)


@pytest.mark.parametrize("dip_off_deg", [-25.0, 4.0, 20.0])
@pytest.mark.parametrize("strength", [1.0, 1.3])
def test_a_field_that_dips_otherwise_than_the_places_shows_a_tilted_vertical(dip_off_deg, strength):
    h, d = hypot(*PLACE[:2]), PLACE[2]
    turn = np.exp(1j * radians(dip_off_deg)) * complex(h, d) * strength
    look = FieldLook(horizontal=float(turn.real), down=float(turn.imag), confidence=0.0)
    P = np.zeros((types.SIZE, types.SIZE))
    P[types.HARD_IRON, types.HARD_IRON] = 0.01**2
    seen = BLANK.field._replace(look=look, samples=9.0)
    wide = with_dip_error(PARAMS, SIGMA, seen, PLACE, P)
    square = np.sin(radians(dip_off_deg)) ** 2 - radians(10.0) ** 2 - 9e-4 / (h * h + d * d)
    square = max(0.0, square) / (1.0 + ((strength - 1.0) / 0.1) ** 2) ** 2
    assert wide.inclination_rad == pytest.approx(hypot(0.01, sqrt(square)))
    assert wide.heading_rad == SIGMA.heading_rad
    assert with_dip_error(PARAMS, SIGMA, seen, ZERO_VEC3, P) == SIGMA


def test_an_accelerometer_that_steps_widens_sigma_within_a_second():
    first, last = 20_000_000, 40_000_000

    def step(sample, _):
        ax, ay, az = sample.acc_m_s2
        return sample._replace(acc_m_s2=(ax, ay + 3.0 * (first <= sample.time_us < last), az))

    attitudes = flown(north_known(), changed(banked_flight(bank_rad=0.0), step))
    beyond = [
        (abs(a.q_ned_frd[1]) * 2.0, a.sigma_inclination_rad)
        for a in attitudes
        if a.time_us >= first
    ]
    wrong, sigma = np.array(beyond).T
    assert wrong.max() < radians(2.0)
    assert np.mean(wrong > 3.0 * sigma) < 0.02
    at = {a.time_us: a for a in attitudes}
    assert at[first].sigma_inclination_rad < radians(1.0)
    assert at[first + 1_000_000].sigma_inclination_rad > radians(1.0)
