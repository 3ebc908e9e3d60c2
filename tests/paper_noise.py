"""The paper's signals with the noise of the gyroscope and of the vectors scaled apart."""

from typing import NamedTuple

import numpy as np

from drivers.simulation.simulated_vehicle import Recording, simulate
from estimator.arrays import Floats
from estimator.errors import InputError


class NoiseScale(NamedTuple):
    """Factors on the paper's noise: a number each, or (N,) with one for every sample."""

    gyroscope: float | Floats = 1.0
    vectors: float | Floats = 1.0


PAPER_NOISE = NoiseScale()


def simulate_scaled(
    seed: int, samples: int, scale: NoiseScale, rate_hz: float = 100.0
) -> Recording:
    """The paper's signals of ``seed`` with the same random numbers, their noise scaled.

    Raises:
        InputError: a scale is negative or no number, or has another length than the signals.
    """
    factors = [_column(factor, samples) for factor in scale]
    noisy = simulate(seed, samples, rate_hz)
    clean = simulate(seed, samples, rate_hz, noise=0.0)
    gyr, vectors = factors
    return noisy._replace(
        gyr_rad_s=clean.gyr_rad_s + gyr * (noisy.gyr_rad_s - clean.gyr_rad_s),
        acc_m_s2=clean.acc_m_s2 + vectors * (noisy.acc_m_s2 - clean.acc_m_s2),
        mag_gauss=clean.mag_gauss + vectors * (noisy.mag_gauss - clean.mag_gauss),
    )


def _column(factor: float | Floats, samples: int) -> Floats:
    """The factor as a column, (N, 1) or (1, 1)."""
    column = np.asarray(factor, dtype=np.float64).reshape(-1, 1)
    if len(column) not in (1, samples):
        raise InputError(f"the noise has {len(column)} scales, the signals {samples} samples")
    if not (np.isfinite(column).all() and (column >= 0.0).all()):
        raise InputError("the scale of the noise must be 0 or more")
    return column
