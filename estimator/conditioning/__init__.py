"""From a real IMU to the paper's vectors with confidences."""

from estimator.conditioning.condition import condition
from estimator.conditioning.initial import apply_turn, forget_bias, initial_state
from estimator.conditioning.types import (
    Conditioned,
    ConditioningParams,
    ConditioningState,
)

__all__ = [
    "Conditioned",
    "ConditioningParams",
    "ConditioningState",
    "apply_turn",
    "condition",
    "forget_bias",
    "initial_state",
]
