"""The signs of an unsensed turn and the confidence of a field, each by its formula."""

from math import cos, exp, radians, sin, sqrt

import numpy as np
import pytest

from estimator.conditioning.events.jump_signs import (
    JUMP_QUICK_S,
    JUMP_SHARE,
    JumpSigns,
    jump_variance,
)
from estimator.conditioning.events.step import (
    EventsState,
    HeadingInflation,
    proof_of,
    release_inflation,
    with_field_turned,
)
from estimator.conditioning.events.turn_signs import (
    SPAN_LEAD,
    GravitySigns,
    HeadingSigns,
    confirmed_time_s,
    watch_gravity,
    watch_heading,
)
from estimator.conditioning.field.calibration import Calibration
from estimator.conditioning.field.magnetic import (
    DIP_SCALE_RAD,
    NORM_SCALE,
    FieldLook,
    FieldReference,
    MagneticState,
    look_at_field,
    observe_field,
    steepness,
)
from estimator.conditioning.params import CONFIRM_S, QUICK_S, SPAN_S
from estimator.conditioning.state import initial_state
from estimator.conditioning.vertical.bias import Estimate
from estimator.conditioning.vertical.gravity import Force
from estimator.conditioning.vertical.lowpass import Smooth, low_pass
from tests.estimator.conditioning.motion import PARAMS, smooth_scalar

ZERO = (0.0, 0.0, 0.0)
DT = 0.04
JUMP = JumpSigns(
    quick=(0.20, 0.03, 0.40),
    slow=(0.21, -0.01, 0.41),
    quick_norm=0.448,
    slow_norm=0.461,
    stretched=0.0007,
    usual=0.0004,
    usual_turning=0.09,
    turning=0.30,
    unseen=0.0003,
    seen_rad=0.02,
    age_s=5.0,
)


@pytest.mark.parametrize(
    ("own", "by_turning"),
    [
        # the lesser of two: what lag and own field make of the turning, or 16 times what is
        # usual, times how much more it turns than usually
        (0.2, 0.2 * (1e-4 + 0.25 * 38e-4) * 0.30),
        (100.0, 16.0 * 1e-5 * (0.30 - 0.09) / 0.09),
    ],
)
@pytest.mark.parametrize("share", [0.999, 1.001])
def test_a_jump_is_more_than_what_else_turns_the_field(own, by_turning, share):
    p = tuple(own * x for x in (4e-4, 0, 0, 0, 9e-4, 0, 0, 25e-4, 0, 1e-4))
    learnt = Calibration(0.01, (0.1, 0.0, 0.0), p, 0.5)
    least = PARAMS.turn_jump_rad**2 + 16.0 * (1e-5 + 2e-5 + 7e-5) + by_turning
    signs = JUMP._replace(usual=1e-5, unseen=2e-5, stretched=7e-5, apart_rad=share * sqrt(least))
    variance, seen_rad = jump_variance(PARAMS, signs, learnt)
    if share < 1.0:
        assert (variance, seen_rad) == (0.0, 0.02)
    else:
        assert variance == pytest.approx((signs.apart_rad**2 - 0.02**2) / JUMP_SHARE**2)
        assert seen_rad == signs.apart_rad
    counted = signs._replace(seen_rad=1.01 * signs.apart_rad)
    assert jump_variance(PARAMS, counted, learnt) == (0.0, counted.seen_rad)


ESTIMATE = Estimate(ZERO, 0.2, (1e-4, 0, 0, 0, 1e-4, 0, 0, 1e-4, 0, 0.03))


def release(
    *, moves_rad=0.01, usual_s=1.2, confidence=0.7, norm=0.46, variance=0.4, tilt=0.05, no_jump=0.0
):
    """The inflation after a step beside a field of dip 60 degrees that is off by 0.3 rad."""
    reference = FieldReference(horizontal=0.25, down=0.25 * sqrt(3.0), uneven=0.0001)
    field = MagneticState(FieldLook(0.25, 0.43, confidence), reference, 0.0)
    inflation = HeadingInflation(variance, usual_s, 0.461, 0.9, no_jump)
    jump = JUMP._replace(quick_norm=norm, moves_rad=moves_rad)
    return release_inflation(
        PARAMS, inflation, tilt, ESTIMATE, field, jump, (np.cos(0.3), np.sin(0.3)), DT
    )


