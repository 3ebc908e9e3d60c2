"""The magnetometer's lag and the vehicle's own field, learnt while turning."""

from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.conditioning.field.magnetic import robust_factor
from estimator.conditioning.params import (
    ACCELERATION_LASTS_S,
    FORGET_S,
    LONGEST_STEP_S,
    MOST_DEVIATION,
    REACH,
    ConditioningParams,
)
from estimator.conditioning.vertical.bias import Covariance, update
from estimator.conditioning.vertical.lowpass import approach
from estimator.geometry.axes import FrameAxes, to_frame
from estimator.geometry.quaternion import add, cross, dot, scale, subtract
from estimator.types import ZERO_VEC3, Vec2, Vec3


class Calibration(NamedTuple):
    """The magnetometer's age and the vehicle's own field, with their covariance."""

    lag_s: float  # age of a reading
    offset: Vec3  # the vehicle's own field in FRD, as a share of ``scale``
    covariance: Covariance  # of (offset, lag)
    scale: float  # norm of the place's field, in the field's own unit


class CalibrationState(NamedTuple):
    """The calibration and the slow means that its learning takes off."""

    learnt: Calibration  # the unknowns
    field: Vec3 = ZERO_VEC3  # mean of the field in G, as a share of ``scale``
    turning: Vec3 = ZERO_VEC3  # of R (w x m), in G, 1/s; R turns body to G
    axes: FrameAxes = FrameAxes(ZERO_VEC3, ZERO_VEC3, ZERO_VEC3)  # of those of G, the rows of R
    age_s: float = 0.0  # of the means, up to ``ACCELERATION_LASTS_S``; 0: of another attitude
    scatter: float = 0.0  # mean square of what of the field's change no unknown explains


def first_calibration(params: ConditioningParams) -> CalibrationState:
    """Before the first sample: no lag and no own field, as uncertain as the parameters set it."""
    offset, lag = most_variances(params)
    covariance = (offset, 0.0, 0.0, 0.0, offset, 0.0, 0.0, offset, 0.0, lag)
    return CalibrationState(Calibration(0.0, ZERO_VEC3, covariance, 0.0))


@inlined
def most_variances(params: ConditioningParams) -> Vec2:
    """Variances of an unknown offset and of an unknown lag (s^2); 0 of what is switched off."""
    return (
        params.field_offset_sigma**2 if params.use_field_offset else 0.0,
        params.field_lag_sigma_s**2 if params.use_lag else 0.0,
    )


@inlined
def own_field(state: Calibration) -> tuple[Vec3, float]:
    """The share of the learnt own field that is no error, and the variance of what may be left.

    Both are shares of ``scale``, the variance of one axis. For o with the variance V that share is
    o . o/(o . o + V), and o . o V/(o . o + V) is left: most vehicles have none (James and Stein
    1961). Learning treats readings as if beside a magnet, and the result is off by a third of its
    sigma, so V is that much less.
    """
    o, p = state.offset, state.covariance
    size, variance = dot(o, o), (p[0] + p[4] + p[7]) / REACH**2
    share = size / (size + variance) if size > 0.0 else 0.0
    return scale(share, o), share * variance / 3.0


@inlined
def correct_field(field: Vec3, gyr: Vec3, state: Calibration) -> Vec3:
    """The field without the vehicle's own, as the body would see it now.

    m <- m - own, then exp(-[w]x lag) m to second order: the place's field stands still, so in the
    body m' = -w x m, and a reading that is ``lag_s`` old lacks what the vehicle has turned since.
    """
    m = subtract(field, scale(state.scale, own_field(state)[0]))
    lag = state.lag_s
    first = cross(gyr, m)
    second = cross(gyr, first)
    return add(subtract(m, scale(lag, first)), scale(0.5 * lag * lag, second))


