"""When a recording counts as moving."""

import numpy as np
from numpy.typing import NDArray

from estimator.types import ImuSample
from fuzzbee.column_store import PackedSamples
from fuzzbee.replays import motion
from fuzzbee.replays.motion import (
    MOST_BIAS_RAD_S,
    REST_ACC_M_S2,
    REST_GYR_RAD_S,
    WINDOW_S,
    motion_mask,
)

RATE_HZ = 4.0


def samples(gyr: NDArray[np.float64], acc: NDArray[np.float64]) -> PackedSamples:
    return PackedSamples(
        ImuSample(round(1e6 * k / RATE_HZ), tuple(w), tuple(f), (0.0, 0.0, 0.0), False)
        for k, (w, f) in enumerate(zip(gyr.tolist(), acc.tolist(), strict=True))
    )


def still(n: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A gyroscope with a bias of 1 deg/s, an accelerometer on its side, both with noise."""
    rng = np.random.default_rng(1)
    gyr = np.radians(1.0) + 0.002 * rng.standard_normal((n, 3))
    acc = np.array([0.0, 9.8, 0.0]) + 0.05 * rng.standard_normal((n, 3))
    return gyr, acc


def test_a_vehicle_at_rest_does_not_move_for_its_bias_or_its_attitude() -> None:
    assert not motion_mask(samples(*still(40))).any()


def test_a_turn_counts_with_a_second_and_a_half_around_it() -> None:
    gyr, acc = still(40)
    gyr[20] += 0.5
    assert np.flatnonzero(motion_mask(samples(gyr, acc))).tolist() == list(range(14, 27))


def test_a_steady_turn_counts_although_nothing_changes() -> None:
    gyr, acc = still(40)
    assert motion_mask(samples(gyr + 0.2, acc)).all()


def test_shaking_without_turning_counts() -> None:
    gyr, acc = still(40)
    acc[::2] += 1.0
    assert motion_mask(samples(gyr, acc)).all()


def test_no_samples_no_motion() -> None:
    assert motion_mask(PackedSamples()).shape == (0,)


def test_what_decides_without_medians_decides_as_they_do(monkeypatch) -> None:
    """Readings around both limits, at uneven times."""
    rng = np.random.default_rng(4)
    n = 3000
    monkeypatch.setattr(motion, "BLOCK", 700)
    calm = 0.5 + 0.5 * np.sin(np.arange(n) / 200.0)[:, None]
    gyr = np.radians(1.0) * calm * rng.standard_normal((n, 3)) + np.radians(3.0) * calm
    acc = 0.1 * calm * rng.standard_normal((n, 3)) + (0.0, 0.0, -9.8)
    acc[::97, 0] += 0.32  # no more than the limit of all of them, but of one
    made = samples(gyr, acc)
    times_us = np.sort(rng.integers(0, 300_000_000, n)).tolist()
    made = PackedSamples(s._replace(time_us=t) for s, t in zip(made, times_us, strict=True))

    def moved(k: int) -> bool:
        near = np.abs(1e-6 * np.array(times_us) - 1e-6 * times_us[k]) <= WINDOW_S
        steady = (
            np.linalg.norm(x[near] - np.median(x[near], axis=0), axis=1).max() < limit
            for x, limit in ((gyr, REST_GYR_RAD_S), (acc, REST_ACC_M_S2))
        )
        turns = np.linalg.norm(np.median(gyr[near], axis=0)) > MOST_BIAS_RAD_S
        return not all(steady) or bool(turns)

    plain = np.array([moved(k) for k in range(n)])
    assert 0.2 < plain.mean() < 0.8
    assert np.array_equal(motion_mask(made), plain)
