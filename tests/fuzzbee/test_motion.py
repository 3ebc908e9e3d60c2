"""When a recording counts as moving."""

import numpy as np
from numpy.typing import NDArray

from estimator.types import ImuSample
from fuzzbee.replays.motion import motion_mask

RATE_HZ = 4.0


def samples(gyr: NDArray[np.float64], acc: NDArray[np.float64]) -> list[ImuSample]:
    return [
        ImuSample(round(1e6 * k / RATE_HZ), tuple(w), tuple(f), (0.0, 0.0, 0.0), False)
        for k, (w, f) in enumerate(zip(gyr.tolist(), acc.tolist(), strict=True))
    ]


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
    assert motion_mask([]).shape == (0,)
