"""Magnitudes and axes that cannot be right: each sensor by itself."""

import pytest

from drivers.samples.imu_stream import AXES_COMPLAINT, SPACING_US, Plausibility, RepeatedField
from drivers.samples.navigation import Fix
from estimator.types import ImuSample

GYR, FORCE, FIELD = (0.1, -0.2, 0.1), (0.5, -0.4, -9.7), (0.2, -0.1, 0.4)


def complaints(*, gyr=GYR, acc=FORCE, mag=FIELD):
    """Of sixty looks at the same readings, from a sender not known for FRD."""
    watcher, said = Plausibility(), []
    for k in range(60):
        sample = ImuSample(k * (SPACING_US + 1), gyr, acc, mag, True)
        said += watcher.look(sample, mag, doubts_axes=True)
    return said


@pytest.mark.parametrize(
    ("readings", "begins"),
    [
        ({"acc": (0.05, 0.1, -0.99)}, ["accelerometer reads 0.102 g"]),
        ({"acc": (0.5, -0.4, 9.7)}, [AXES_COMPLAINT]),
        # downwards, but far from level: the axes may be right
        ({"acc": (0.0, -9.0, 4.0)}, []),
        ({"gyr": (-30.0, -30.0, 1.0)}, ["gyroscope reads 2.43e+03 deg/s"]),
        ({"mag": (-20.0, 10.0, -40.0)}, ["magnetometer reads 45.8 gauss"]),
        ({}, []),
    ],
)
def test_each_is_told_once_of_whichever_sign(readings, begins):
    said = complaints(**readings)
    assert len(said) == len(begins)
    assert all(text.startswith(begin) for text, begin in zip(said, begins, strict=True))


def test_a_field_repeated_after_the_clock_went_back_is_new():
    field = RepeatedField()
    assert field.is_fresh(FIELD, 1_000_000)
    assert not field.is_fresh(FIELD, 1_239_999)
    assert field.is_fresh(FIELD, 1_240_000)
    assert field.is_fresh(FIELD, 1_100_000)


@pytest.mark.parametrize(
    ("place", "is_solved"),
    [((0, 0), False), ((0, 8.5), True), ((47.4, 0), True), ((47.4, 8.5), True)],
)
def test_on_the_equator_and_on_greenwichs_meridian_there_are_places(place, is_solved):
    assert Fix(position=(*place, 0.0)).is_solved is is_solved
