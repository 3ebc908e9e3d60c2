"""A gyroscope's axis that is at fault: the field turns in G as that axis' error would turn it.

In G, which the gyroscope carries along, the field of the place stands still. An axis that is
stuck, stepped, scaled or saturated turns it about that axis, and gravity with it, for as long as
the fault lasts. The turn of a second is compared with all that turns a field in G beside that:
noise, what an unknown lag and own field make of turning, turns missed between samples and a
magnet, which changes the norm, too. How large the ratio of the two squares usually is, is learnt:
a field is as calm as it is. How much better or worse the force fits is the rest of the evidence.
"""

from typing import NamedTuple

from estimator.compilation.compiled import inlined, replacer
from estimator.conditioning.events.jump_signs import JumpSigns
from estimator.conditioning.field.calibration import Calibration
from estimator.conditioning.field.magnetic import NORM_SCALE
from estimator.conditioning.params import LATELY_S, LONG_S, SPAN_S
from estimator.conditioning.robust import FAR
from estimator.conditioning.vertical.gravity import GravityState
from estimator.conditioning.vertical.lowpass import approach
from estimator.conditioning.vertical.step import VerticalStep
from estimator.conditioning.vertical.stillness import LEAST_DIRECTION_RAD
from estimator.conditioning.vertical.tilt import LEAST_OFF_RAD
from estimator.geometry.axes import FrameAxes, axes_of, to_body, to_frame
from estimator.geometry.quaternion import add, cross, dot, scale, square, subtract, unit
from estimator.types import ZERO_VEC3, Vec3


class AxisSigns(NamedTuple):
    """What the field in G shows about the gyroscope's axes."""

    slow: Vec3 = ZERO_VEC3  # mean direction of the field in G
    slower: Vec3 = ZERO_VEC3  # mean of that, over the time that gravity is averaged
    turning: Vec3 = ZERO_VEC3  # mean of (R w) x that direction, 1/s: what a lag makes of turning
    turned: Vec3 = ZERO_VEC3  # turn by the gyroscope while the mean was taken, rad, in G
    unseen: float = 0.0  # variance of the turns missed meanwhile, rad^2
    by_turning: float = 1.0  # measured over expected square of what turning does to the field,
    by_noise: float = 1.0  # and of all else
    age_s: float = 0.0  # since the first field
    squares: Vec3 = ZERO_VEC3  # squared error of each axis that explains the field, (rad/s)^2
    since_s: float = LATELY_S  # since any was contradicted, up to this time


class Seen(NamedTuple):
    """The field in G."""

    y: Vec3  # its direction
    moved: Vec3  # by how much that has left its mean
    lag: Vec3  # what a second's lag would have made of the turning
    noise: float  # variance, rad^2


class Suspect(NamedTuple):
    """One axis' case."""

    rate_rad_s: float  # the error that would explain the field's turn
    evidence: float  # for it against none, twice the logarithm of the likelihood ratio or so
    by_force: float  # the part of it that the force shows
    ratio: float  # square of the field's turn over its variance
    turning_share: float  # of that variance, by turning


with_means = replacer(AxisSigns, "slow", "slower", "turning", "age_s")
with_judged = replacer(AxisSigns, "by_turning", "by_noise", "squares", "since_s")
with_motion = replacer(AxisSigns, "turned", "unseen", "squares", "since_s")


@inlined
def carry_axes(state: AxisSigns, vertical: VerticalStep, dt_s: float) -> AxisSigns:
    """One learning step of the gyroscope, with or without a field."""
    keep = SPAN_S / (SPAN_S + dt_s)
    q = vertical.state.gravity.q_g_frd
    turn_g = scale(dt_s, to_frame(axes_of(q), vertical.rate))
    turned = scale(keep, add(state.turned, turn_g))
    unseen = keep * keep * state.unseen + vertical.aliasing
    squares = scale(LATELY_S / (LATELY_S + dt_s), state.squares)
    return with_motion(state, turned, unseen, squares, min(state.since_s + dt_s, LATELY_S))


@inlined
def watch_axes(
    state: AxisSigns,
    vertical: VerticalStep,
    jump: JumpSigns,
    learnt: Calibration,
    usual_norm: float,
    force_scatter: float,
    dt_s: float,
) -> AxisSigns:
    """Compare the field with its mean, ``dt_s`` after the field before.

    ``usual_norm`` is that of the place's field, ``force_scatter`` as in
    :class:`~estimator.conditioning.events.lasting_signs.GravitySigns`.
    """
    if usual_norm <= 0.0 or square(jump.quick) <= 0.0:
        return state
    axes = axes_of(vertical.state.gravity.q_g_frd)
    y = unit(jump.quick)
    x = cross(to_frame(axes, vertical.rate), y)
    age_s = min(state.age_s + dt_s, LONG_S)
    share = max(dt_s / (SPAN_S + dt_s), dt_s / age_s)
    slower_share = max(vertical.state.coefficients.gravity_share, dt_s / age_s)
    state = with_means(
        state,
        approach(state.slow, y, share),
        approach(state.slower, state.slow, slower_share),
        approach(state.turning, x, share),
        age_s,
    )
    along = jump.quick_norm / usual_norm - 1.0
    noise = LEAST_DIRECTION_RAD**2 + along * along
    seen = Seen(y, moved_beyond_bias(state, vertical, axes, y), subtract(x, state.turning), noise)
    cases = (
        suspect(state, vertical, learnt, (1.0, 0.0, 0.0), seen, force_scatter),
        suspect(state, vertical, learnt, (0.0, 1.0, 0.0), seen, force_scatter),
        suspect(state, vertical, learnt, (0.0, 0.0, 1.0), seen, force_scatter),
    )
    return judge(state, cases, dt_s)