@pytest.mark.parametrize("no_jump", [0.0, 0.02])  # by a gyroscope beyond its end, or by gravity
@pytest.mark.parametrize(
    ("field", "is_turn"),
    [
        ({}, True),
        ({"norm": 0.461 * 1.045}, False),  # of another norm: a magnet's
        ({"variance": 0.001}, False),  # 0.3 rad off, of which a jump shows little: a magnet's
    ],
)
def test_the_heading_is_inflated_once_the_field_looks_as_usual(field, is_turn, no_jump):
    inflation, tilt, estimate, released = release(**field, no_jump=no_jump)
    left = 0.05 if is_turn else no_jump
    assert (inflation.variance, tilt, released) == (0.0, left, is_turn)
    assert estimate.covariance[9] == (pytest.approx(0.03 + 0.4) if is_turn else 0.03)


@pytest.mark.parametrize(("horizontal", "least"), [(0.25, 0.12), (0.01, 0.03)])  # 60, 89 deg
def test_a_heading_is_no_surer_than_the_field_that_an_uncertain_vertical_turns(horizontal, least):
    reference = FieldReference(horizontal=horizontal, down=0.25 * sqrt(3.0))
    field = MagneticState(FieldLook(0.25, 0.43, 0.7), reference, 0.0)
    assert with_field_turned(ESTIMATE, 0.04, field).covariance[9] == pytest.approx(least)
    assert with_field_turned(ESTIMATE, 0.004, field) == ESTIMATE


def test_a_field_that_still_moves_or_is_another_keeps_the_inflation():
    moved = (0.06 / PARAMS.turn_jump_rad) ** 2
    # a vertical of that variance explains some of the dip
    explained = 0.5 * 0.002 / DIP_SCALE_RAD**2
    seldom = (0.01 / PARAMS.turn_jump_rad) ** 2 + sqrt(0.9 / 0.2) - 1.0 - explained
    for off, unlike in ((moved, {"moves_rad": 0.06}), (seldom, {"confidence": 0.2})):
        inflation, tilt, estimate, released = release(
            usual_s=0.7, tilt=0.002, **{"confidence": 0.95, **unlike}
        )
        assert inflation.usual_s == pytest.approx(0.7 + max(-1.0, 2.0 * (1.0 - off)) * DT)
        assert (inflation.variance, tilt, released) == (0.4, 0.002, False)
        assert estimate.covariance[9] == 0.03
    assert release(usual_s=0.7)[0].usual_s == pytest.approx(0.7 + DT)


SIGNS = HeadingSigns(
    mean_north=0.20,
    mean_east=0.05,
    mean_confidence=0.85,
    scatter=0.002,
    confirmed_s=2.0,
    other_rad=-0.5,
    other_s=20.0,
)


def heading_after(state, horizontal, *, confidence=0.9, variance=0.01, is_new=False):
    look = FieldLook(0.25, 0.4, confidence)
    field = MagneticState(look, FieldReference(0.25, 0.4, is_new=is_new), 0.0)
    estimate = Estimate(ZERO, 0.9, (0, 0, 0, 0, 0, 0, 0, 0, 0, variance))
    return watch_heading(PARAMS, state, estimate, field, horizontal, DT)


@pytest.mark.parametrize(("elsewhere", "sign"), [(0.0, 1.0), (0.5, 0.0), (1.0, -1.0)])
def test_a_field_counts_for_and_against_the_heading_by_how_usual_it_looks(elsewhere, sign):
    for confidence, counts in ((1.0, 1.0), (0.64, 0.75), (0.2, 0.0), (0.0, 0.0)):
        confirmed_s = confirmed_time_s(PARAMS, SIGNS, 0.5, elsewhere, confidence, DT)
        assert confirmed_s == pytest.approx(2.0 + sign * counts * DT)
    most = SIGNS._replace(confirmed_s=CONFIRM_S - 0.01)
    assert confirmed_time_s(PARAMS, most, 0.5, 0.0, 1.0, DT) == CONFIRM_S


