"""Whole recordings through the conditioned filter in one compiled loop."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compilation.compiled import compiled
from estimator.conditioning import ConditioningParams, ConditioningState, condition
from estimator.filter.observation import ReferenceParams
from estimator.filter.types import FilterParams, FilterState
from estimator.live.conditioned import follow_conditioned
from estimator.types import NOTHING_BETWEEN, Sample

Array = NDArray[np.float64]


class Parameters(NamedTuple):
    """What is chosen about the filter and the conditioning stage."""

    filter: FilterParams
    reference: ReferenceParams
    conditioning: ConditioningParams


class Recording(NamedTuple):
    """N samples in FRD, each ``dt_s`` (N,) after the one before; the readings are (N, 3)."""

    gyr_rad_s: Array
    acc_m_s2: Array
    mag: Array
    dt_s: Array


@compiled
def run_conditioned(
    params: Parameters, state: FilterState, memory: ConditioningState, data: Recording
) -> tuple[Array, FilterState, ConditioningState]:
    """The estimates ``q_ned_frd`` after each sample (N, 4), and the states to go on from."""
    n = len(data.dt_s)
    estimates = np.empty((n, 4))
    for k in range(n):
        gyr, acc, mag = data.gyr_rad_s[k], data.acc_m_s2[k], data.mag[k]
        sample = Sample(
            gyr_rad_s=(gyr[0], gyr[1], gyr[2]),
            acc_m_s2=(acc[0], acc[1], acc[2]),
            mag=(mag[0], mag[1], mag[2]),
            has_mag=True,
            dt_s=data.dt_s[k],
            between=NOTHING_BETWEEN,
        )
        memory, seen = condition(params.conditioning, memory, sample)
        state = follow_conditioned(params.filter, params.reference, state, seen, sample.dt_s)
        for i in range(4):
            estimates[k, i] = state.q_ned_frd[i]
    return estimates, state, memory
