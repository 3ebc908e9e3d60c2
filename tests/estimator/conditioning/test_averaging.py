"""How long gravity is averaged."""

from math import radians

import numpy as np
import pytest

from estimator.conditioning import ConditioningParams, initial_state
from estimator.conditioning.vertical.averaging import (
    LEAST_FACTOR,
    MOST_FACTOR,
    Averaging,
    follow_averaging,
    tilting,
)
from estimator.conditioning.vertical.gravity import Force
from estimator.conditioning.vertical.lowpass import Smooth
from estimator.conditioning.vertical.spin import Spin
from estimator.geometry.quaternion import angle_between_vectors

PARAMS = ConditioningParams()
KNOWN_BIAS = initial_state(PARAMS).vertical.estimate._replace(covariance=(0.0,) * 10)
UNKNOWN_BIAS = initial_state(PARAMS).vertical.estimate
STILL = (0.0, 0.0, 0.0)


def force(tilt_deg):
    a = radians(tilt_deg)
    quick = (9.8 * np.sin(a), 0.0, 9.8 * np.cos(a))
    return Force(down=Smooth((0.0, 0.0, 9.8), STILL), quick=quick, unsteady=0.0, age_s=60.0)


def factor_after(
    shaking_deg, turning_deg_s, *, estimate=KNOWN_BIAS, missed=0.0, learns=True, time_s=120.0
):
    state = Averaging()
    spin = Spin()._replace(turn=Smooth((0.0, radians(turning_deg_s), 0.0), STILL))
    for _ in range(round(time_s / 0.1)):
        state = follow_averaging(
            PARAMS, state, force(shaking_deg), spin, estimate, missed, learns, 0.1
        )
    return state.factor


def test_a_carried_vehicle_averages_longer_and_one_that_turns_shorter():
    assert factor_after(3.0, 2.0) == MOST_FACTOR
    assert factor_after(0.5, 50.0) == LEAST_FACTOR
    assert factor_after(3.0, 75.0) == pytest.approx(1.0, rel=0.06)  # 3/75 s asks for the usual


def test_little_is_known_at_first_and_nothing_where_nothing_can_be_learnt():
    assert factor_after(3.0, 2.0, time_s=1.0) < 1.1
    assert factor_after(0.0, 0.0, learns=False) == 1.0


def test_an_unknown_bias_drifts_as_a_turn_does():
    assert factor_after(3.0, 2.0, estimate=UNKNOWN_BIAS) < 1.0


def test_a_turn_beyond_the_gyroscopes_end_drifts_likewise():
    """A tenth of a degree a step of 0.1 s."""
    assert factor_after(3.0, 2.0, missed=radians(0.1) ** 2) == LEAST_FACTOR


@pytest.mark.parametrize("tilt_deg", [0.0, 1.0, 8.0])
def test_tilting_is_the_angle_for_small_ones(tilt_deg):
    down, quick = force(tilt_deg).down.value, force(tilt_deg).quick
    expected = angle_between_vectors(down, quick)
    assert tilting(force(tilt_deg)) ** 0.5 == pytest.approx(expected, rel=0.01, abs=1e-9)


def test_it_may_be_switched_off():
    params = PARAMS._replace(use_averaging=False)
    usual = Averaging()
    state = follow_averaging(params, usual, force(9.0), Spin(), KNOWN_BIAS, 0.0, True, 1.0)
    assert state is usual
