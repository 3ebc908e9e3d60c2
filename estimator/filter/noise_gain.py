"""A gain that knows the noise: one rule base for every sensor.

The paper's rules compare e with fixed numbers, so they suit the noise that they were tuned on. Here
both inputs are counted in noise floors, which are measured as the samples come:

* the vectors' variance, from how far each is from the one before turned on by the gyroscope: a
  wrong estimate does not count as noise;
* the gyroscope's, from how much its rate changes between two samples: noise, or motion that
  integration does not see;
* the floor of e: its own running mean, at least what the vectors' variance gives. What a second or
  two of a large gain has not removed is the sensors'.

e is sin^2 of half the angle to the vectors, averaged by confidence, each the smaller of two samples
in a row: a single wrong vector is no lost attitude. The trace that the paper takes e from answers
the noise of the angle between the vectors in first order, and is clipped half of the time.

The rules are the paper's Table I. The terms of each input are triangles on its logarithm that add
up to one everywhere, and products take the place of minima: the surface interpolates the table and,
like its rows and columns, never descends.

The resting gain is that of a Kalman filter for a random walk, sqrt(q/r) with the densities q of the
gyroscope's and r of the vectors' noise; dt cancels. After a large gain K goes down as a Kalman
filter's does, dK/dt = kappa (K_rest^2 - K^2): first the estimate is as noisy as one sample, and K =
1/t averages all since.
"""

from math import log, sqrt
from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.filter.fuzzy import RULES
from estimator.geometry.quaternion import add, cross, dot, scale, subtract
from estimator.types import ZERO_VEC3, Vec2, Vec3

# The numbers were searched on the paper's signals with noise seeds 300-307, the vectors' noise
# and the gyroscope's at 1, 2 and 5 times the paper's, and rounded; see docs/gains.md.

# Memory of both variances, s. Small: they scatter; large: a change of noise is noticed late.
NOISE_WINDOW_S = 0.5
# Of the floor of e, s. Small: a wrong start passes for the sensors' error; large: a magnet's
# field keeps the gain up for as long.
FLOOR_TIME_S = 1.2
# What one sample of e may add, in floors: a wrong start is not the sensors' error.
FLOOR_CAP = 3.0
# The resting gain over sqrt(q/r), and its bounds. Small: the gyroscope's bias shows; large: the
# vectors' noise does. Vectors with errors of their own are worth less than their noise shows.
RESTING_SHARE = 0.55
RESTING_LEAST = 1.3
RESTING_MOST = 30.0
# K of the table's largest consequent. The paper's 101 undoes a small error in one step of 10 ms;
# near half a turn, where the innovation vanishes, a little more is faster. From 124 on a plain
# step is too long (PLAIN_STEP_LIMIT), so there it would not be taken.
LARGEST_GAIN = 120.0
# Where the terms stand, in floors: the first, and the factor from each to the next. Small: noise
# opens the gain; large: an error waits until it is large.
ERROR_FIRST, ERROR_FACTOR = 5.5, 1.15
RATE_FIRST, RATE_FACTOR = 4.5, 1.2
# kappa. Small: K goes down late; large: before the estimate is good.
DESCENT = 0.35

# K^2 may be off by this share before K changes: within half a second the measured variances scatter
# by a quarter of that anyway.
TOLERANCE = 0.2

# Squared noise of a unit vector that is called none.
LEAST_VARIANCE = 1e-8
LARGEST_CONSEQUENT = 4.0


class NoiseState(NamedTuple):
    """What is remembered of the samples. ``samples`` were averaged, at most a window's."""

    v1_frd: Vec3
    has_v1: bool
    v2_frd: Vec3
    has_v2: bool
    rate_rad_s: Vec3
    samples: float
    vector_variance: float  # of each component, squared unit vectors
    rate_variance: float  # of each component of the rate, (rad/s)^2
    error_floor: float
    errors: Vec2 = (1.0, 1.0)  # of each vector at the sample before


NO_NOISE = NoiseState(ZERO_VEC3, False, ZERO_VEC3, False, ZERO_VEC3, 0.0, 0.0, 0.0, 0.0)


@inlined
def confirmed_error(
    noise: NoiseState, v1: Vec3, u1: Vec3, s1: float, v2: Vec3, u2: Vec3, s2: float
) -> tuple[NoiseState, float]:
    """e as far as two samples in a row confirm it, by each vector for itself."""
    e1 = vector_error(v1, u1) if s1 > 0.0 else noise.errors[0]
    e2 = vector_error(v2, u2) if s2 > 0.0 else noise.errors[1]
    e = s1 * min(e1, noise.errors[0]) + s2 * min(e2, noise.errors[1])
    return noise._replace(errors=(e1, e2)), e / (s1 + s2) if s1 + s2 > 0.0 else 0.0


