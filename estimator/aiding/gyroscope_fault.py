"""An axis of the gyroscope at fault while velocity helps: its error is tracked as a bias.

Field and force show which axis they contradict, and by how much. A compass that is frozen or beside
iron contradicts a sound axis, so velocity must confirm it: an axis that reads too much turns the
attitude, and the force seen through that gains a velocity that no report shows.
"""

from math import copysign

import numpy as np

from estimator.aiding.covariance import rotation_matrix
from estimator.aiding.inertial import Prediction
from estimator.aiding.types import GYR_BIAS, SIZE, TURN, AidingParams, AidingState, GyroscopeFault
from estimator.bounds import TINY
from estimator.compilation.compiled import inlined
from estimator.conditioning.params import FAR, LATELY_S, SPAN_S
from estimator.geometry.quaternion import add, cross, dot, norm, rotate, scale
from estimator.types import STANDARD_GRAVITY_M_S2, Vec3


@inlined
def watch_gyroscope(state: AidingState, gyr_errors: Vec3, dt: float) -> GyroscopeFault:
    """The state one step of ``dt`` later.

    ``gyr_errors`` (rad/s, by field and force) count once one of them explains the reports of a
    second. The others may be as likely.
    """
    fault, keep = state.gyroscope_fault, SPAN_S / (SPAN_S + dt)
    innovations, variance = scale(keep, fault.innovations), keep * keep * fault.variance
    for agreement in (state.agreement.by_filter, state.agreement.by_receiver):
        if agreement.wait_s <= 0.0:
            usual = (
                max(1.0, agreement.scatter.innovation) ** -0.5
            )  # sigmas as they have been lately
            innovations = add(innovations, scale(usual, agreement.scatter.latest))
            variance += 1.0
    x, y, z = scale(LATELY_S / (LATELY_S + dt), fault.squares)
    fault = GyroscopeFault(innovations, variance, (x, y, z))
    a, b, c = gyr_errors
    by_x = evidence(state, fault, (1.0, 0.0, 0.0), a)
    by_y = evidence(state, fault, (0.0, 1.0, 0.0), b)
    by_z = evidence(state, fault, (0.0, 0.0, 1.0), c)
    if max(by_x, by_y, by_z) <= FAR:
        return fault
    return GyroscopeFault(innovations, variance, (max(x, a * a), max(y, b * b), max(z, c * c)))


@inlined
def evidence(state: AidingState, fault: GyroscopeFault, axis: Vec3, error_rad_s: float) -> float:
    """Square of the sum of innovations that an axis' error explains, over its variance.

    Turned with the attitude about the axis a, the force f gains a velocity along a x f. The nearer
    the force is to that axis, the less an error shows.
    """
    if abs(error_rad_s) <= 0.0:
        return 0.0
    force = state.last.force_ned_m_s2
    gained = cross(rotate(state.estimate.q_ned_frd, axis), force)
    size = max(norm(gained), STANDARD_GRAVITY_M_S2)
    explained = max(0.0, copysign(1.0, error_rad_s) * -dot(fault.innovations, gained) / size)
    return explained * explained / max(fault.variance, TINY)


@inlined
def track_errors(
    params: AidingParams, now: Prediction, before: GyroscopeFault, fault: GyroscopeFault
) -> None:
    """Make each bias as uncertain as its axis' error, in place, if one is beyond usual biases.

    What is found of an error has turned the attitude about its axis for a second already. Bias and
    turn become uncertain together, so that to correct one corrects the other.
    """
    P, squares = now.covariance, fault.squares
    if max(squares[0], squares[1], squares[2]) <= params.gyr_bias_sigma**2:
        return
    R = rotation_matrix(now.estimate.q_ned_frd)
    for k in range(3):
        found = squares[k] - before.squares[k]
        if found > 0.0:
            errors = np.zeros(SIZE)  # what 1 rad/s makes
            errors[GYR_BIAS + k] = 1.0
            for i in range(3):
                errors[TURN + i] = -SPAN_S * R[i, k]
            P += found * np.outer(errors, errors)
        P[GYR_BIAS + k, GYR_BIAS + k] = max(P[GYR_BIAS + k, GYR_BIAS + k], squares[k])
