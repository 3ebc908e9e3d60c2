"""For how long the force is averaged for the vertical, and how far off its mean then is.

Accelerations fall in a longer mean, but the gyroscope lets frame G drift meanwhile. Means over
windows an octave apart show how the force turns at each scale: Allan's variance, half the mean
square of the turn from each window to the next. A gyroscope errs by no more than a share of the
turn that it sees, and the rest has been an acceleration. A mean over a window T is off by all
accelerations that last as long or longer, V(T) = A(T)/2 + A(2T)/2 + A(4T)/2 + ..., and by half of
the drift in it. The averaging time is where their sum is lowest, and the sum goes into sigma.
Source: Percival and Walden 2000, doi 10.1017/CBO9780511841040 (Haar's wavelets).
"""

from math import ceil, log2, sqrt
from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.conditioning.params import LONG_S, ConditioningParams
from estimator.conditioning.rate import MOST_ERROR
from estimator.geometry.quaternion import add, dot, scale, square
from estimator.types import ZERO_VEC3, Vec3

# The shortest window (s), which is the shortest time constant, too; each octave's is twice as long.
WINDOW_S = 0.25
OCTAVES = ceil(log2(LONG_S / WINDOW_S))
# The low-pass's time constant, over the length of the windows whose means are as good.
TAU_SHARE = 0.27
# After so many windows an octave counts as much as the one below.
PRIOR_WINDOWS = 0.5
# The accelerometer's own error (rad^2), which distinguishes no windows, and the first estimate.
LEAST_VARIANCE = 0.014**2


class Octave(NamedTuple):
    """Windows of one length."""

    mean: Vec3 = ZERO_VEC3  # minus the specific force in G, mean of the last one, m/s^2
    turn: Vec3 = ZERO_VEC3  # of the body in the last one, in G, rad
    apart: float = 0.0  # half the mean square turn of the force from each to the next, rad^2
    turning: float = 0.0  # mean square of ``turn``, rad^2


Octaves = tuple[Octave, Octave, Octave, Octave, Octave, Octave, Octave, Octave, Octave]


class Averaging(NamedTuple):
    """How the mean force turns at all lengths of windows, and what follows from that."""

    octaves: Octaves = (Octave(),) * 9
    windows: int = 0  # how many of the shortest length there have been
    moved_s: float = 0.0  # what they stand for, as far as it is remembered
    force: Vec3 = ZERO_VEC3  # of the present one, m/s
    turn: Vec3 = ZERO_VEC3  # in the present one, rad
    time_s: float = 0.0  # so far of it
    factor: float = 1.0  # of ``gravity_tau_s``
    variance: float = LEAST_VARIANCE  # of the mean force's direction, rad^2
    share: float = 0.0  # of it where the field is levelled; large if the profile's time is bad


NOTHING_SEEN = Octave(apart=LEAST_VARIANCE)


@inlined
def put(octaves: Octaves, k: int, new: Octave) -> Octaves:
    """The octaves with another one at ``k``."""
    return (
        new if k == 0 else octaves[0],
        new if k == 1 else octaves[1],
        new if k == 2 else octaves[2],
        new if k == 3 else octaves[3],
        new if k == 4 else octaves[4],
        new if k == 5 else octaves[5],
        new if k == 6 else octaves[6],
        new if k == 7 else octaves[7],
        new if k == 8 else octaves[8],
    )


@inlined
def is_within_tau(params: ConditioningParams, k: int) -> bool:
    """Whether an octave's windows are no longer than those that ``gravity_tau_s`` stands for."""
    return TAU_SHARE * WINDOW_S * (1 << k) <= params.gravity_tau_s


@inlined
def pairs_seen(windows: int, moved_s: float, k: int) -> float:
    """How many neighbours of an octave are remembered."""
    return max(1.0, moved_s / (WINDOW_S * (1 << k)) - 1.0) if windows >= 2 << k else 0.0


@inlined
def take_window(octaves: Octaves, mean: Vec3, turn: Vec3, windows: int, moved_s: float) -> Octaves:
    """The octaves after a window of the shortest length; two of one make one of the next."""
    for k in range(OCTAVES):
        before = octaves[k]
        apart, turning, pairs = before.apart, before.turning, pairs_seen(windows, moved_s, k)
        if pairs > 0.0:
            sizes = square(before.mean) * square(mean)
            # half the square of a small angle is 1 - cos
            turned = 1.0 - dot(before.mean, mean) / sqrt(sizes) if sizes > 0.0 else 0.0
            apart += (turned - apart) / pairs
            turning += (square(turn) - turning) / pairs
        octaves = put(octaves, k, Octave(mean, turn, apart, turning))
        if windows % (2 << k) > 0:
            break
        mean, turn = scale(0.5, add(before.mean, mean)), add(before.turn, turn)
    return octaves


