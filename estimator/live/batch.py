"""Whole recordings through the conditioned filter in one compiled loop."""

import numpy as np
from numpy.typing import NDArray

from estimator.compilation.compiled import compiled
from estimator.conditioning.types import ConditioningParams, ConditioningState
from estimator.filter.observation import ReferenceParams
from estimator.filter.types import FilterParams, FilterState
from estimator.live.conditioned import conditioned_step

Array = NDArray[np.float64]


@compiled
def run_conditioned(
    params: FilterParams,
    reference: ReferenceParams,
    conditioning: ConditioningParams,
    state: FilterState,
    memory: ConditioningState,
    gyr_rad_s: Array,
    acc_m_s2: Array,
    mag: Array,
    has_mag: NDArray[np.bool_],
    dt_s: Array,
) -> tuple[Array, FilterState, ConditioningState]:
    """The steps of :func:`conditioned_step` for N samples, each ``dt_s`` after the one before.

    The readings are (N, 3) in FRD, ``has_mag`` and ``dt_s`` (N,). Returns the
    estimates after each sample (N, 4), ``q_ned_frd``, and the states to go on
    from.
    """
    n = len(gyr_rad_s)
    estimates = np.empty((n, 4))
    for k in range(n):
        state, memory, _ = conditioned_step(
            params,
            reference,
            conditioning,
            state,
            memory,
            (gyr_rad_s[k, 0], gyr_rad_s[k, 1], gyr_rad_s[k, 2]),
            (acc_m_s2[k, 0], acc_m_s2[k, 1], acc_m_s2[k, 2]),
            (mag[k, 0], mag[k, 1], mag[k, 2]),
            has_mag[k],
            dt_s[k],
        )
        q = state.q_ned_frd
        estimates[k, 0] = q[0]
        estimates[k, 1] = q[1]
        estimates[k, 2] = q[2]
        estimates[k, 3] = q[3]
    return estimates, state, memory
