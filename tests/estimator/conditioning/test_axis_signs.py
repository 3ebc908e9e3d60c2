"""A gyroscope's axis that is at fault, against formulas and on a body whose truth is known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimator.conditioning.events.axis_signs import (
    AxisSigns,
    Seen,
    Suspect,
    carry_axes,
    current_errors,
    judge,
    watch_axes,
)
from estimator.conditioning.events.jump_signs import JumpSigns
from estimator.conditioning.gather import Gathered
from estimator.conditioning.params import FAR, LONG_S, SPAN_S
from estimator.conditioning.state import initial_state
from estimator.conditioning.vertical.gravity import Force, GravityState
from estimator.conditioning.vertical.lowpass import Coefficients, Smooth, approach
from estimator.conditioning.vertical.step import VerticalStep
from estimator.geometry.quaternion import conjugate, rotate, scale
from estimator.types import IDENTITY
from tests.estimator.conditioning.motion import PARAMS, turned

FIELD = (0.2, 0.05, 0.43)  # in the body
DT_S = 0.02
NO_ERROR = ZERO = (0.0, 0.0, 0.0)
AS_IT_IS = np.eye(3)
CLEAR = (Suspect(0.0, 0.0, 0.0, 0.0),) * 3  # no case against any axis


def step_of(q_g_frd, rate, bias=ZERO, down=(0.0, 0.0, 9.8), quick=(0.0, 0.0, 9.8)):
    state = initial_state(PARAMS).vertical
    force = Force(down=Smooth(down), quick=quick)
    state = state._replace(
        gravity=GravityState(force=force),
        estimate=state.estimate._replace(bias_rad_s=bias),
        coefficients=Coefficients(gravity_share=DT_S / PARAMS.gravity_tau_s),
    )
    return VerticalStep(state, Gathered(q_g_frd), rate, 0.0, 0.0)


def after(
    seconds,
    error,
    *,
    turning=ZERO,
    bias=ZERO,
    stretch=1.0,
    force_scatter=0.001,
    swing_rad_s=0.5,
    sensed=AS_IT_IS,
    leap_s=np.inf,
    before_s=10.0,
    noise=0.0,
):
    """The signs of a body that turns so (rad/s) by a gyroscope with this error of its axes.

    Before that it swings about x and y. The compass shows ``sensed`` times the field, from
    ``leap_s`` on if given, with ``noise`` as a share of it; the gyroscope has a tenth of that.
    """
    rng, slow_noise = np.random.default_rng(1), np.zeros(3)
    signs, q_true, q_g = AxisSigns(), IDENTITY, IDENTITY
    slow = quick = (0.0, 0.0, 9.8)
    for k in range(round((before_s + seconds) / DT_S)):
        is_wrong = k * DT_S >= before_s
        swing = 0.0 if is_wrong else swing_rad_s * np.sin(k * DT_S)
        true = np.add(turning, (swing, 0.7 * swing, 0.0))
        rate = tuple(true + 0.1 * noise * rng.normal(size=3) + np.multiply(error, is_wrong))
        q_true, q_g = turned(q_true, tuple(true), DT_S), turned(q_g, rate, DT_S)
        body = scale(stretch if is_wrong else 1.0, rotate(conjugate(q_true), FIELD))
        since_leap_s = k * DT_S - leap_s if np.isfinite(leap_s) else LONG_S
        body = tuple(sensed @ body) if since_leap_s >= 0.0 else body
        slow_noise = 0.99 * slow_noise + 0.14 * 0.48 * noise * rng.normal(size=3)
        field_g = rotate(q_g, tuple(body + slow_noise + 0.16 * noise * rng.normal(size=3)))
        jump = JumpSigns(
            quick=field_g,
            quick_norm=float(np.linalg.norm(field_g)),
            since_leap_s=since_leap_s if since_leap_s >= 0.0 else LONG_S,
        )
        force = rotate(q_g, rotate(conjugate(q_true), (0.0, 0.0, 9.8)))
        slow = approach(slow, force, DT_S / PARAMS.gravity_tau_s)
        quick = approach(quick, force, DT_S / SPAN_S)
        step = step_of(q_g, rate, bias, slow, quick)
        signs = carry_axes(signs, step, DT_S)
        signs = watch_axes(signs, step, jump, 0.477, force_scatter, DT_S)
    return signs


@pytest.mark.parametrize("axis", range(3))
def test_an_axis_with_an_offset_is_contradicted_within_a_second(axis):
    """About x and z the field turns alike here: the force separates them a second later."""
    error = tuple((0.2 * np.eye(3)[axis]).tolist())
    assert after(0.1, error).squares == (0.0, 0.0, 0.0)
    assert 0.04 < np.sqrt(after(1.0, error).squares[axis]) < 0.12
    assert np.sqrt(after(3.0, error).squares[axis]) == pytest.approx(0.17, rel=0.2)
    for seconds in (1.0, 3.0):
        averaged = 0.2 * (1.0 - np.exp(-seconds / SPAN_S))
        assert after(seconds, error).errors[axis] == pytest.approx(averaged, rel=0.05)
        opposite = after(seconds, scale(-1.0, error)).errors[axis]
        assert opposite == pytest.approx(-averaged, rel=0.05)


X_OFF, ABOUT_Z = (0.2, 0.0, 0.0), {"turning": (0.0, 0.0, 0.7)}
# Iron that has come would pass for a gyroscope at fault, at the leap and in later turns.
IRON = {"sensed": Rotation.from_rotvec((0.3, 0.6, 0.0)).as_matrix()}
# A body that has never turned has not shown how its compass stands: the force does.
STILL = {"swing_rad_s": 0.0}
# A magnet that turns the field by 0.2 rad changes its norm by a third here; the force is wild.
WILD = {"force_scatter": 1.0}


def turned_compass(angle_rad):
    """Its field goes along with tilts, as that by a gyroscope at fault does."""
    sensed = Rotation.from_rotvec((0.0, 0.0, angle_rad)).as_matrix()
    return {"turning": (0.4, -0.2, 0.1), "sensed": sensed}


@pytest.mark.parametrize(
    ("seconds", "error", "body", "is_contradicted"),
    [
        (5.0, NO_ERROR, {"turning": (0.5, -0.3, 1.2)}, False),
        (5.0, NO_ERROR, {}, False),
        *((9.0, NO_ERROR, turned_compass(angle), False) for angle in (0.3, np.pi / 2, np.pi)),
        (3.0, NO_ERROR, {**IRON, "leap_s": 10.0}, False),
        (3.0, NO_ERROR, {**IRON, **ABOUT_Z, "leap_s": 10.0}, False),
        (1.0, NO_ERROR, {**IRON, **ABOUT_Z}, False),
        (3.0, X_OFF, STILL, True),
        (3.0, X_OFF, {**STILL, **WILD}, False),
        # G, carried without a bias that is none, drifts against it: not along with it
        (3.0, X_OFF, {"bias": (-0.25, 0.0, 0.0)}, False),
        (3.0, X_OFF, {"bias": (0.25, 0.0, 0.0)}, True),
        (3.0, X_OFF, {**WILD, "stretch": 1.35}, False),
        (3.0, X_OFF, WILD, True),
    ],
)
def test_what_contradicts_an_axis(seconds, error, body, is_contradicted):
    squares = after(seconds, error, **body).squares
    assert squares[0] > 0.0 if is_contradicted else squares == (0.0, 0.0, 0.0)


def test_a_noisy_field_at_rest_does_not_hide_a_fault():
    """Its noise goes along with no turn, and what moved it long ago is forgotten."""
    for before_s in (20.0, 200.0):
        found = after(4.0, (0.0, 0.0, 0.3), swing_rad_s=0.0, before_s=before_s, noise=0.01)
        assert np.sqrt(found.squares[2]) > 0.05


def test_what_a_field_at_rest_does_is_no_more_than_going_along_with_all():
    """By noise alone it would: a compass that stands turned goes along by twice a turn at most."""
    rested = after(0.1, NO_ERROR, swing_rad_s=0.0, before_s=200.0, noise=0.02)
    assert 0.0 < rested.moves <= 4.0 * rested.turns
    silent = judge(AxisSigns(moves=0.0, turns=0.0), Seen(FIELD, ZERO, 0.0, 1e-4, 1e-4), CLEAR, DT_S)
    assert silent.turns > 0.0  # hours at rest with rates of exactly zero


def test_what_nothing_renews_is_forgotten():
    before = AxisSigns(squares=(0.04, 0.0, 0.01), errors=(0.2, 0.0, -0.1))
    now = before
    for _ in range(500):
        now = carry_axes(now, step_of(IDENTITY, ZERO), DT_S)
    assert now.squares == pytest.approx(scale(np.exp(-1.0), before.squares), rel=1e-2)
    assert now.errors == pytest.approx(scale(np.exp(-1.0), before.errors), rel=1e-2)


NONE = Suspect(0.3, 0.0, 1.0, 1.0)
STRONG = Suspect(0.3, 0.0, 60.0, 60.0)


def judged(*suspects):
    """The signs after a step of a minute's flight with these cases against its axes."""
    field = Seen((1.0, 0.0, 0.0), (0.01, 0.0, 0.0), 1e-4, 1e-4, 1e-4)
    return judge(AxisSigns(age_s=60.0), field, suspects, DT_S)


