"""What is read out of a state to be published: the motion, and how well it is known.

Compiled code returns plain tuples several times as fast as named ones.

Raw vectors may pull the heading away from the gyroscope. A magnet that comes slowly leaves e small,
because the filter follows it, turning against the gyroscope less its earlier bias. Either may be
wrong, so the angle between them counts as an error of the heading.
"""

from math import asin, atan2, hypot, pi, radians, sqrt
from typing import Any, NamedTuple

from estimator.aiding.consistency import inflated, inflation
from estimator.aiding.correction_cusum import with_unexpected_turn
from estimator.aiding.search import UNKNOWN_RAD
from estimator.aiding.uncertainty import with_dip_error
from estimator.compilation.compiled import inlined, shared
from estimator.conditioning.field.step import wrap_angle
from estimator.conditioning.params import USUAL_S
from estimator.conditioning.vertical.lowpass import approach
from estimator.filter.types import FilterState
from estimator.geometry.quaternion import (
    conjugate,
    exp,
    multiply,
    norm,
    normalize,
    scale,
    subtract,
)
from estimator.live.aided import GRAVITY_HALF_RAD, MAGNETIC_HALF_RAD, confidence
from estimator.live.situation import RAW, mounted_rad, standing_at, unshown_iron
from estimator.types import IDENTITY, ZERO_VEC3, Quaternion, Vec3


class Pull(NamedTuple):
    """What is remembered of the corrections for ``USUAL_S``."""

    heading_rad: float = 0.0  # turned by the vectors, forgotten by and by
    bias_rad_s: Vec3 = ZERO_VEC3  # mean of the filter's: not yet what a magnet makes of it
    seen_s: float = 0.0  # what that is the mean of


NO_PULL = Pull()


@inlined
def pulled(
    pull: Pull, before: Quaternion, state: FilterState, gyr_rad_s: Vec3, error: float, dt_s: float
) -> Pull:
    """The pull with one more sample, from the attitude ``before`` it to that of ``state``.

    ``error`` is the mean e, by which sigma is 2 asin(sqrt(e)). A correction that sigma predicts, as
    after a wrong start, does not point to a magnet: it counts by its cosine, 1 - 2 e.
    """
    seen_s = min(pull.seen_s + dt_s, USUAL_S)
    bias = approach(pull.bias_rad_s, state.gyr_bias_rad_s, dt_s / seen_s)
    alone = multiply(before, exp(scale(dt_s, subtract(gyr_rad_s, bias))))
    turn_ned = multiply(state.q_ned_frd, conjugate(alone))
    turned = wrap_angle(2.0 * atan2(turn_ned[3], turn_ned[0]))
    weight = max(0.0, 1.0 - 2.0 * error)
    kept = USUAL_S / (USUAL_S + dt_s)
    return Pull(kept * (pull.heading_rad + weight * turned), bias, seen_s)


# No estimate from these sensors is better than this; it also keeps sigma above zero.
LEAST_SIGMA_RAD = radians(0.1)
# Half of a turn that goes on for so long unseen may not have happened.
STEADY_TURN_S = 0.1

# Confidences of gravity and field, sigmas (rad) of inclination and heading.
Figures = tuple[float, float, float, float]
# Time (us), attitude, rate free of bias, bias, e, its rate, K, the figures, and the place in
# ``NORTHS`` of what the heading is measured from.
Published = tuple[int, Quaternion, Vec3, Vec3, float, float, float, float, float, float, float, int]
NOTHING_PUBLISHED: Published = (-1, IDENTITY, ZERO_VEC3, ZERO_VEC3, *(0.0,) * 7, 0)

# Longest propagation beyond the last sample, s: later its rate shows nothing of the vehicle.
OUTPUT_HORIZON_S = 1.0


