"""Where down is: specific force low-passed in the gyro-propagated frame G."""

from estimator.compilation.compiled import inlined
from estimator.conditioning.lowpass import running_mean, smooth
from estimator.conditioning.rate import FAST_STEP_S
from estimator.conditioning.tilt import HOLE_S
from estimator.conditioning.types import (
    Coefficients,
    ConditioningParams,
    Force,
    GravityState,
    Rows,
    Smooth,
    Two,
)
from estimator.geometry.quaternion import (
    dot,
    multiply,
    normalize,
    rotate,
    shortest_rotation,
    square,
    subtract,
    unit,
)
from estimator.types import Quaternion, Vec3

DOWN: Vec3 = (0.0, 0.0, 1.0)
# Less smoothed force than this (m/s^2) has no direction: free fall.
LEAST_FORCE_M_S2 = 0.5
# Averaging time (s) of how unsteady the force is.
UNSTEADY_TAU_S = 5.0


@inlined
def propagate_frame(state: GravityState, turn: Quaternion) -> GravityState:
    """q_G <- q_G exp((w - b) dt), the ``turn``: body to G, which only gyro errors move."""
    q = normalize(multiply(state.q_g_frd, turn))
    return GravityState(q, state.q_6d_g, state.force)


@inlined
def observe_gravity(
    params: ConditioningParams,
    k: Coefficients,
    state: GravityState,
    u: Vec3,
    share: float,
    slow: float,
) -> GravityState:
    """Low-pass ``u``, minus the specific force in G.

    In G gravity stands still while accelerations come and go (what moves to
    and fro ends where it began, so their mean vanishes), and turning causes no
    lag. The force is not normalised first: the mean of directions is tilted
    where the mean of forces is not. A running mean over the first
    ``gravity_tau_s`` starts it. Of slow streams the vertical moves by ``share`` of
    its way, which :mod:`estimator.conditioning.tilt` has weighed.
    Source: Laidig and Seel 2023, doi 10.1016/j.inffus.2022.10.014.
    """
    before = state.force
    dt = k.dt_s
    age = before.age_s + dt
    if not params.use_gravity_filter:
        down = Smooth(u, (0.0, 0.0, 0.0))
    elif age <= params.gravity_tau_s or before.age_s == 0.0:
        down = running_mean(before.down, u, max(dt / age, slow * share))
    elif slow > 0.0:
        down = running_mean(before.down, u, share)
    else:
        down = smooth(k.gravity, before.down, u)
    a = max(k.quick_share, dt / age)
    q = before.quick
    quick = (q[0] + a * (u[0] - q[0]), q[1] + a * (u[1] - q[1]), q[2] + a * (u[2] - q[2]))
    f = down.value
    size, off = square(f), square(subtract(u, f))
    share = off / size if size > LEAST_FORCE_M_S2**2 else 1.0
    unsteady = before.unsteady + min(1.0, dt / UNSTEADY_TAU_S) * (share - before.unsteady)
    force = Force(down=down, quick=quick, unsteady=unsteady, age_s=age)
    return GravityState(state.q_g_frd, state.q_6d_g, force)


@inlined
def age_after_hole(
    state: GravityState, share: float, slow: float, dt: float, usual_s: float
) -> GravityState:
    """What a hole in a fast stream leaves of the vertical's age.

    The first reading behind it, worth ``usual_s``, has made up ``share`` of the vertical. So the
    next ones count as much as that says, and not as little as after seconds of averaging.
    """
    before = state.force
    is_fast = 0.0 < usual_s < FAST_STEP_S
    if slow <= 0.0 or dt <= HOLE_S or not is_fast:
        return state
    age_s = min(before.age_s, usual_s / max(share, usual_s / before.age_s))
    force = Force(before.down, before.quick, before.unsteady, age_s)
    return GravityState(state.q_g_frd, state.q_6d_g, force)


@inlined
def level(state: GravityState) -> tuple[GravityState, Two]:
    """C <- (shortest rotation of C f to the vertical) C; also the step about north and east."""
    f = rotate(state.q_6d_g, state.force.down.value)
    if square(f) < LEAST_FORCE_M_S2**2:
        return state, (0.0, 0.0)
    z = unit(f)
    q = normalize(multiply(shortest_rotation(z, DOWN), state.q_6d_g))
    # z x DOWN = (z_y, -z_x, 0), the rotation vector of a small step
    return GravityState(state.q_g_frd, q, state.force), (z[1], -z[0])


@inlined
def reseed_gravity(state: GravityState, u: Vec3) -> GravityState:
    """Start the low-pass anew at ``u``."""
    before = state.force
    down = Smooth(u, (0.0, 0.0, 0.0))
    force = Force(down=down, quick=u, unsteady=before.unsteady, age_s=before.age_s)
    return GravityState(state.q_g_frd, state.q_6d_g, force)


@inlined
def restart_gravity(state: GravityState) -> GravityState:
    """Start the low-pass anew, as at the first sample."""
    zero = (0.0, 0.0, 0.0)
    down = Smooth(zero, zero)
    force = Force(down=down, quick=zero, unsteady=state.force.unsteady, age_s=0.0)
    return GravityState(state.q_g_frd, state.q_6d_g, force)


@inlined
def rows_of(q_6d_frd: Quaternion) -> Rows:
    """The rows of R6, by the quaternion's products."""
    w, x, y, z = q_6d_frd
    return Rows(
        north=(1.0 - 2.0 * y * y - 2.0 * z * z, 2.0 * (x * y - w * z), 2.0 * (w * y + x * z)),
        east=(2.0 * (w * z + x * y), 1.0 - 2.0 * z * z - 2.0 * x * x, 2.0 * (y * z - w * x)),
        down=down_of(q_6d_frd),
    )


@inlined
def to_frame(rows: Rows, v: Vec3) -> Vec3:
    """A body's vector in the frame of the rows: R v."""
    return (dot(rows.north, v), dot(rows.east, v), dot(rows.down, v))


@inlined
def to_body(rows: Rows, v: Vec3) -> Vec3:
    """A vector of that frame as the body sees it: R^T v."""
    x, y, z = rows
    return (
        x[0] * v[0] + y[0] * v[1] + z[0] * v[2],
        x[1] * v[0] + y[1] * v[1] + z[1] * v[2],
        x[2] * v[0] + y[2] * v[1] + z[2] * v[2],
    )


@inlined
def down_of(q_6d_g: Quaternion) -> Vec3:
    """The vertical of 6D in the frame that the quaternion comes from: R6's last row."""
    w, x, y, z = q_6d_g
    return (2.0 * (x * z - w * y), 2.0 * (w * x + y * z), 1.0 - 2.0 * x * x - 2.0 * y * y)
