"""A learning step of the vertical and the bias from mean gyroscope and accelerometer readings."""

from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.conditioning.gather import Gathered
from estimator.conditioning.params import REACH, ConditioningParams
from estimator.conditioning.rate import aliased_turn
from estimator.conditioning.vertical.averaging import Averaging, averaging_at_rest, follow_averaging
from estimator.conditioning.vertical.bias import (
    Estimate,
    Lagged,
    lag,
    learn_at_rest,
    learn_in_motion,
    predict,
)
from estimator.conditioning.vertical.gravity import (
    GravityState,
    age_after_hole,
    level_to,
    long_share,
    observe_gravity,
)
from estimator.conditioning.vertical.lowpass import Coefficients, Smooth, approach, coefficients
from estimator.conditioning.vertical.slow_acceleration import (
    SCALE_ERROR,
    LostSteps,
    SlowAcceleration,
    add_lost_step,
    mean_tilt_variance,
    slow_variance,
    watch_rest,
    watch_slow,
)
from estimator.conditioning.vertical.stillness import (
    RestState,
    Stillness,
    observe_rest,
    watch_stillness,
)
from estimator.conditioning.vertical.tilt import (
    LEAST_OFF_RAD,
    TiltState,
    force_after_turn,
    slowness,
    step_noise,
    update_tilt,
    weighing,
)
from estimator.geometry.axes import axes_of, down_of
from estimator.geometry.quaternion import (
    ANY_DIRECTION_VARIANCE,
    HALF_TURN_VARIANCE,
    dot,
    multiply,
    norm,
    rotate,
    rotate_inverse,
    square,
    subtract,
)
from estimator.types import ZERO_VEC3, Between, Quaternion, Sample, Vec3


class VerticalState(NamedTuple):
    """What is known of the vertical and of the gyroscope."""

    estimate: Estimate  # bias and heading, whose errors are correlated
    averaging: Averaging = Averaging()  # of gravity
    gravity: GravityState = GravityState()  # down in frame G
    tilt: TiltState = TiltState()  # how well down is known
    slow: SlowAcceleration = SlowAcceleration()  # accelerations of a slow stream that last
    inflation: float = 0.0  # its variance by an unsensed turn, until the force shows, rad^2
    rest: RestState = RestState()  # whether the vehicle rests
    still: Stillness = Stillness()  # whether gravity and field confirm that
    lost: LostSteps = LostSteps()  # how a slow stream's vehicle is tilted on average
    lagged: Lagged = Lagged()  # what bias learning in motion compares with
    coefficients: Coefficients = Coefficients()  # for the last step's length


class VerticalStep(NamedTuple):
    """The vertical's state after a learning step, and what it shows to field and events."""

    state: VerticalState
    mean: Gathered  # readings that it has learnt from, with frame G
    rate: Vec3  # mean, less the bias as it was before, rad/s, FRD
    aliasing: float  # variance of the turn that the gyroscope missed, rad^2
    clipped: float  # part of it that was beyond the gyroscope's end, rad^2


@inlined
def begin_vertical(state: VerticalState, q_g_frd: Quaternion, first: Sample) -> VerticalState:
    """The state at the first sample. Its force shows next to nothing of the vertical."""
    gyr, acc = first.gyr_rad_s, first.acc_m_s2
    size = norm(rotate(q_g_frd, acc))
    return state._replace(
        rest=state.rest._replace(gyr=Smooth(gyr, ZERO_VEC3), acc=Smooth(acc, ZERO_VEC3)),
        tilt=state.tilt._replace(scatter=16.0 * LEAST_OFF_RAD**2, gyr=gyr, force=size),
    )


