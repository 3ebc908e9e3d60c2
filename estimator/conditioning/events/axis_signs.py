"""A gyroscope's axis that is at fault: the field turns in G as that axis' error would turn it.

An axis that is stuck, stepped, scaled or saturated turns the field of the place in G about that
axis, and gravity with it, for as long as the fault lasts. The turn of a second is compared with all
that turns a field in G beside that: noise, turns missed between samples, a magnet, which changes
the norm, too, and the share of its turns by which a vehicle takes the field along: one that is
late, has iron or stands turned in it. That share is learnt. A field that leaps, faster than a
vehicle turns, has to show it anew. How well the force fits is the rest of the evidence.
"""

from math import exp, pi
from typing import NamedTuple

from estimator.bounds import TINY
from estimator.compilation.compiled import inlined
from estimator.conditioning.events.jump_signs import JumpSigns
from estimator.conditioning.field.magnetic import NORM_SCALE
from estimator.conditioning.params import FAR, LATELY_S, LONG_S, QUICK_S, REACH, SPAN_S
from estimator.conditioning.vertical.gravity import GravityState
from estimator.conditioning.vertical.lowpass import approach
from estimator.conditioning.vertical.step import VerticalStep
from estimator.conditioning.vertical.stillness import LEAST_DIRECTION_RAD
from estimator.conditioning.vertical.tilt import LEAST_OFF_RAD
from estimator.geometry.axes import axes_of, to_frame
from estimator.geometry.quaternion import add, cross, dot, scale, square, subtract, unit
from estimator.types import ZERO_VEC3, Vec3

# A field is expected to go along with all of a turn until it has not gone along with turns of this
# mean square in a second, rad^2: a compass that is turned in the vehicle goes along with tilts, one
# that is frozen with any turn, and iron that has just come with a part of each.
UNPROVEN_S = 0.05**2 * SPAN_S


class AxisSigns(NamedTuple):
    """What the field in G shows about the gyroscope's axes; an error above 0 reads too much."""

    slow: Vec3 = ZERO_VEC3  # mean direction of the field in G
    slower: Vec3 = ZERO_VEC3  # mean of that, over the time that gravity is averaged
    turned: Vec3 = ZERO_VEC3  # turn by the gyroscope while the mean was taken, rad, in G
    unseen: float = 0.0  # variance of the turns missed meanwhile, rad^2
    moves: float = UNPROVEN_S  # sum of the squares by which the field has left its mean, rad^2 s
    turns: float = UNPROVEN_S  # of those of the turns, which it may have gone along with
    by_noise: float = 1.0  # measured over expected square of what all else does to the field
    age_s: float = 0.0  # since the first field
    squares: Vec3 = ZERO_VEC3  # squared error of each axis that explains the field, (rad/s)^2
    since_s: float = LATELY_S  # since any was contradicted, up to this time
    errors: Vec3 = ZERO_VEC3  # largest lately of each axis, times its likelihood; fading, rad/s
    # both, were the field known to go along with no turn
    fixed_since_s: float = LATELY_S
    fixed_errors: Vec3 = ZERO_VEC3


class Seen(NamedTuple):
    """The field in G."""

    y: Vec3  # its direction
    moved: Vec3  # by how much that has left its mean
    by_turning: float  # variance of that by what goes along with the vehicle, rad^2
    by_iron: float  # what iron would make of that at least
    by_noise: float  # by all else


class Suspect(NamedTuple):
    """One axis' case."""

    rate_rad_s: float  # the error that would explain the field's turn
    by_force: float  # evidence for it by the force: twice the logarithm of a likelihood ratio or so
    ratio: float  # the same by the field: square of its turn over the variance of that
    fixed_ratio: float  # the same, were it known to go along with no turn: never below ``ratio``


@inlined
def carry_axes(state: AxisSigns, vertical: VerticalStep, dt_s: float) -> AxisSigns:
    """One learning step of the gyroscope, with or without a field."""
    keep, fade = SPAN_S / (SPAN_S + dt_s), LATELY_S / (LATELY_S + dt_s)
    turn_g = scale(dt_s, to_frame(axes_of(vertical.mean.q_g_frd), vertical.rate))
    return state._replace(
        turned=scale(keep, add(state.turned, turn_g)),
        unseen=keep * keep * state.unseen + vertical.aliasing,
        squares=scale(fade, state.squares),
        since_s=min(state.since_s + dt_s, LATELY_S),
        errors=scale(fade, state.errors),
        fixed_since_s=min(state.fixed_since_s + dt_s, LATELY_S),
        fixed_errors=scale(fade, state.fixed_errors),
    )


