"""Compiled steps do not check their arguments: wrong ones end in an error here, not in memory."""

import numba
import numpy as np
import pytest

from estimator.errors import InputError
from estimator.estimator import Estimator
from estimator.live.rows import OUTPUT_SIZE, Rows
from estimator.profile import load_profile
from estimator.types import VelocitySample

READINGS = (0.0, 0.0, 0.1, 0.0, 0.0, -9.8, 0.2, 0.0, 0.4)
REPORT = VelocitySample(1, (1.0, 2.0, 3.0), True, 0.3)
compiled_only = pytest.mark.skipif(
    bool(numba.config.DISABLE_JIT), reason="plain Python minds by itself"
)


def vectors(readings):
    return readings[:3], readings[3:6], readings[6:]


@pytest.fixture
def estimator():
    estimator = Estimator(load_profile("imu"))
    estimator.take(1, *vectors(READINGS), True)
    return estimator


@pytest.mark.parametrize("wrong", [None, "1", (1.0, 2.0), [], REPORT._replace(sigma_m_s=None)])
def test_what_is_no_report(estimator, wrong):
    before = estimator.snapshot
    with pytest.raises(InputError, match=r"stands where|no source of aiding"):
        estimator.update_report(wrong)
    assert estimator.snapshot == before


@compiled_only
@pytest.mark.parametrize("wrong", [None, "x", (1.0,), np.zeros(3)])
def test_what_is_no_number(estimator, wrong):
    before = estimator.snapshot
    for at in range(len(READINGS)):
        readings = (*READINGS[:at], wrong, *READINGS[at + 1 :])
        with pytest.raises((TypeError, ValueError)):
            estimator.take(2, *vectors(readings), True)
    with pytest.raises((TypeError, ValueError)):
        estimator.attitude(wrong)
    assert estimator.snapshot == before


@compiled_only
@pytest.mark.parametrize("count", [0, 5, 30])
def test_another_number_of_arguments(estimator, count):
    with pytest.raises(TypeError):
        estimator.take(2, (1.0,) * count, *vectors(READINGS)[1:], True)


def rows(kind=np.float64, spread=1):
    """Samples a tenth of a second apart, of numbers that float32 and float64 both hold."""
    rounded = np.round(np.reshape(READINGS, (3, 3)) * 1024) / 1024
    columns = (np.tile(v, (4, spread)).astype(kind)[:, :3] for v in rounded)
    return Rows(np.arange(1, 5) * 100_000, *columns, np.ones(4, np.bool_))


@pytest.mark.parametrize(("kind", "spread"), [(np.float32, 1), (np.float64, 2), (np.float32, 3)])
def test_rows_of_another_type_or_layout_are_converted(estimator, kind, spread):
    other = Estimator(load_profile("imu"))
    other.snapshot = estimator.snapshot
    output, wanted = np.zeros((4, OUTPUT_SIZE)), np.zeros((4, OUTPUT_SIZE))
    for one, given, out in ((estimator, rows(), wanted), (other, rows(kind, spread), output)):
        assert one.update_rows(given, out) == (4, 0)
    assert np.array_equal(output, wanted)
    assert output.any()


@pytest.mark.parametrize(
    "wrong",
    [
        {"gyr_rad_s": np.zeros((3, 3))},
        {"acc_m_s2": np.zeros((4, 2))},
        {"mag_gauss": None},
        {"has_mag": np.ones(3, np.bool_)},
        {"acc_m_s2": np.full((4, 3), "x")},
    ],
)
def test_rows_that_do_not_fit_each_other(estimator, wrong):
    with pytest.raises(InputError, match="rows of samples take"):
        estimator.update_rows(rows()._replace(**wrong), np.zeros((4, OUTPUT_SIZE)))


@pytest.mark.parametrize(
    "output",
    [
        np.zeros((4, OUTPUT_SIZE), np.float32),
        np.zeros((3, OUTPUT_SIZE)),
        np.zeros((4, OUTPUT_SIZE + 1))[:, 1:],
        np.zeros((OUTPUT_SIZE, 4)).T,
        [[0.0] * OUTPUT_SIZE] * 4,
        None,
    ],
)
def test_where_nothing_can_be_written(estimator, output):
    with pytest.raises(InputError, match="writable"):
        estimator.update_rows(rows(), output)
