"""Readings in wrong units and axes are named, with what would fit; sound ones are not."""

import warnings

import numpy as np
import pytest

from drivers.simulation.simulated_vehicle import SimulatedVehicle
from fuzzbee import Estimator, InputError
from fuzzbee.array_estimator import Unfit
from tests.fuzzbee.recording import FLIPS, recorded

FRD = np.array((1.0, -1.0, -1.0))


@pytest.fixture(scope="module")
def flight():
    """Times, gyr, acc, mag of 20 s with flips at 50 Hz; the field ten times a second."""
    return recorded(FLIPS)[:4]


def wrong(t, w, f, m):
    """Times, gyroscope, accelerometer, magnetometer as they may come, and what is reported."""
    nan, numbers, deg = np.full_like(m, np.nan), np.arange(len(t), dtype=float), np.degrees(w)
    swapped = "mostly, as acc should: they may be swapped$"
    scaled = "its unit, or the times, are others$"
    apart, flu = "^samples are 1 s apart and turn as if", (w * FRD, f * FRD, m * FRD)
    return {
        "degrees": (t, deg, f, m, r"agree 4\d\d times better with gyr \* pi / 180$"),
        "no field": (t, deg, f, nan, r"accelerometer agree 4\d times better with gyr \* pi / 180$"),
        "flu": (t, *flu, r"upside down .* want \* \(1, -1, -1\) for all three"),
        "ms": (1e3 * t, w, f, m, r"^samples are 20 s apart: milliseconds want time_s / 1000$"),
        "ns": (1e9 * t, w, f, m, r"^samples are 2e\+07 s apart: nanoseconds want time_s / 1e\+09$"),
        "backwards": (t[::-1], w, f, m, "^time_s runs backwards"),
        "g": (t, w, f / 9.80665, m, r"reads 1.01 mostly, which would fit as acc \* 9.80665"),
        "feet": (t, w, f / 0.3048, m, r"reads 32.6 mostly, which would fit as acc \* 0.3048 \(fe"),
        "uT": (t, w, f, 100.0 * m, "reads 58 mostly, which would fit as mag / 100"),
        "numbers": (numbers, w, f, m, f"{apart} 0.021 s were between$"),
        "both": (numbers, deg, f, m, f"{apart} 0.00036 s were between"),
        "milliradians": (t, 1e3 * w, f, m, rf"better with gyr \* 0.001: {scaled}"),
        "angles": (t, w * np.median(np.diff(t)), f, m, rf"better with gyr \* 5\d: {scaled}"),
        "raw": (t, w, f, 10.0 * m, "^the magnetometer reads 5.8 mostly, 0.05 to 5 is usual$"),
        "force last": (t, w, np.full_like(m, 0.3), f, f"^mag reads 9.95 {swapped}"),
        "force first": (t, f, w, m, f"^gyr reads 9.93 {swapped}"),
        "no force": (t, w, 0.0 * f, m, r"reads 0 mostly, 4\.9 to 19\.6 is usual"),
        "no rates": (t, 0.0 * w, f, m, "^the gyroscope reads nothing but 0$"),
        "-x": (t, w * (-1, 1, 1), f, m, r"agree 13 times better with gyr \* \(-1, 1, 1\)$"),
        "yxz": (t, w[:, [1, 0, 2]], f, m, r"agree 10 times better with gyr\[:, \[1, 0, 2\]\]$"),
    }


WRONG = [*wrong(np.arange(2.0), *np.ones((3, 2, 3)))]