@inlined
def moved_beyond_bias(state: AxisSigns, vertical: VerticalStep, axes: FrameAxes, y: Vec3) -> Vec3:
    """How far the field has left its mean in G, less what a wrong bias may have done.

    G is free of the bias that is believed: it may be any between that and none.
    """
    believed = vertical.state.estimate.bias_rad_s
    by_bias = scale(min(SPAN_S, state.age_s), cross(y, to_frame(axes, believed)))
    moved = subtract(y, state.slow)
    share = max(0.0, min(1.0, dot(moved, by_bias) / max(square(by_bias), 1e-12)))
    return subtract(moved, scale(share, by_bias))


@inlined
def suspect(
    state: AxisSigns,
    vertical: VerticalStep,
    learnt: Calibration,
    axis: Vec3,
    field: Seen,
    force_scatter: float,
) -> Suspect:
    """The case against one ``axis`` of the body.

    A turn t about the axis a moves y by t a x y. The own field o, seen from G, moves by
    turned x R o, a field that is late by ``lag`` times that.
    """
    axes, (y, moved, lag, noise) = axes_of(vertical.state.gravity.q_g_frd), field
    a = to_frame(axes, axis)
    d = cross(a, y)
    shown = max(square(d), 1e-9)
    p = learnt.covariance
    own = to_body(axes, cross(d, state.turned))
    own_variance = (
        own[0] * (own[0] * p[0] + 2.0 * (own[1] * p[1] + own[2] * p[2]))
        + own[1] * (own[1] * p[4] + 2.0 * own[2] * p[5])
        + own[2] * own[2] * p[7]
    )
    own_variance *= min(1.0, 3.0 * NORM_SCALE**2 / max(p[0] + p[4] + p[7], 1e-12))
    by_turning = (own_variance + dot(d, lag) ** 2 * p[9]) / (shown * shown)
    span_s = min(SPAN_S, state.age_s)
    estimate = vertical.state.estimate
    bias_variance = max(estimate.covariance[0], estimate.covariance[4], estimate.covariance[7])
    by_noise = (noise + bias_variance * span_s * span_s + state.unseen) / shown
    variance = state.by_turning * by_turning + state.by_noise * by_noise
    turn = dot(moved, d) / shown
    rate_rad_s, ratio = turn / span_s, turn * turn / variance
    later = dot(subtract(state.slow, state.slower), d) / shown
    by_force = force_evidence(vertical.state.gravity, a, later, force_scatter)
    return Suspect(
        rate_rad_s=rate_rad_s,
        evidence=ratio + by_force,
        by_force=by_force,
        ratio=ratio,
        turning_share=state.by_turning * by_turning / variance,
    )


@inlined
def force_evidence(gravity: GravityState, a: Vec3, turn: float, force_scatter: float) -> float:
    """How much better the force fits if gravity turns about a (G) as the field; below 0: worse.

    ``turn`` (rad) is that by which the field's quicker mean is ahead of its slower one. Those of
    the force lie as far apart; how far they usually do is ``force_scatter`` (rad^2).
    """
    force = gravity.force
    if square(force.quick) <= 0.0 or square(force.down.value) <= 0.0:
        return 0.0
    down = unit(force.down.value)
    d = cross(a, down)
    ahead = dot(subtract(unit(force.quick), down), d)
    return turn * (2.0 * ahead - turn * square(d)) / (force_scatter + LEAST_OFF_RAD**2)


@inlined
def judge(state: AxisSigns, cases: tuple[Suspect, Suspect, Suspect], dt_s: float) -> AxisSigns:
    """An axis is suspected if its case is strong, and no other's is stronger by as much.

    Axes that field and force cannot distinguish are suspected alike. A ratio of up to twice the
    usual one teaches what is usual, and each cause in proportion.
    """
    most, ratio, turning = 0.0, 0.0, 0.0
    for case in cases:
        most = max(most, case.evidence)
        if case.ratio > ratio:
            ratio, turning = case.ratio, case.turning_share
    x, y, z = state.squares
    least, share = most - FAR, dt_s / (SPAN_S + dt_s)
    squares = (
        suspicion(x, cases[0], least, share),
        suspicion(y, cases[1], least, share),
        suspicion(z, cases[2], least, share),
    )
    since_s = state.since_s
    if is_strong(cases[0], least) or is_strong(cases[1], least) or is_strong(cases[2], least):
        since_s = 0.0
    learn = dt_s / (state.age_s + dt_s) * (min(ratio, 2.0) - 1.0)
    return with_judged(
        state,
        state.by_turning * (1.0 + learn * turning),
        max(1.0, state.by_noise * (1.0 + learn * (1.0 - turning))),
        squares,
        since_s,
    )


@inlined
def suspicion(before: float, case: Suspect, least: float, share: float) -> float:
    """The squared error of an axis, (rad/s)^2, which rises while the case is strong."""
    now = case.rate_rad_s * case.rate_rad_s
    rises = now > before and is_strong(case, least)
    return before + share * (now - before) if rises else before


@inlined
def is_strong(case: Suspect, least: float) -> bool:
    """Whether an axis is contradicted, and its evidence beyond what another's leaves.

    A magnet may turn the field by any angle, so that the force must not contradict the axis: by
    less than a standard deviation it may do so by chance.
    """
    return case.ratio > FAR and case.by_force > -1.0 and case.evidence > least
