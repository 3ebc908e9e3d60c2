"""The paper's signals with the noise of the gyroscope and of the vectors scaled apart."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from drivers.simulation.simulated_vehicle import Recording, simulate
from estimator.types import Floats, ImuSample


class NoiseScale(NamedTuple):
    """Factors on the paper's noise: a number each, or (N,) with one for every sample."""

    gyroscope: float | Floats = 1.0
    vectors: float | Floats = 1.0


PAPER_NOISE = NoiseScale()


def simulate_scaled(
    seed: int, samples: int, scale: NoiseScale, rate_hz: float = 100.0
) -> Recording:
    """The paper's signals of ``seed`` with the same random numbers, their noise scaled."""
    gyr, vectors = (np.reshape(factor, (-1, 1)) for factor in scale)
    noisy = simulate(seed, samples, rate_hz)
    clean = simulate(seed, samples, rate_hz, noise=0.0)
    return noisy._replace(
        gyr_rad_s=clean.gyr_rad_s + gyr * (noisy.gyr_rad_s - clean.gyr_rad_s),
        acc_m_s2=clean.acc_m_s2 + vectors * (noisy.acc_m_s2 - clean.acc_m_s2),
        mag_gauss=clean.mag_gauss + vectors * (noisy.mag_gauss - clean.mag_gauss),
    )


def samples_of(made: Recording) -> Iterator[ImuSample]:
    """The signals as samples."""
    columns = (made.time_us, made.gyr_rad_s, made.acc_m_s2, made.mag_gauss)
    for time_us, *readings in zip(*map(np.ndarray.tolist, columns), strict=True):
        gyr, acc, mag = map(tuple, readings)
        yield ImuSample(time_us, gyr, acc, mag, True)