def advice(time_s, *readings):
    """What is reported of units and axes, whatever becomes of the samples."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        reported = Estimator().update_batch(*readings, time_s).warnings
    return tuple(line for line in reported if not line.startswith("most of the samples"))


@pytest.mark.filterwarnings("ignore")  # of times that are not later
@pytest.mark.parametrize("name", WRONG)
def test_what_does_not_fit_is_reported_once_with_what_would(flight, name):
    time_s, *readings, line = wrong(*flight)[name]
    estimator = Estimator()
    with pytest.warns(Unfit, match=line):
        reported = estimator.update_batch(*readings, time_s).warnings
    assert len(reported) == 1
    assert not {*reported} & {*estimator.update_batch(*readings, time_s + 30.0).warnings}
    with pytest.raises(InputError, match=line):
        Estimator().update_batch(*readings, time_s, strict=True)


@pytest.mark.parametrize(
    ("rate_hz", "rows", "unit", "warned"),
    [
        (1000.0, slice(20_000, 30_000), 1e3, 1),
        (1000.0, slice(20_000, 30_000), 1.0, 0),
        (1.0, slice(500), 1.0, 0),
    ],
)
def test_milliseconds_of_quick_samples_differ_from_seconds(rate_hz, rows, unit, warned):
    """A second apart, but turning as they do within a millisecond."""
    vehicle = SimulatedVehicle(0, rate_hz, "flight", calm=True)
    samples = [next(vehicle) for _ in range(rows.stop)][rows]
    time_s = unit * 1e-6 * np.array([each.time_us for each in samples])
    readings = (np.array([each[k] for each in samples]) for k in (1, 2, 3))
    line = "samples are 1 s apart: milliseconds want time_s / 1000"
    assert advice(time_s, *readings) == warned * (line,)


def test_a_field_in_other_axes_is_not_taken_for_other_units():
    """A tumbling box: turned axes of the field, or of the gyroscope, are the same to both."""
    time_s = np.arange(0.0, 20.0, 0.01)
    gyr = np.column_stack([np.sin(time_s), np.cos(0.7 * time_s), np.sin(0.4 * time_s + 1.0)])
    vectors = np.array([(0.0, 0.0, -9.81), (0.2, 0.0, 0.4)])
    acc, mag = np.empty((2, len(gyr), 3))
    for k, rate in enumerate(gyr):
        acc[k], mag[k] = vectors
        for _ in range(10):
            vectors = vectors - 0.001 * np.cross(rate, vectors)
    assert advice(time_s, gyr, acc, mag) == ()
    (output,) = advice(time_s, gyr, acc, mag[:, [1, 0, 2]] * (1, 1, -1))
    turned = "[:, [1, 0, 2]] * (1, 1, -1)"
    assert output.endswith(f"with mag{turned}, or with gyr{turned}")


@pytest.mark.parametrize("spikes", [0, 1, 5])
def test_sound_readings_and_some_spikes_are_nothing_to_warn_of(flight, spikes):
    time_s, gyr, acc, mag = (values.copy() for values in flight)
    gyr[np.arange(40, len(gyr), 200)[:spikes]] = 1000.0
    assert Estimator().update_batch(gyr, acc, mag, time_s, strict=True).warnings == ()


@pytest.mark.parametrize("rows", [0, 1, 2, 200])
def test_a_few_samples_are_not_judged(flight, rows):
    time_s, *readings = (values[:rows] for values in wrong(*flight)["degrees"][:4])
    Estimator().update_batch(*readings, time_s, strict=True)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_numbers_that_are_no_readings_are_nothing_to_compare(flight, value):
    time_s, gyr, acc, mag = (values.copy() for values in flight)
    for readings in (gyr, acc, mag):
        readings[100:] = value
    reported = Estimator().update_batch(gyr, acc, mag, time_s, strict=True).warnings
    assert [line.split(":")[0] for line in reported] == ["most of the samples could not be used"]


@pytest.mark.parametrize("gyr_rad_s", [(0.001, 0.002, 0.003), (0.01, 0.0, 0.0), (0.1, 0.2, 0.3)])
def test_vectors_that_never_change_explain_no_turn(gyr_rad_s):
    """A made recording at rest with a biased gyroscope, and stuck sensors in one that turns."""
    readings = (np.tile(v, (1000, 1)) for v in (gyr_rad_s, (0.0, 0.0, -9.81), (0.2, 0.01, 0.45)))
    assert advice(0.01 * np.arange(1000), *readings) == ()
