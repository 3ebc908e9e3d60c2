"""All that changes in an estimator, as one value, and what can be done to it from outside."""

from math import asin, sqrt
from typing import NamedTuple

import numpy as np

from estimator import conditioning
from estimator.aiding import AidingState, begin, forget_biases
from estimator.aiding.compass import Compass
from estimator.aiding.search import EMPTY_SEARCH, Search
from estimator.aiding.types import SIZE, Array
from estimator.conditioning.types import Conditioned, ConditioningState
from estimator.filter.types import FilterState
from estimator.geometry.quaternion import conjugate, multiply, normalize
from estimator.live.published import (
    Figures,
    Motion,
    aided_figures,
    at_least,
    at_most_half_turn,
    conditioned_figures,
    motion,
)
from estimator.live.reports import NO_REPORT, Reports
from estimator.live.resident import Contents
from estimator.live.settings import Settings
from estimator.types import IDENTITY, ZERO_VEC3, Quaternion, Vec3


class Snapshot(NamedTuple):
    """All that changes. Restoring it resumes with the same results."""

    filter: FilterState
    conditioning: ConditioningState
    seen: Conditioned | None
    time_us: int
    rate_rad_s: Vec3
    aligned: bool
    smooth_error: float  # e low-passed, for the sigma of raw vectors
    aided: AidingState | None = None  # while velocity helps
    aided_covariance: tuple[float, ...] = ()  # row by row
    reports: Reports = ()  # velocities that the IMU has not reached yet
    search: Search = EMPTY_SEARCH  # for an attitude from velocity alone
    compass: Compass = Compass()  # how far the field is trusted


def square(covariance: tuple[float, ...]) -> Array:
    """The covariance as an array of ``SIZE`` columns."""
    return np.array(covariance).reshape(-1, SIZE)


def flat(covariance: Array) -> tuple[float, ...]:
    """Row by row, as a snapshot keeps it."""
    return tuple(covariance.ravel().tolist())


def contents_for(settings: Settings, now: Snapshot, seen: Conditioned) -> Contents:
    """The state as compiled memory holds it."""
    aided, covariance = now.aided, square(now.aided_covariance)
    if aided is None:  # only its form is needed
        aided, covariance = begin(
            settings.aiding, IDENTITY, ZERO_VEC3, ZERO_VEC3, ZERO_VEC3, NO_REPORT, 0.0, 0.0
        )
    return Contents(
        settings.filter,
        settings.reference,
        settings.conditioning,
        settings.aiding,
        now.filter,
        now.conditioning,
        seen,
        aided,
        covariance,
        now.search,
    )


def apply_turn(now: Snapshot, turn_ned: Quaternion) -> Snapshot:
    """Every attitude inside turned by the same body rotation: q* K q of the filter's q."""
    q = now.filter.q_ned_frd
    turn_frd = multiply(conjugate(q), multiply(turn_ned, q))
    aided = now.aided
    if aided is not None:
        aided = aided._replace(q_ned_frd=normalize(multiply(aided.q_ned_frd, turn_frd)))
    return now._replace(
        filter=now.filter._replace(q_ned_frd=normalize(multiply(q, turn_frd))),
        conditioning=conditioning.apply_turn(now.conditioning, turn_frd),
        aided=aided,
    )


def change_imu(settings: Settings, now: Snapshot) -> Snapshot:
    """The same attitude and velocity; the biases of its sensors are not known yet."""
    aided, covariance = now.aided, now.aided_covariance
    if aided is not None:
        aided, P = forget_biases(settings.aiding, aided, square(covariance))
        covariance = flat(P)
    return now._replace(
        conditioning=conditioning.forget_bias(settings.conditioning, now.conditioning),
        aided=aided,
        aided_covariance=covariance,
    )


def published(settings: Settings, now: Snapshot, ahead_s: float) -> tuple[Motion, Figures]:
    """What a state that is not in compiled memory has to publish, ``ahead_s`` beyond it."""
    if now.aided is not None:
        ahead_s += now.aided.imu_lag_s
    moved = motion(now.filter, now.rate_rad_s, ahead_s)
    if now.seen is None:
        reference = settings.reference
        sigma = at_most_half_turn(at_least(2.0 * asin(sqrt(now.smooth_error))))
        return moved, (reference.s_gravity, reference.s_magnetic, sigma, sigma, True)
    if now.aided is not None:
        return moved, aided_figures(now.aided)
    return moved, conditioned_figures(now.seen)