@pytest.mark.parametrize(
    ("away_rad", "other_rad", "confidence", "back_s"),
    [
        (0.5, 0.4, 0.9, 0.1 + DT),  # it points to 0.4, which was given up
        (0.5, 0.13, 0.9, 0.0),  # nearly half as far from there as from the heading
        (0.15, 0.75, 0.9, 0.0),  # the heading is hardly off
        (0.5, 0.4, 0.2, 0.0),  # it does not look as usual
    ],
)
def test_a_field_that_is_back_is_not_one_that_is_elsewhere(away_rad, other_rad, confidence, back_s):
    state = SIGNS._replace(other_rad=other_rad, back_s=0.1)
    horizontal = (0.25 * np.cos(away_rad), 0.25 * np.sin(away_rad))
    now = heading_after(state, horizontal, confidence=confidence)
    assert now.back_s == pytest.approx(back_s)
    assert heading_after(state._replace(other_s=0.0), horizontal).back_s == 0.0


def test_gravity_that_pulls_elsewhere_is_timed():
    """By more than a radian, about any axis."""
    state = initial_state(PARAMS).vertical.gravity
    for off_deg, lasts in ((57.0, False), (58.0, True)):
        quick = (0.0, -9.8 * sin(radians(off_deg)), 9.8 * np.cos(radians(off_deg)))
        gravity = state._replace(force=Force(Smooth((0.0, 0.0, 9.8)), quick=quick, age_s=5.0))
        now = watch_gravity(PARAMS, GravitySigns(off_s=0.1), gravity, DT, 0.0, 0.0, True)
        assert now.off_s == pytest.approx(0.1 + DT if lasts else 0.0)


@pytest.mark.parametrize(
    ("off_deg", "size", "inflation", "has_field", "lasts"),
    [
        (14.0, 1.0, 0.0, False, True),
        (13.3, 1.0, 0.0, False, False),  # 2.5 times the usual 5 deg, and half of 10 deg: 13.5
        (14.0, 1.0, 0.001, False, False),  # a vertical that is uncertain by so much explains it
        (14.0, 1.0, 0.0, True, False),  # a field would show it sooner
        (45.0, 1.22, 0.0, False, True),  # an acceleration across: 1.41; halfway in squares: 1.225
        (45.0, 1.23, 0.0, False, False),
    ],
)
def test_without_a_field_the_force_shows_a_smaller_turn(off_deg, size, inflation, has_field, lasts):
    off = radians(off_deg)
    quick = (9.8 * size * sin(off), 0.0, 9.8 * size * cos(off))
    force = Force(Smooth((0.0, 0.0, 9.8)), quick=quick, age_s=5.0)
    gravity = initial_state(PARAMS).vertical.gravity._replace(force=force)
    before = GravitySigns(unusual_s=0.48, force_scatter=radians(5.0) ** 2)
    now = watch_gravity(PARAMS, before, gravity, DT, inflation, 0.0, has_field)
    assert now.unusual_s == pytest.approx(0.48 + DT if lasts else 0.0)
    assert now.turned == (pytest.approx((off / SPAN_LEAD) ** 2) if lasts else 0.0)
    explained = 2.5**2 * (radians(5.0) ** 2 + inflation)
    assert now.unusual == (0.0 if has_field else pytest.approx(max(0.0, off**2 - explained)))


def test_the_lead_of_a_second_s_force_is_the_largest_before_the_low_pass():
    k, quick, slow, lead = low_pass(PARAMS.gravity_tau_s, DT), 0.0, (0.0, 0.0), 0.0
    for _ in range(500):
        slow = smooth_scalar(k, *slow, 1.0)
        quick += (1.0 - exp(-DT / SPAN_S)) * (1.0 - quick)
        lead = max(lead, quick - slow[0])
    assert pytest.approx(lead, rel=1e-3) == SPAN_LEAD


