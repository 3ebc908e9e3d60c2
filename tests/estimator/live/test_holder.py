"""Compiled steps do not check their arguments: wrong ones end in an error here, not in memory."""

import numba
import numpy as np
import pytest

from estimator.aiding.types import NO_REPORT
from estimator.errors import InputError
from estimator.live.core import in_tuples, initial_core
from estimator.live.holder import Holder
from estimator.live.rows import NO_REPORT_ROWS, OUTPUT_SIZE, Rows
from estimator.live.settings import settings_of
from estimator.profile import load_profile
from estimator.types import VelocitySample

READINGS = (0.0, 0.0, 0.1, 0.0, 0.0, -9.8, 0.2, 0.0, 0.4)
SETTINGS = settings_of(load_profile("imu"))
REPORT = VelocitySample(0, (1.0, 2.0, 3.0), True, 0.3)
compiled_only = pytest.mark.skipif(
    bool(numba.config.DISABLE_JIT), reason="plain Python minds by itself"
)


@pytest.fixture
def holder():
    holder = Holder(SETTINGS, initial_core(SETTINGS))
    holder.advance(1, *READINGS, True, 0, 0, 0)
    return holder


@pytest.mark.parametrize("wrong", [None, "1", (1.0, 2.0), [], REPORT._replace(sigma_m_s=None)])
@pytest.mark.parametrize(("step", "others"), [("take_other_report", (0,)), ("search", ())])
def test_what_is_no_report(holder, step, others, wrong):
    before = in_tuples(holder.core)
    with pytest.raises(InputError, match=r"stands where|no source of aiding"):
        getattr(holder, step)(wrong, *others)
    assert in_tuples(holder.core) == before


@compiled_only
@pytest.mark.parametrize("wrong", [None, "x", (1.0,), np.zeros(3)])
def test_what_is_no_number(holder, wrong):
    before = in_tuples(holder.core)
    for at in range(len(READINGS)):
        with pytest.raises((TypeError, ValueError)):
            holder.advance(2, *READINGS[:at], wrong, *READINGS[at + 1 :], True, 0, 0, 0)
    with pytest.raises((TypeError, ValueError)):
        holder.publish(wrong)
    assert in_tuples(holder.core) == before


@compiled_only
@pytest.mark.parametrize("count", [0, 5, 30])
def test_another_number_of_arguments(holder, count):
    for step in (holder.advance, holder.publish):
        with pytest.raises(TypeError):
            step(*(1,) * count)


def rows(kind=np.float64, spread=1):
    """Samples a tenth of a second apart, of numbers that float32 and float64 both hold."""
    vectors = np.round(np.reshape(READINGS, (3, 3)) * 1024) / 1024
    columns = (np.tile(v, (4, spread)).astype(kind)[:, :3] for v in vectors)
    return Rows(np.arange(1, 5) * 100_000, *columns, np.ones(4, np.bool_))


@pytest.mark.parametrize(("kind", "spread"), [(np.float32, 1), (np.float64, 2), (np.float32, 3)])
def test_rows_of_another_type_or_layout_are_converted(holder, kind, spread):
    other = Holder(SETTINGS, holder.core)
    output, wanted = np.zeros((4, OUTPUT_SIZE)), np.zeros((4, OUTPUT_SIZE))
    for one, given, out in ((holder, rows(), wanted), (other, rows(kind, spread), output)):
        one.bind_rows(given, out, NO_REPORT_ROWS)
        assert one.advance(0, *(0.0,) * 9, False, 0, 4, 0)[0] == 4
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
def test_rows_that_do_not_fit_each_other(holder, wrong):
    with pytest.raises(InputError, match="rows of samples take"):
        holder.bind_rows(rows()._replace(**wrong), np.zeros((4, OUTPUT_SIZE)), NO_REPORT_ROWS)


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
def test_where_nothing_can_be_written(holder, output):
    with pytest.raises(InputError, match="writable"):
        holder.bind_rows(rows(), output, NO_REPORT_ROWS)


def test_a_report_of_whole_numbers_is_taken(holder):
    """Compiled code gets floats in their places."""
    whole = NO_REPORT._replace(given=1, velocity_ned_m_s=(1, 2, 3), sigma_m_s=1)
    assert not holder.search(whole)
    assert holder.core.search.window.velocity_ned_m_s == (1.0, 2.0, 3.0)