@inlined
def walk(params: ConditioningParams, p: Covariance, dt_s: float) -> Covariance:
    """The covariance after a step, as the own field may change: up to its first variances."""
    most, most_lag = most_variances(params)
    share = dt_s / FORGET_S
    p00, p01, p02, p03, p11, p12, p13, p22, p23, p33 = p
    p00, p11 = min(p00 + share * most, most), min(p11 + share * most, most)
    p22, p33 = min(p22 + share * most, most), min(p33 + share * most_lag, most_lag)
    return (p00, p01, p02, p03, p11, p12, p13, p22, p23, p33)


@inlined
def learn_calibration(
    params: ConditioningParams,
    state: CalibrationState,
    axes: FrameAxes,
    gyr: Vec3,
    field_g: Vec3,
    norm: float,
    dt_s: float,
    unseen: float,
) -> CalibrationState:
    """Recursive least squares of field = F + R offset + lag (R w) x field, all over ``norm``.

    R turns body to G; ``axes`` are its axes. What moves with the body is the vehicle's own field
    (hard iron), what moves with the turn rate is the sensor's age. All is taken less its mean over
    ``ACCELERATION_LASTS_S``, or since the start, so that the place's field F and slow drift vanish.
    ``field_g`` is corrected already, so its residual is that of what has been taken off.

    A body that hardly turns, and a slow stream, teach only the lag. What turned ``unseen``
    (variance, rad^2) is noise, and so is a change of the field beyond what any own field explains:
    a magnet teaches little.
    """
    y = scale(1.0 / norm, field_g)
    x = cross(to_frame(axes, gyr), y)
    before = state.learnt
    # of another norm all is another share
    ratio = before.scale / norm if before.scale > 0.0 else 1.0
    before = Calibration(before.lag_s, scale(ratio, before.offset), before.covariance, norm)
    if state.age_s <= 0.0:
        return CalibrationState(before, y, x, axes, dt_s, state.scatter)
    age_s = min(state.age_s + dt_s, ACCELERATION_LASTS_S)
    a = min(1.0, dt_s / age_s)
    field = approach(scale(ratio, state.field), y, a)
    turning = approach(scale(ratio, state.turning), x, a)
    mean = FrameAxes(
        north=approach(state.axes.north, axes.north, a),
        east=approach(state.axes.east, axes.east, a),
        down=approach(state.axes.down, axes.down, a),
    )
    taken_off, _ = own_field(before)
    offset, lag_s, p = before.offset, before.lag_s, walk(params, before.covariance, dt_s)
    dy = subtract(y, field)
    scatter = state.scatter
    if dot(dy, dy) < MOST_DEVIATION**2:
        dx = subtract(x, turning)
        north, east = subtract(axes.north, mean.north), subtract(axes.east, mean.east)
        down = subtract(axes.down, mean.down)
        r, turned = (north, east, down), dot(north, north) + dot(east, east) + dot(down, down)
        is_slow = dt_s > LONGEST_STEP_S
        shows_offset = turned >= params.calibration_turn and not is_slow
        own = params.calibration_reach**2 * turned + p[9] * dot(dx, dx)
        excess = max(0.0, dot(dy, dy) - own) / 3.0
        scatter += dt_s / (ACCELERATION_LASTS_S + dt_s) * (excess - scatter)
        lasting_s = scatter * ACCELERATION_LASTS_S
        least = (params.calibration_noise_s + lasting_s) / dt_s + unseen
        for i in range(3):
            row = r[i] if shows_offset else ZERO_VEC3
            # the residual of what was taken off: less what is estimated beside that
            e = dy[i] - dot(row, subtract(offset, taken_off)) - dx[i] * (lag_s - before.lag_s)
            noise = least * robust_factor((e * (1.0 / params.calibration_reach)) ** 2)
            offset, lag_s, p = update(offset, lag_s, p, row, dx[i], e, noise)
        if is_slow:  # beside such steps no gyroscope is later than the magnetometer
            lag_s = max(lag_s, 0.0)
    learnt = Calibration(lag_s, offset, p, norm)
    return CalibrationState(learnt, field, turning, mean, age_s, scatter)