@inlined
def vector_error(v: Vec3, u: Vec3) -> float:
    """sin^2 of half the angle between two unit vectors."""
    return min(1.0, max(0.0, 0.5 * (1.0 - dot(v, u))))


@inlined
def squared_change(before: Vec3, now: Vec3, turn: Vec3) -> float:
    """Squared distance of a vector from the one before, turned on: v - (v_before - turn x v)."""
    off = add(subtract(now, before), cross(turn, before))
    return dot(off, off)


@inlined
def observe_noise(
    noise: NoiseState, v1: Vec3, has_v1: bool, v2: Vec3, has_v2: bool, rate: Vec3, dt: float
) -> NoiseState:
    """The variances with one more sample, ``dt`` (s) after the one before; rate in rad/s."""
    turn = scale(dt, rate)
    total = 0.0
    components = 0.0  # a direction has two, and the difference of two samples twice the variance
    if has_v1 and noise.has_v1:
        total += squared_change(noise.v1_frd, v1, turn)
        components += 4.0
    if has_v2 and noise.has_v2:
        total += squared_change(noise.v2_frd, v2, turn)
        components += 4.0
    samples, r, q = noise.samples, noise.vector_variance, noise.rate_variance
    if components > 0.0 and dt > 0.0:
        samples = min(samples + 1.0, max(1.0, NOISE_WINDOW_S / dt))
        change, share = subtract(rate, noise.rate_rad_s), 1.0 / samples
        r += share * (total / components - r)
        q += share * (dot(change, change) / 6.0 - q)
    return NoiseState(v1, has_v1, v2, has_v2, rate, samples, r, q, noise.error_floor, noise.errors)


@inlined
def observe_floor(noise: NoiseState, error: float, dt: float) -> NoiseState:
    """The floor of e with one more e."""
    least = 0.5 * max(noise.vector_variance, LEAST_VARIANCE)
    floor = max(noise.error_floor, least)
    floor += dt / (FLOOR_TIME_S + dt) * (min(error, FLOOR_CAP * floor) - floor)
    return noise._replace(error_floor=max(floor, least))


@inlined
def term(floors: float, first: float, factor: float) -> float:
    """An input's place between the terms VS = 0 and VL = 4."""
    if floors <= first:
        return 0.0
    return min(4.0, log(floors / first) / log(factor))


@inlined
def consequent(error_term: float, rate_term: float) -> float:
    """Table I between its entries, 0 to 1: never descends in either input."""
    column = min(3, int(error_term))
    row = min(3, int(rate_term))
    x = error_term - column
    y = rate_term - row
    upper = (1.0 - x) * RULES[row][column] + x * RULES[row][column + 1]
    lower = (1.0 - x) * RULES[row + 1][column] + x * RULES[row + 1][column + 1]
    return ((1.0 - y) * upper + y * lower) / LARGEST_CONSEQUENT


@inlined
def resting_gain(noise: NoiseState, before: float) -> float:
    """sqrt(q/r), less for the vectors' slow errors; q = rate variance dt, r = vectors' dt.

    The gain of the sample ``before`` stays where it is near enough.
    """
    r = max(noise.vector_variance, LEAST_VARIANCE)
    ratio = RESTING_SHARE**2 * noise.rate_variance  # times r, as all that follows
    ratio = min(RESTING_MOST**2 * r, max(RESTING_LEAST**2 * r, ratio))
    if abs(ratio - before * before * r) <= TOLERANCE * ratio:
        return before
    return sqrt(ratio / r)


@inlined
def rules_gain(resting: float, error_floors: float, rate_floors: float) -> float:
    """K by the rules, from the resting gain to the largest by equal factors.

    Inputs: e, and how much it rises within the rate's time constant, both in floors.
    """
    if error_floors <= ERROR_FIRST and rate_floors <= RATE_FIRST:
        return resting  # nearly always: the power is spared
    e = term(error_floors, ERROR_FIRST, ERROR_FACTOR)
    d = term(rate_floors, RATE_FIRST, RATE_FACTOR)
    return float(resting * (LARGEST_GAIN / resting) ** consequent(e, d))


@inlined
def descend(gain: float, resting: float, dt: float) -> float:
    """One implicit step of dK/dt = kappa (K_rest^2 - K^2): stays above 0 for any dt."""
    if gain == resting:
        return gain
    share = DESCENT * dt
    return gain + share * (resting * resting - gain * gain) / (1.0 + share * (gain + resting))


@inlined
def noise_gain(
    noise: NoiseState, error: float, rise: float, gain_before: float, dt: float
) -> float:
    """K from e, its rise within the rate's time constant, and the gain of the sample before.

    Nothing is known of the noise at the first sample: the largest gain.
    """
    if noise.samples <= 0.0:
        return LARGEST_GAIN
    resting = resting_gain(noise, gain_before)
    floor = noise.error_floor
    ruled = rules_gain(resting, error / floor, max(rise, 0.0) / floor)
    return max(ruled, descend(gain_before, resting, dt))
