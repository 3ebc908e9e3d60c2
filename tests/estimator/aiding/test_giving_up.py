"""The better known attitude counts once measurements contradict the aided one for long."""

from math import atan, degrees, nan, pi, radians, tan

import numpy as np
import pytest

from estimator.aiding import types
from estimator.aiding.beginning import blank_aiding, inflate_covariance
from estimator.aiding.phase import Phase
from estimator.conditioning.params import FAR
from estimator.geometry import quaternion as qn
from estimator.geometry.metrics import angle_errors
from estimator.live.aiding_span import give_up
from estimator.live.core import UNSEEN
from estimator.live.starts import is_better, start_level
from estimator.live.state import State
from estimator.profile import load_profile
from estimator.types import DOWN, NO_SAMPLE, ZERO_VEC3
from tests.truth.faults import Fault
from tests.truth.run import Case, judge

BLANK, BLANK_P, _ = blank_aiding(types.AidingParams())


def test_an_inflated_attitude_is_four_times_as_uncertain_and_its_times_begin_anew():
    state = BLANK
    root = 0.01 * np.random.default_rng(1).standard_normal((types.SIZE, types.SIZE))
    P = root @ root.T
    late = types.Agreements(*(each._replace(far_off_s=2.0) for each in state.agreement))
    state = state._replace(
        agreement=late, field=state.field._replace(far_off_s=5.0), sigma=types.Sigmas(0.01, 0.02)
    )
    after, loose = inflate_covariance(state, P)
    turn, other = slice(types.TURN, types.TURN + 3), slice(types.GYR_BIAS, types.SIZE)
    np.testing.assert_allclose(loose[turn, turn], FAR * P[turn, turn])
    np.testing.assert_array_equal(loose[turn, other], P[turn, other])
    np.testing.assert_array_equal(loose[other, other], P[other, other])
    np.testing.assert_array_equal(loose, loose.T)
    assert after.sigma == pytest.approx((0.04, 0.08))
    assert [each.far_off_s for each in after.agreement] == [0.0, 0.0]
    assert after.field.far_off_s == 0.0


def test_no_attitude_is_inflated_beyond_half_a_turn():
    state, P = BLANK, BLANK_P + np.eye(types.SIZE)
    for _ in range(9):
        state, P = inflate_covariance(state, P)
    assert P[types.TURN, types.TURN] == pytest.approx(pi**2)


def test_the_better_known_is_the_one_with_the_smaller_angle_in_all():
    steep, flat = types.Sigmas(radians(9.0), radians(2.0)), types.Sigmas(radians(5.0), radians(8.0))
    assert is_better(steep, flat)
    assert not is_better(flat, steep)
    assert not is_better(types.Sigmas(nan, 0.1), types.Sigmas(3.0, 3.0))


LEVEL = qn.exp((0.2, -0.1, 1.0))
FELT_AS_REPORTED = types.AccelerationTilt((2.0, 0.0, 0.0), ZERO_VEC3, (5.0, 0.0, 0.0))
UNREPORTED = types.AccelerationTilt(ZERO_VEC3, ZERO_VEC3, (5.0, 0.0, 0.0))


def lost(heading_deg, acceleration_tilt=UNREPORTED, off_deg=60.0):
    """An aided vertical at a sigma of 50 deg that nothing contradicts; the unaided one's is 6."""
    state = State(load_profile("imu"), None)
    aided, P, _ = blank_aiding(state.settings.aiding)
    q = qn.multiply(qn.exp((radians(off_deg), 0.0, 0.0)), LEVEL)
    aided = aided._replace(
        estimate=aided.estimate._replace(q_ned_frd=q),
        sigma=types.Sigmas(radians(50.0), radians(heading_deg)),
        acceleration_tilt=acceleration_tilt,
    )
    state.set_core(
        state.core._replace(
            aided=aided,
            covariance=P + 0.01 * np.eye(types.SIZE),
            sample=NO_SAMPLE._replace(dt_s=0.5),
            seen=UNSEEN._replace(
                gravity_b=qn.rotate_inverse(LEVEL, DOWN), sigma_inclination_rad=radians(6.0)
            ),
        )
    )
    state.change_context(phase=Phase.AIDED)
    return state