def test_the_share_of_a_jump_is_the_largest_between_its_low_passes():
    since_s = np.linspace(0.0, 3.0, 100_001)
    between = np.exp(-since_s / QUICK_S) - np.exp(-since_s / JUMP_QUICK_S)
    assert pytest.approx(between.max(), rel=1e-6) == JUMP_SHARE


@pytest.mark.parametrize(
    ("confidence", "norm", "is_proof"),
    [(0.85, 0.448, True), (0.0, 0.448, False), (0.85, 0.9, False)],
)
def test_a_jump_of_a_field_that_is_seldom_the_place_s_or_of_another_norm_proves_nothing(
    confidence, norm, is_proof
):
    learnt = Calibration(0.0, ZERO, (0.0,) * 10, 0.5)
    signs = EventsState(
        heading=SIGNS._replace(mean_confidence=confidence),
        jump=JUMP._replace(apart_rad=1.0, quick_norm=norm, usual=1e-5),
    )
    proof = proof_of(PARAMS, signs, learnt, 0.45)
    assert (proof.jump > 0.0) is is_proof
    assert proof.seen_rad == 1.0


DIP = radians(60.0)
EXPECTED = (0.5 * cos(DIP), 0.5 * sin(DIP))
DIP_SCALE = radians(10.0)


def confidence_in(norm, dip, expected=EXPECTED):
    before = FieldLook(horizontal=0.0, down=0.0, confidence=1.0)
    seen = (norm * cos(dip), norm * sin(dip))
    return look_at_field(before, seen, 1.0, expected, NORM_SCALE, DIP_SCALE).confidence


def test_one_scale_off_leaves_a_quarter_of_the_confidence():
    """c = 1/(1 + D^2)^2 at D = 1. Of the dip the sine counts."""
    assert confidence_in(0.5, DIP) == pytest.approx(1.0)
    for sign in (1.0, -1.0):
        assert confidence_in(0.5 * (1.0 + sign * NORM_SCALE), DIP) == pytest.approx(0.25)
        assert confidence_in(0.5, DIP + sign * DIP_SCALE) == pytest.approx(0.25, abs=0.003)


@pytest.mark.parametrize("norm", [0.0, 0.5])
def test_nothing_resembles_the_reference_that_readings_of_zero_teach(norm):
    assert confidence_in(norm, DIP, (0.0, 0.0)) == 0.0


REFERENCE = FieldReference(horizontal=0.25, down=0.43, samples=20.0)


def test_steepness_is_the_squared_tangent_of_the_dip_and_bounded():
    assert steepness(REFERENCE) == pytest.approx((0.43 / 0.25) ** 2)
    assert steepness(FieldReference(0.0, -0.5)) == pytest.approx(1.0 / 0.1**2)
    assert steepness(FieldReference()) == 0.0


@pytest.mark.parametrize(("age_s", "count"), [(3.0, 1.0), (8.0, 2.0)])
def test_a_vertical_that_is_not_settled_teaches_by_the_square_of_it(age_s, count):
    """Later its readings count twice, until as many have counted as came."""
    look = FieldLook(horizontal=0.28, down=0.41, confidence=0.6)
    state = MagneticState(look, REFERENCE._replace(age_s=age_s), 0.3)
    after = observe_field(PARAMS, state, (0.28, 0.0, 0.41), 0.1, 0.5)
    assert after.reference.samples == pytest.approx(20.0 + count * 0.25)
    assert after.reference.age_s == pytest.approx(age_s + 0.1)
    learn = max(0.25 / after.reference.samples, 0.1 / 15.0 * after.look.confidence)
    assert after.reference.horizontal == pytest.approx(0.25 + learn * (0.28 - 0.25))
    assert after.reference.down == pytest.approx(0.43 + learn * (0.41 - 0.43))
