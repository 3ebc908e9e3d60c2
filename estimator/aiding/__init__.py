"""Velocity beside the IMU: the attitude of a vehicle that accelerates."""

from estimator.aiding.beginning import Beginning, begin, blank_aiding, forget_biases
from estimator.aiding.sources.velocity import is_credible
from estimator.aiding.step import aid, take_late_report
from estimator.aiding.types import AidingParams, AidingState, Report, StepInputs

__all__ = [
    "AidingParams",
    "AidingState",
    "Beginning",
    "Report",
    "StepInputs",
    "aid",
    "begin",
    "blank_aiding",
    "forget_biases",
    "is_credible",
    "take_late_report",
]