@inlined
def learn_vertical(
    params: ConditioningParams,
    before: VerticalState,
    mean: Gathered,
    between: Between,
    force_scatter: float,
) -> VerticalStep:
    """Rest, gravity, the heading's prediction and the bias by one step's mean readings.

    ``force_scatter`` (rad^2) is how far the force of a second usually is off the vertical.
    """
    dt, k = mean.time_s, before.coefficients
    interval_s = k.dt_s
    if dt != interval_s or before.averaging.factor != k.factor:
        k = coefficients(params, dt, before.averaging.factor)
        before = before._replace(coefficients=k)
    rest, still = look_for_rest(params, before, mean)
    rate = subtract(mean.gyr, before.estimate.bias_rad_s)
    down = rotate_inverse(mean.q_g_frd, down_of(before.gravity.q_6d_g))
    p = before.estimate.covariance
    # a slow stream's rates are of whole mrad/s, so rest shows no more than motion
    unknown = max((p[0] + p[4] + p[7]) / 3.0, params.bias_motion_sigma_rad_s**2)
    tilt = before.tilt._replace(drift=before.tilt.drift + unknown * dt)
    tilt, yaw_noise = step_noise(params, tilt, mean, rate, down, interval_s, between)
    aliasing, clipped = tilt.aliasing, aliased_turn(mean.clipping, down)
    now, most = hold_by_mean_tilt(params, before._replace(tilt=tilt), mean)
    now, share, follows = weigh_force(params, now, mean, clipped[0], force_scatter, most)
    slow, weighed = slowness(params, dt), weighing(params, dt)
    gravity = observe_gravity(params, k, now.gravity, mean.gravity_g, share, follows)
    gravity = age_after_hole(gravity, share, slow, dt, interval_s)
    q_6d_g, step = level_to(gravity.q_6d_g, gravity.force.down.value)
    gravity = gravity._replace(q_6d_g=q_6d_g)
    age_s = gravity.force.age_s
    axes = axes_of(multiply(gravity.q_6d_g, mean.q_g_frd))
    unseen = slow * yaw_noise + clipped[1]
    estimate = predict(params, k, before.estimate, axes.down, dot(rate, rate), unseen)
    lagged = lag(params, k, before.lagged, axes, estimate.bias_rad_s, age_s, share, follows)
    if rest.resting and rest.change_square < 1.0 and params.use_rest:
        estimate = learn_at_rest(params, k, estimate, axes, rest, still)
    if params.use_motion_bias and before.gravity.force.age_s > params.gravity_tau_s:
        # of the vertical's own variance: what a step of that share moves by
        unseen = max(slow * aliasing, weighed * share * now.tilt.variance) / dt**2
        estimate = learn_in_motion(params, k, estimate, lagged, step, unseen)
    averaging = before.averaging
    if rest.resting:
        averaging = averaging_at_rest(params, averaging, dt)
    elif weighed <= 0.0 and age_s > params.gravity_tau_s:
        unknown_bias = (p[0] + p[4] + p[7]) / 3.0
        rate_g = rotate(mean.q_g_frd, rate)
        averaging = follow_averaging(params, averaging, mean.gravity_g, rate_g, unknown_bias, dt)
    state = now._replace(
        estimate=estimate,
        averaging=averaging,
        gravity=gravity,
        slow=follow_slow(params, now, gravity, mean.gravity_g),
        rest=rest,
        still=still,
        lagged=lagged,
    )
    beyond = clipped[0] + clipped[1]
    return VerticalStep(state, mean, rate, aliasing + yaw_noise + beyond, beyond)


@inlined
def look_for_rest(
    params: ConditioningParams, before: VerticalState, mean: Gathered
) -> tuple[RestState, Stillness]:
    """Whether gyroscope and accelerometer rest, and whether gravity and field bear that out.

    What goes evenly through a long curve seems to rest, so its rate has to be the known bias.
    """
    k, p = before.coefficients.rest, before.estimate.covariance
    rest = observe_rest(params, k, before.rest, mean.gyr, mean.acc, mean.time_s)
    shown = subtract(rest.gyr.value, before.estimate.bias_rad_s)
    still = watch_stillness(params, before.still, rest, shown, mean)
    known = max(p[0], p[4], p[7]) + params.bias_motion_sigma_rad_s**2
    turns = mean.goes and square(shown) > REACH**2 * known
    rests = (rest.resting and not still.contradicted) or still.proven
    return rest._replace(resting=rests and not turns), still


