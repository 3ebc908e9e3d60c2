"""From a real IMU to the paper's vectors with confidences."""

from estimator.conditioning.condition import Conditioned, condition
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.state import (
    ConditioningState,
    apply_turn,
    forget_bias,
    forget_coefficients,
    forget_field,
    initial_state,
)

__all__ = [
    "Conditioned",
    "ConditioningParams",
    "ConditioningState",
    "apply_turn",
    "condition",
    "forget_bias",
    "forget_coefficients",
    "forget_field",
    "initial_state",
]
