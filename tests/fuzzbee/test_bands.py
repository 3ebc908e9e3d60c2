"""What a figure shades: each kind of band where it was made."""

import numpy as np
import pytest

from drivers.events import VehicleId
from estimator.types import IDENTITY, Attitude, ImuSample
from fuzzbee.replays.bands import bands, runs
from fuzzbee.replays.comparison import Beside, Comparison
from fuzzbee.replays.trace import VehicleTrace

N, STEP_S = 400, 0.1


def made():
    """40 s: a gap at 5, clipping at 10, a doubted field from 15 to 20, aided from 12 to 30."""
    trace = VehicleTrace(VehicleId(1, 1))
    for k in range(N):
        time_us = round(1e6 * (STEP_S * k + 2.0 * (k >= 50)))
        field = 0.1 if 150 <= k < 200 else 0.9
        rest = (0.0, 0.0, 1.0, 1.0, field, 0.01, 0.02, "magnetic")
        trace.attitudes.append(Attitude(time_us, IDENTITY, (0.0,) * 3, (0.0,) * 3, *rest))
        rate = 30.0 if 100 <= k < 106 else 0.01 * (k % 7)
        trace.samples.append(
            ImuSample(time_us, (rate, 0.0, 0.0), (0.0, 0.0, -9.8), (0.0,) * 3, False)
        )
        trace.aided.extend((120 <= k < 300,))
    return trace


def drawn(trace, errors_rad=None):
    time_s = 1e-6 * (trace.times_us - trace.times_us[0])
    errors = np.zeros((N, 3)) if errors_rad is None else errors_rad
    compared = Comparison("sim", [Beside(np.tile(IDENTITY, (N, 1)), np.ones(N, bool), errors)])
    return {band.label: band.spans for band in bands(time_s, trace, compared)}


def test_each_band_is_where_it_was():
    found = drawn(made())
    assert found["gap"] == [pytest.approx((4.9, 7.0))]
    assert found["gyroscope at its end"] == [pytest.approx((12.1, 12.6))]
    assert found["field doubted"] == [pytest.approx((17.0, 22.0))]
    assert found["no velocity"] == [pytest.approx((0.0, 14.0)), pytest.approx((32.0, 41.9))]
    assert found["autopilot differs"] == []
    assert "wrong start" not in found


def test_a_wrong_start_lasts_until_the_error_is_small():
    trace = made()
    trace.turned_at_us = 1_000_000
    errors = np.zeros((N, 3))
    errors[10:40] = 1.0
    assert drawn(trace, errors)["wrong start"] == [pytest.approx((1.0, 4.0))]


def test_short_runs_are_none_and_near_ones_are_one():
    time_s = np.arange(100) * 0.1
    flags = np.zeros(100, bool)
    flags[[5, *range(20, 35), *range(40, 60)]] = True
    assert runs(time_s, flags) == [pytest.approx((2.0, 6.0))]
