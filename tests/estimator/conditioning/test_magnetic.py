"""How far a field is believed, by its norm and its dip."""

from math import cos, radians, sin

import pytest

from estimator.conditioning.field.magnetic import FieldLook, look_at_field

DIP = radians(60.0)
EXPECTED = (0.5 * cos(DIP), 0.5 * sin(DIP))
NORM_SCALE, DIP_SCALE = 0.1, radians(10.0)


def confidence(norm, dip, expected=EXPECTED):
    seen = (norm * cos(dip), norm * sin(dip))
    before = FieldLook(horizontal=0.0, down=0.0, confidence=1.0)
    return look_at_field(before, seen, 1.0, expected, NORM_SCALE, DIP_SCALE).confidence


def test_the_expected_field_is_believed():
    assert confidence(0.5, DIP) == pytest.approx(1.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_one_scale_off_leaves_a_quarter(sign):
    """c = 1/(1 + D^2)^2 at D = 1; of the dip the sine counts, 0.5 % less."""
    assert confidence(0.5 * (1.0 + sign * NORM_SCALE), DIP) == pytest.approx(0.25)
    assert confidence(0.5, DIP + sign * DIP_SCALE) == pytest.approx(0.25, abs=0.003)


def test_both_add_up():
    off = confidence(0.5 * (1.0 - NORM_SCALE), DIP + DIP_SCALE)
    assert off == pytest.approx(1.0 / 9.0, abs=0.002)


def test_nothing_resembles_a_field_of_nothing():
    """Readings that are zero teach a reference of zero; confidence stays a number."""
    assert confidence(0.0, 0.0, (0.0, 0.0)) == 0.0
    assert confidence(0.5, DIP, (0.0, 0.0)) == 0.0