@inlined
def watch_axes(
    state: AxisSigns,
    vertical: VerticalStep,
    jump: JumpSigns,
    usual_norm: float,
    force_scatter: float,
    dt_s: float,
) -> AxisSigns:
    """Compare the field with its mean, ``dt_s`` after the field before.

    ``usual_norm`` is that of the place's field, ``force_scatter`` as in
    :class:`~estimator.conditioning.events.turn_signs.GravitySigns`.
    """
    if usual_norm <= 0.0 or square(jump.quick) <= 0.0:
        return state
    y = unit(jump.quick)
    if jump.since_leap_s < QUICK_S:
        return state._replace(slow=y, slower=y, moves=UNPROVEN_S, turns=UNPROVEN_S, age_s=dt_s)
    age_s = min(state.age_s + dt_s, LONG_S)
    share = max(dt_s / (SPAN_S + dt_s), dt_s / age_s)
    slower_share = max(vertical.state.coefficients.gravity_share, dt_s / age_s)
    slow = approach(state.slow, y, share)
    state = state._replace(
        slow=slow, slower=approach(state.slower, slow, slower_share), age_s=age_s
    )
    along = jump.quick_norm / usual_norm - 1.0
    span_s, bias = min(SPAN_S, age_s), vertical.state.estimate.covariance
    noise = LEAST_DIRECTION_RAD**2 + along * along + state.unseen
    noise += max(bias[0], bias[4], bias[7]) * span_s * span_s
    seen = Seen(
        y=y,
        moved=moved_beyond_bias(state, vertical, y),
        by_turning=taken_along(state, vertical.state.gravity, jump.since_leap_s),
        by_iron=min(state.moves / state.turns, NORM_SCALE**2) * square(state.turned),
        by_noise=state.by_noise * noise,
    )
    cases = (
        suspect(state, vertical, (1.0, 0.0, 0.0), seen, force_scatter),
        suspect(state, vertical, (0.0, 1.0, 0.0), seen, force_scatter),
        suspect(state, vertical, (0.0, 0.0, 1.0), seen, force_scatter),
    )
    return judge(state, seen, cases, dt_s)


@inlined
def taken_along(state: AxisSigns, gravity: GravityState, since_leap_s: float) -> float:
    """Variance (rad^2) by which turning may have moved the field in G.

    Of a turn about the vertical only iron takes it along. That is little unless it has just come,
    or more was measured.
    """
    share, down = state.moves / state.turns, gravity.force.down.value
    about_down = dot(state.turned, down) ** 2 / max(square(down), TINY)
    by_iron = share
    if since_leap_s >= LONG_S:
        measured = (state.moves - UNPROVEN_S) / (state.turns + LATELY_S)
        by_iron = min(share, max(NORM_SCALE**2, measured))
    return share * max(0.0, square(state.turned) - about_down) + by_iron * about_down


@inlined
def moved_beyond_bias(state: AxisSigns, vertical: VerticalStep, y: Vec3) -> Vec3:
    """How far the field has left its mean in G, less what a wrong bias may have done.

    G is free of the bias that is believed: it may be any between that and none.
    """
    believed_g = to_frame(axes_of(vertical.mean.q_g_frd), vertical.state.estimate.bias_rad_s)
    by_bias = scale(min(SPAN_S, state.age_s), cross(y, believed_g))
    moved = subtract(y, state.slow)
    share = max(0.0, min(1.0, dot(moved, by_bias) / max(square(by_bias), 1e-12)))
    return subtract(moved, scale(share, by_bias))


