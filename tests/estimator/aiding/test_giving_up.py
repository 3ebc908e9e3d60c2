"""What contradicts the aided attitude for long: the better known of the two attitudes counts."""

from math import nan, pi, radians

import numpy as np
import pytest

from estimator.aiding import AidingParams, blank_aiding
from estimator.aiding.beginning import loosen
from estimator.aiding.types import GYR_BIAS, SIZE, TURN, Agreements, Sigmas
from estimator.conditioning.robust import FAR
from estimator.live.aiding_span import is_better
from tests.truth.faults import Fault
from tests.truth.run import Case, judge


def test_a_doubted_attitude_is_four_times_as_uncertain_and_its_doubts_begin_anew():
    state, P, _ = blank_aiding(AidingParams())
    root = 0.01 * np.random.default_rng(1).standard_normal((SIZE, SIZE))
    P = root @ root.T
    late = Agreements(*(each._replace(doubt_s=2.0) for each in state.agreement))
    state = state._replace(
        agreement=late, field=state.field._replace(doubt_s=5.0), sigma=Sigmas(0.01, 0.02)
    )
    after, loose = loosen(state, P)
    turn, other = slice(TURN, TURN + 3), slice(GYR_BIAS, SIZE)
    np.testing.assert_allclose(loose[turn, turn], FAR * P[turn, turn])
    np.testing.assert_array_equal(loose[turn, other], P[turn, other])
    np.testing.assert_array_equal(loose[other, other], P[other, other])
    np.testing.assert_array_equal(loose, loose.T)
    assert after.sigma == pytest.approx((0.04, 0.08))
    assert [each.doubt_s for each in after.agreement] == [0.0, 0.0]
    assert after.field.doubt_s == 0.0


def test_no_attitude_is_loosened_beyond_half_a_turn():
    state, P, _ = blank_aiding(AidingParams())
    P = P + np.eye(SIZE)
    for _ in range(9):
        state, P = loosen(state, P)
    assert P[TURN, TURN] == pytest.approx(pi**2)


def test_the_better_known_is_the_one_with_the_smaller_angle_in_all():
    assert is_better(Sigmas(radians(9.0), radians(2.0)), Sigmas(radians(5.0), radians(8.0)))
    assert not is_better(Sigmas(radians(5.0), radians(8.0)), Sigmas(radians(9.0), radians(2.0)))
    assert not is_better(Sigmas(nan, 0.1), Sigmas(3.0, 3.0))


@pytest.mark.parametrize(
    ("motion", "rate_hz", "total_deg", "before_deg"),
    [("climb and turn", 50.0, 18.6, 59.0)],
)
def test_velocities_that_turn_do_not_throw_a_well_known_attitude_away(
    motion, rate_hz, total_deg, before_deg
):
    """Both sources by 90 deg from 40 s on. ``before_deg``: with the unaided attitude instead."""
    v = judge(Case(motion, Fault("velocity turned", 0, 90.0), True, rate_hz))
    total = np.hypot(v.inclination.rms_deg, v.heading.rms_deg)
    assert total == pytest.approx(total_deg, rel=0.2)
    assert total < 0.5 * before_deg