@shared
def published_by(handle: Any, time_us: int, is_aided: bool) -> Published:
    """The output at a time, propagated from the last sample if that is before it.

    The vehicle may have stopped turning: the unseen share of the turn since then, which widens the
    sigmas, grows from none to all.
    """
    now, state = handle.now, handle.filter
    known_s = min(max(1e-6 * (time_us - handle.time_us), 0.0), OUTPUT_HORIZON_S)
    ahead_s = known_s
    error, error_rate_1_s = state.error, state.error_rate_1_s
    if is_aided:
        error, error_rate_1_s = handle.consistency.error, handle.consistency.error_rate_1_s
        gravity, magnetic, inclination, heading = aided_figures(handle)
        ahead_s += handle.aided.estimate.imu_lag_s  # the samples are that old
    elif now.source != RAW:
        gravity, magnetic, inclination, heading = conditioned_figures(handle)
    else:
        gravity, magnetic, inclination, heading = raw_figures(handle)
    q, rate_rad_s = state.q_ned_frd, subtract(handle.sample.gyr_rad_s, state.gyr_bias_rad_s)
    if ahead_s != 0.0:
        q = normalize(multiply(q, exp(scale(ahead_s, rate_rad_s))))
    if known_s > 0.0:
        unseen = norm(rate_rad_s) * known_s * known_s / (known_s + STEADY_TURN_S)
        inclination = at_most_half_turn(sqrt(inclination * inclination + unseen * unseen))
        heading = at_most_half_turn(sqrt(heading * heading + unseen * unseen))
    moved = (q, rate_rad_s, state.gyr_bias_rad_s, error, error_rate_1_s, state.gain)
    north = now.north if handle.seen.has_heading else now.north_without
    return (time_us, *moved, gravity, magnetic, inclination, heading, north)


@inlined
def raw_figures(handle: Any) -> Figures:
    """What raw vectors show about themselves: their mean e is sin^2 of half an angle."""
    reference, pulled_rad = handle.params.reference, handle.pull.heading_rad
    sigma = at_most_half_turn(at_least(2.0 * asin(sqrt(handle.smooth_error))))
    heading = at_most_half_turn(sqrt(sigma * sigma + pulled_rad * pulled_rad))
    return reference.s_gravity, reference.s_magnetic, sigma, heading


@inlined
def conditioned_figures(handle: Any) -> Figures:
    """What the conditioning stage knows about confidence and heading.

    Iron that nothing has shown adds at most ``UNKNOWN_RAD`` to the heading's sigma.
    """
    seen, params, memory = handle.seen, handle.params, handle.conditioning
    standing = standing_at(handle.now, handle.time_us)
    iron_rad = unshown_iron(params.conditioning, memory, params.reference.place_gauss, standing)
    heading_rad = at_least(seen.sigma_heading_rad)
    return (
        seen.gravity_confidence,
        seen.magnetic_confidence,
        at_least(seen.sigma_inclination_rad),
        min(pi, hypot(heading_rad, iron_rad), max(heading_rad, UNKNOWN_RAD)),
    )


@inlined
def aided_figures(handle: Any) -> Figures:
    """What the velocity aiding knows, widened by what contradicts it and by a turned compass."""
    params, aided, P = handle.params, handle.aided, handle.covariance
    sigma, consistency = aided.sigma, handle.consistency
    wide = with_unexpected_turn(inflated(sigma, consistency), aided.correction_cusum, P)
    wide = with_dip_error(params.aiding, wide, aided.field, params.reference.place_gauss, P)
    # What has turned the vertical may have turned the heading as far. Only published: a velocity
    # that is wrong may have done it, so that no attitude is given up for it.
    heading_rad = hypot(wide.heading_rad, sqrt(inflation(consistency.tilt)))
    return (
        confidence(sigma.inclination_rad, GRAVITY_HALF_RAD),
        confidence(sigma.heading_rad, MAGNETIC_HALF_RAD),
        at_most_half_turn(at_least(wide.inclination_rad)),
        at_most_half_turn(at_least(hypot(heading_rad, mounted_rad(handle.now.standing)))),
    )


@inlined
def write(row: Any, output: Published, is_aided: bool) -> None:
    """All of it as a row, in the order of the columns of :mod:`estimator.live.rows`."""
    (_, q, rate, bias), numbers, north = output[:4], output[4:11], output[11]
    for i in range(4):
        row[i] = q[i]
    for i in range(3):
        row[4 + i] = rate[i]
        row[7 + i] = bias[i]
    for i in range(7):
        row[10 + i] = numbers[i]
    row[17], row[18] = north, 1.0 if is_aided else 0.0


@inlined
def at_least(sigma_rad: float) -> float:
    """A sigma that is not too good to be true; one that is not a number stays so."""
    return max(sigma_rad, LEAST_SIGMA_RAD)


@inlined
def at_most_half_turn(sigma_rad: float) -> float:
    """No angle is further off."""
    return min(sigma_rad, pi)