@inlined
def likely_octave(
    params: ConditioningParams, state: Averaging, bias_variance: float, k: int, below: Octave
) -> tuple[Octave, float]:
    """What probably holds of an octave; with few windows it resembles the one ``below``.

    The second value is the part of ``apart`` by accelerations. The gyroscope may have caused a
    share of the turn, and a bias of ``bias_variance``, (rad/s)^2 about each axis.
    """
    length_s = WINDOW_S * (1 << k)
    pairs = pairs_seen(state.windows, state.moved_s, k)
    # white accelerations up to the profile's window, a steady turn beyond
    slope = sqrt(0.5) if is_within_tau(params, k) else 1.0 / sqrt(0.5)
    octave = state.octaves[k]
    weight = pairs + PRIOR_WINDOWS
    apart = (pairs * octave.apart + PRIOR_WINDOWS * slope * below.apart) / weight
    turning = (pairs * octave.turning + PRIOR_WINDOWS * 4.0 * below.turning) / weight
    drift = 0.5 * MOST_ERROR**2 * turning + bias_variance * length_s**2
    return octave._replace(apart=apart, turning=turning), max(0.0, apart - drift)


@inlined
def best_window(
    params: ConditioningParams, state: Averaging, bias_variance: float
) -> tuple[float, float, float]:
    """The length (s) of the windows whose mean is nearest to gravity, and its variance (rad^2).

    The third value is the variance for the profile's time. All lengths count, by the inverse square
    of their variance.
    """
    accelerated, likely = 0.0, NOTHING_SEEN
    for k in range(OCTAVES):
        likely, by_push = likely_octave(params, state, bias_variance, k, likely)
        accelerated += by_push
    weights, octave, variance, own, likely = 0.0, 0.0, 0.0, 0.0, NOTHING_SEEN
    for k in range(OCTAVES):
        likely, by_push = likely_octave(params, state, bias_variance, k, likely)
        accelerated -= by_push
        off = 0.5 * (likely.apart + max(0.0, accelerated))
        own = off if is_within_tau(params, k) else own
        weight = 1.0 / (off + LEAST_VARIANCE) ** 2
        weights += weight
        octave += weight * k
        variance += weight * off
    return WINDOW_S * 2.0 ** (octave / weights), variance / weights, own


@inlined
def follow_averaging(
    params: ConditioningParams,
    state: Averaging,
    force_g: Vec3,
    rate_g: Vec3,
    bias_variance: float,
    dt_s: float,
) -> Averaging:
    """The state after a step with ``force_g``, minus the specific force in G, and ``rate_g``."""
    force, turn = add(state.force, scale(dt_s, force_g)), add(state.turn, scale(dt_s, rate_g))
    time_s = state.time_s + dt_s
    if time_s < WINDOW_S:
        return state._replace(force=force, turn=turn, time_s=time_s)
    windows, moved_s = state.windows + 1, min(state.moved_s + time_s, LONG_S)
    octaves = take_window(state.octaves, scale(1.0 / time_s, force), turn, windows, moved_s)
    now = Averaging(octaves, windows, moved_s, ZERO_VEC3, ZERO_VEC3, 0.0, 1.0, 0.0, 0.0)
    length_s, variance, own = best_window(params, now, bias_variance)
    if not params.use_averaging:
        return now._replace(variance=variance)
    ratio = (variance + LEAST_VARIANCE) / (own + LEAST_VARIANCE)
    factor = max(TAU_SHARE * length_s, WINDOW_S) / params.gravity_tau_s
    return now._replace(factor=factor, variance=variance, share=max(0.0, 1.0 - ratio * ratio))


@inlined
def averaging_at_rest(params: ConditioningParams, state: Averaging, dt_s: float) -> Averaging:
    """Nothing accelerates at rest: the profile's time is enough, and new force removes errors."""
    factor = min(state.factor, 1.0)
    share = min(1.0, dt_s / (factor * params.gravity_tau_s))
    return state._replace(factor=factor, variance=(1.0 - share) * state.variance)