def test_a_case_much_weaker_than_another_is_dropped():
    signs = judged(STRONG, Suspect(0.3, 0.0, 43.0, 43.0), NONE)
    assert signs.squares == pytest.approx((0.09 * 0.02 / 1.02, 0.0, 0.0))
    assert signs.errors == pytest.approx((0.3, 0.3 * np.exp(-8.5), 0.0), abs=1e-9)
    assert judged(STRONG, STRONG._replace(ratio=45.0), NONE).squares[1] > 0.0
    by_magnet, beneath = STRONG._replace(by_force=-1.1), STRONG._replace(ratio=0.99 * FAR)
    for no_case in (by_magnet, beneath):
        assert judged(no_case, NONE, NONE).squares == (0.0, 0.0, 0.0)


def test_a_turn_that_a_field_may_go_along_with_is_an_error_only_beside_a_proven_compass():
    may_go_along, proven = Suspect(0.3, 0.0, 1.0, 60.0), Suspect(0.2, 0.0, 60.0, 60.0)
    signs = judged(may_go_along, NONE, NONE)
    assert signs.squares == NO_ERROR
    assert current_errors(signs, is_proven=False) == NO_ERROR
    assert current_errors(signs, is_proven=True) == pytest.approx((0.3, 0.0, 0.0), abs=1e-9)
    both = judged(may_go_along, proven, NONE)
    assert current_errors(both, is_proven=False) == pytest.approx((0.0, 0.2, 0.0), abs=1e-9)
    assert current_errors(both, is_proven=True) == pytest.approx((0.3, 0.2, 0.0), abs=1e-9)
