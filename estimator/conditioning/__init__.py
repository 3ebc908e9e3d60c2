"""From a real IMU to the paper's vectors with confidences."""

from estimator.conditioning.condition import condition
from estimator.conditioning.initial import initial_state, turned, with_unknown_bias
from estimator.conditioning.types import (
    Conditioned,
    ConditioningParams,
    ConditioningState,
)

__all__ = [
    "Conditioned",
    "ConditioningParams",
    "ConditioningState",
    "condition",
    "initial_state",
    "turned",
    "with_unknown_bias",
]
