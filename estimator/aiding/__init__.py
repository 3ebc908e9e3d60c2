"""Velocity beside the IMU: the attitude of a vehicle that accelerates."""

from estimator.aiding.sources.velocity import trusted
from estimator.aiding.step import aid, begin, hear, with_unknown_biases
from estimator.aiding.types import AidingParams, AidingState, Report

__all__ = [
    "AidingParams",
    "AidingState",
    "Report",
    "aid",
    "begin",
    "hear",
    "trusted",
    "with_unknown_biases",
]