@inlined
def hold_by_mean_tilt(
    params: ConditioningParams, before: VerticalState, mean: Gathered
) -> tuple[VerticalState, float]:
    """A slow step's vertical with what it has lost taken from the mean one.

    The second value is the mean one's variance (rad^2): nothing is less certain.
    """
    dt, steps, gravity, force = mean.time_s, before.lost, before.gravity, before.gravity.force
    slow = slowness(params, dt)
    if slow <= 0.0:
        return before, ANY_DIRECTION_VARIANCE
    most = mean_tilt_variance(steps, slow_variance(before.slow), dt)
    lost = slow * max(0.0, 1.0 - most / (before.tilt.variance + before.tilt.aliasing))
    if steps.seen_s > 0.0:
        g = rotate(mean.q_g_frd, steps.down)
        down = Smooth(approach(force.down.value, g, lost), ZERO_VEC3)
        best = Smooth(approach(force.best.value, g, lost), ZERO_VEC3)
        gravity = gravity._replace(force=force._replace(down=down, best=best))
    return before._replace(gravity=gravity, lost=add_lost_step(steps, mean.acc, lost, dt)), most


@inlined
def weigh_force(
    params: ConditioningParams,
    before: VerticalState,
    mean: Gathered,
    clipped: float,
    force_scatter: float,
    most: float,
) -> tuple[VerticalState, float, float]:
    """How much the step's mean force counts, against what was known of the vertical.

    Returns the state with the vertical's certainty, the share by which it moves towards the force,
    and 1 if that share decides, 0 if the low-pass does.

    ``clipped`` (rad^2) is the variance of a turn beyond the gyroscope's end, ``most`` the largest
    of the vertical. After such a turn, or one that no sensor has felt, the force counts for more
    than the low-pass would take, until the published low-pass is as quick.
    """
    dt = mean.time_s
    weighed = weighing(params, dt)
    inflation = min(before.inflation + clipped, HALF_TURN_VARIANCE)
    down_g, age_s = before.gravity.force.down.value, before.gravity.force.age_s + dt
    warm_up = dt / age_s if age_s <= params.gravity_tau_s else 0.0
    resting = before.rest.resting
    slow_square = 0.0 if resting else weighed * slow_variance(before.slow)
    # t^2 = 2 (1 - cos t) of what shows that the vertical is wrong
    least = 0.0 if resting else max(0.0, 2.0 * (1.0 - before.slow.along - SCALE_ERROR))
    scatter = before.tilt.scatter
    if resting:  # shaking has ended: a reading is off by no more than its own error
        share = before.lost.proofs / (1.0 + before.lost.proofs)
        scatter += share * (min(scatter, 4.0 * LEAST_OFF_RAD**2) - scatter)
    variance = max(before.tilt.variance, least) + weighed * inflation + before.tilt.aliasing
    known = before.tilt._replace(variance=min(variance, most), scatter=scatter)
    tilt, share = update_tilt(params, known, down_g, mean.gravity_g, dt, slow_square, warm_up)
    inflation *= 1.0 - weighed
    if inflation > 0.0:
        least_share = dt / (max(1.0, before.coefficients.factor) * params.gravity_tau_s)
        inflation, anew = force_after_turn(inflation, force_scatter, dt, least_share)
        if anew > max(warm_up, weighed * share):
            share, weighed = anew, 1.0
    return before._replace(tilt=tilt, inflation=inflation), share, weighed


@inlined
def follow_slow(
    params: ConditioningParams, before: VerticalState, now: GravityState, u: Vec3
) -> SlowAcceleration:
    """What shows accelerations that last after a step; a rest shows nothing of them."""
    k = before.coefficients
    weighed = weighing(params, k.dt_s)
    if weighed == 0.0:
        return before.slow
    if before.rest.resting:
        return watch_rest(before.slow, u, k.dt_s)
    f, down_g = now.force, before.gravity.force.down.value
    share = long_share(k, f.age_s)
    carried = weighed - slowness(params, k.dt_s)
    return watch_slow(before.slow, u, f.quick, down_g, share, before.tilt.aliasing, carried, k.dt_s)