def test_of_a_lost_vertical_and_a_known_heading_the_heading_stays():
    """The heading's error of before is left, as :func:`angle_errors` splits it: none."""
    state = lost(heading_deg=10.0)
    give_up(state)
    assert state.context.phase is Phase.AIDED
    core = state.core
    q, P = core.aided.estimate.q_ned_frd, np.array(core.covariance).reshape(types.SIZE, types.SIZE)
    assert max(angle_errors(q, LEVEL)) < 1e-6
    assert max(angle_errors(core.filter.q_ned_frd, LEVEL)) < 1e-6
    assert qn.rotate(q, core.seen.gravity_b) == pytest.approx(DOWN)
    sigmas_deg = np.degrees(np.sqrt(P.diagonal()[types.TURN : types.TURN + 3]))
    off_deg = 2.0 * degrees(atan(radians(10.0) * tan(radians(30.0)) / radians(60.0)))
    assert sigmas_deg == pytest.approx((6.0, 6.0, off_deg))
    assert core.aided.estimate.velocity_ned_m_s == (5.0, 0.0, 0.0)


@pytest.mark.parametrize("off_deg", [60.0, 120.0, 150.0])
def test_the_heading_is_known_the_less_the_further_the_vertical_was_off(off_deg):
    """68 % of turns whose vertical part scatters by 10 deg leave a heading within that sigma."""
    rng = np.random.default_rng(5)
    core = lost(10.0, off_deg=off_deg).core
    q, within, start = core.aided.estimate.q_ned_frd, 0, start_level(core, radians(10.0))
    for down in radians(10.0) * rng.standard_normal(4000):
        truth = qn.multiply(qn.conjugate(qn.exp((radians(off_deg), 0.0, down))), q)
        level = qn.shortest_rotation(qn.rotate(q, qn.rotate_inverse(truth, DOWN)), DOWN)
        left = angle_errors(qn.multiply(level, q), truth).heading_rad
        within += left < start.heading_sigma_rad
    assert within / 4000 == pytest.approx(0.68, abs=0.03)


@pytest.mark.parametrize(("heading_deg", "off_deg"), [(46.0, 60.0), (20.0, 150.0)])
def test_a_heading_as_good_as_none_goes_with_the_vertical(heading_deg, off_deg):
    state = lost(heading_deg, off_deg=off_deg)
    give_up(state)
    assert state.context.phase is Phase.UNAIDED


def test_an_attitude_that_nothing_contradicts_is_not_inflated():
    """It explains the reports' acceleration. Inflating it repeatedly would lose its heading."""
    state = lost(heading_deg=10.0, acceleration_tilt=FELT_AS_REPORTED)
    before = state.core
    for _ in range(3):
        give_up(state)
    assert (state.context.phase, state.core) == (Phase.AIDED, before)


def test_one_that_is_contradicted_is():
    state = lost(heading_deg=10.0)
    core = state.core
    late = types.Agreements(*(each._replace(far_off_s=2.0) for each in core.aided.agreement))
    aided = core.aided._replace(agreement=late)
    state.set_core(core._replace(aided=aided, seen=core.seen._replace(sigma_inclination_rad=pi)))
    give_up(state)
    after = state.core
    assert state.context.phase is Phase.AIDED
    assert after.aided.sigma == pytest.approx((radians(200.0), radians(40.0)))
    assert after.covariance[0] == pytest.approx(FAR * core.covariance[0])


def test_velocities_that_turn_do_not_throw_a_well_known_attitude_away():
    v = judge(Case("climb and turn", Fault("velocity turned", 0, 90.0), True, 50.0))
    total = np.hypot(v.inclination.rms_deg, v.heading.rms_deg)
    assert total == pytest.approx(3.8, rel=0.2)