@inlined
def suspect(
    state: AxisSigns, vertical: VerticalStep, axis: Vec3, field: Seen, force_scatter: float
) -> Suspect:
    """The case against an ``axis`` of the body: a turn t about it, a in G, moves y by t a x y."""
    a = to_frame(axes_of(vertical.mean.q_g_frd), axis)
    d = cross(a, field.y)
    shown = max(square(d), 1e-9)
    turn = dot(field.moved, d) / shown
    later = dot(subtract(state.slow, state.slower), d) / shown
    by_force = force_evidence(vertical.state.gravity, a, later, force_scatter)
    # gravity that has turned alike goes along with no vehicle, but iron may do so
    by_turning = field.by_iron if by_force >= REACH * REACH else field.by_turning
    return Suspect(
        rate_rad_s=turn / min(SPAN_S, state.age_s),
        by_force=by_force,
        ratio=turn * turn * shown / (by_turning + field.by_noise),
        fixed_ratio=turn * turn * shown / field.by_noise,
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
def judge(
    state: AxisSigns, field: Seen, cases: tuple[Suspect, Suspect, Suspect], dt_s: float
) -> AxisSigns:
    """What the cases show of each axis, and of how a field moves.

    A ratio of up to twice the usual one teaches what is usual, each cause in proportion.
    """
    a, b, c = cases
    ratio = max(0.0, a.ratio, b.ratio, c.ratio)
    least, share = most_evidence(cases) - FAR, dt_s / (SPAN_S + dt_s)
    since_s, errors = likely_errors(state.since_s, state.errors, cases)
    # the cases, were the field known to go along with no turn
    fixed = (
        a._replace(ratio=a.fixed_ratio),
        b._replace(ratio=b.fixed_ratio),
        c._replace(ratio=c.fixed_ratio),
    )
    fixed_since_s, fixed_errors = likely_errors(state.fixed_since_s, state.fixed_errors, fixed)
    variance = field.by_turning + field.by_noise
    quiet = field.by_noise / variance
    learn = dt_s / (state.age_s + dt_s) * (min(ratio, 2.0) - 1.0)
    keep = LONG_S / (LONG_S + dt_s)
    moves = min(square(field.moved), 2.0 * variance) - field.by_noise
    turns = max(1e-12, keep * (state.turns + dt_s * square(state.turned)))
    return state._replace(
        # a field goes along by twice the turn at most
        moves=min(keep * (state.moves + dt_s * max(0.0, moves)), 4.0 * turns),
        turns=turns,
        by_noise=max(1.0, state.by_noise * (1.0 + learn * quiet)),
        squares=(
            suspicion(state.squares[0], a, least, share),
            suspicion(state.squares[1], b, least, share),
            suspicion(state.squares[2], c, least, share),
        ),
        since_s=since_s,
        errors=errors,
        fixed_since_s=fixed_since_s,
        fixed_errors=fixed_errors,
    )


@inlined
def most_evidence(cases: tuple[Suspect, Suspect, Suspect]) -> float:
    """That of the best case against an axis, by field and force together."""
    a, b, c = cases
    return max(0.0, a.ratio + a.by_force, b.ratio + b.by_force, c.ratio + c.by_force)


@inlined
def likely_errors(
    since_s: float, errors: Vec3, cases: tuple[Suspect, Suspect, Suspect]
) -> tuple[float, Vec3]:
    """While a case is strong, each axis has its error times its likelihood beside the best case.

    Axes that field and force cannot distinguish have equal shares. ``since_s`` is 0 then.
    """
    most = most_evidence(cases)
    (x, y, z), least = errors, most - FAR
    if is_strong(cases[0], least) or is_strong(cases[1], least) or is_strong(cases[2], least):
        since_s = 0.0
        x = larger_error(x, cases[0], most)
        y = larger_error(y, cases[1], most)
        z = larger_error(z, cases[2], most)
    return since_s, (x, y, z)


@inlined
def larger_error(before: float, case: Suspect, most: float) -> float:
    """The error of an axis, rad/s, times its likelihood ratio to the one of ``most`` evidence.

    The one ``before`` stays if it is farther off 0. The field shows hardly anything of a turn about
    itself: half a turn in a second is the most.
    """
    rate_rad_s = max(-pi / SPAN_S, min(case.rate_rad_s, pi / SPAN_S))
    now = exp(0.5 * (case.ratio + case.by_force - most)) * rate_rad_s
    return before if abs(before) > abs(now) else now


@inlined
def suspicion(before: float, case: Suspect, least: float, share: float) -> float:
    """The squared error of an axis, (rad/s)^2, which rises while the case is strong."""
    now = case.rate_rad_s * case.rate_rad_s
    rises = now > before and is_strong(case, least)
    return before + share * (now - before) if rises else before


@inlined
def is_strong(case: Suspect, least: float) -> bool:
    """Whether field and force contradict an axis, with evidence beyond what another's leaves.

    A magnet may turn the field by any angle, so that the force must not contradict the axis: by
    less than a standard deviation it may do so by chance.
    """
    return case.ratio > FAR and case.ratio + case.by_force > least and case.by_force > -1.0


@inlined
def current_errors(state: AxisSigns, is_proven: bool) -> Vec3:
    """The errors of axes, rad/s, if any was contradicted within a second; otherwise 0.

    Once velocity has confirmed the compass' heading (``is_proven``), the field is known to go along
    with no turn, so that less contradicts an axis.
    """
    if is_proven and state.fixed_since_s < SPAN_S:
        return state.fixed_errors
    return state.errors if state.since_s < SPAN_S else ZERO_VEC3
