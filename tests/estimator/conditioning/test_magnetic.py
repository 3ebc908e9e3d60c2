"""The confidence of a field, by its norm and its dip."""

from math import cos, radians, sin

import pytest

from estimator.conditioning.field.magnetic import (
    NORM_SCALE,
    AlternativeField,
    FieldLook,
    FieldReference,
    MagneticState,
    look_at_field,
    observe_field,
    steepness,
)
from estimator.conditioning.params import ConditioningParams

PARAMS = ConditioningParams()

DIP = radians(60.0)
EXPECTED = (0.5 * cos(DIP), 0.5 * sin(DIP))
DIP_SCALE = radians(10.0)


def confidence(norm, dip, expected=EXPECTED):
    seen = (norm * cos(dip), norm * sin(dip))
    before = FieldLook(horizontal=0.0, down=0.0, confidence=1.0)
    return look_at_field(before, seen, 1.0, expected, NORM_SCALE, DIP_SCALE).confidence


def test_the_expected_field_has_full_confidence():
    assert confidence(0.5, DIP) == pytest.approx(1.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_one_scale_off_leaves_a_quarter(sign):
    """c = 1/(1 + D^2)^2 at D = 1; of the dip the sine counts, 0.5 % less."""
    assert confidence(0.5 * (1.0 + sign * NORM_SCALE), DIP) == pytest.approx(0.25)
    assert confidence(0.5, DIP + sign * DIP_SCALE) == pytest.approx(0.25, abs=0.003)


def test_nothing_resembles_a_field_of_nothing():
    """Readings that are zero teach a reference of zero; confidence stays a number."""
    assert confidence(0.0, 0.0, (0.0, 0.0)) == 0.0
    assert confidence(0.5, DIP, (0.0, 0.0)) == 0.0


LOOK = FieldLook(horizontal=0.28, down=0.41, confidence=0.6)
REFERENCE = FieldReference(
    horizontal=0.25,
    down=0.43,
    samples=50.0,
    age_s=12.0,
    confirmed_s=7.0,
    other=AlternativeField(0.29, 0.40, 3.0),
    uneven=0.002,
)


def test_steepness_is_the_squared_tangent_of_the_dip_and_bounded():
    assert steepness(REFERENCE) == pytest.approx((0.43 / 0.25) ** 2)
    assert steepness(FieldReference(0.0, -0.5)) == pytest.approx(1.0 / 0.1**2)
    assert steepness(FieldReference()) == 0.0


@pytest.mark.parametrize(("age_s", "count"), [(3.0, 1.0), (8.0, 2.0)])
def test_a_vertical_that_is_not_settled_teaches_by_the_square_of_it(age_s, count):
    """Later its readings count twice, until as many have counted as came."""
    reference = REFERENCE._replace(age_s=age_s, samples=20.0)
    state = MagneticState(LOOK, reference, 0.3, True)
    after = observe_field(PARAMS, state, (0.28, 0.0, 0.41), 0.1, 0.5)
    assert after.reference.samples == pytest.approx(20.0 + count * 0.25)
    assert after.reference.age_s == pytest.approx(age_s + 0.1)
    learn = max(0.25 / after.reference.samples, 0.1 / 15.0 * after.look.confidence)
    assert after.reference.horizontal == pytest.approx(0.25 + learn * (0.28 - 0.25))
    assert after.reference.down == pytest.approx(0.43 + learn * (0.41 - 0.43))
