"""The value that the compiled steps change, and what can be done to it from outside."""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from estimator.aiding.beginning import blank_aiding, forget_biases
from estimator.aiding.compass import Compass
from estimator.aiding.consistency import NEW_CONSISTENCY, Consistency
from estimator.aiding.covariance import rotation_matrix
from estimator.aiding.phase import Phase
from estimator.aiding.search import EMPTY_SEARCH, Search
from estimator.aiding.types import COMPASS_TURN, HARD_IRON, SIZE, AidingState
from estimator.aiding.velocity_history import COLUMNS
from estimator.conditioning.condition import Conditioned
from estimator.conditioning.gather import NOTHING, Gathered
from estimator.conditioning.state import ConditioningState, forget_bias, forget_field
from estimator.conditioning.state import apply_turn as turn_memory
from estimator.conditioning.state import initial_state as initial_conditioning
from estimator.filter.types import FilterState
from estimator.geometry.earth import LastPosition
from estimator.geometry.quaternion import conjugate, exp, multiply, normalize, rotate
from estimator.live.published import NO_PULL, Pull
from estimator.live.rows import REPORT_SIZE
from estimator.live.settings import Settings
from estimator.live.turning import COLUMNS as RATE_COLUMNS
from estimator.live.turning import STILL, Turning
from estimator.types import NO_SAMPLE, Quaternion, Sample, VehicleClass

# The conditioning stage's output before the first sample.
UNSEEN = Conditioned()


class Core(NamedTuple):
    """All that the compiled steps change; by default as before the first sample.

    Its four arrays are tuples in a snapshot, row by row.
    """

    conditioning: ConditioningState  # as it was before, while the vectors are raw
    aided: AidingState  # blank while velocity does not help
    covariance: Any  # of the aiding's errors: (SIZE, SIZE)
    velocity_history: Any  # that it has gained lately: (ROWS, COLUMNS)
    time_us: int = 0  # of the last sample, on the vehicle's clock
    interval_s: float = 0.0  # mean interval of the samples; 0 before the second one
    sample: Sample = NO_SAMPLE  # the last one
    filter: FilterState = FilterState()  # the paper's: attitude, bias, e, gain
    smooth_error: float = 0.0  # e averaged over a second while the vectors are raw, otherwise e
    pull: Pull = NO_PULL  # of raw vectors on the heading; as it was before, while conditioned
    gathered: Gathered = NOTHING  # with frame G; as it was before, while the vectors are raw
    seen: Conditioned = UNSEEN  # of the last sample; blank while the vectors are raw
    search: Search = EMPTY_SEARCH  # for an attitude from velocity, with or without the field
    consistency: Consistency = NEW_CONSISTENCY  # of the aided attitude; blank without velocity
    turning: Turning = STILL  # that others have seen between the IMU's samples
    rates: Any = ()  # of theirs that wait for a sample: rows as in ``turning``
    reports: Any = ()  # velocities the samples have not reached: (N, REPORT_SIZE)


@lru_cache(maxsize=16)  # that new vehicles begin with
def initial_core(settings: Settings) -> Core:
    """Before the first sample."""
    aided, covariance, velocity_history = blank_aiding(settings.aiding)
    memory = initial_conditioning(settings.conditioning)
    return in_arrays(Core(memory, aided, covariance, velocity_history))


# The columns of a core's arrays.
ARRAYS = {
    "covariance": SIZE,
    "velocity_history": COLUMNS,
    "rates": RATE_COLUMNS,
    "reports": REPORT_SIZE,
}


def in_arrays(core: Core) -> Core:
    """The core, also that of a snapshot, with arrays of its own."""
    own: dict[str, Any] = {}
    for name, columns in ARRAYS.items():
        own[name] = np.array(getattr(core, name), np.float64, order="C").reshape(-1, columns)
    return core._replace(**own)


def in_tuples(core: Core) -> Core:
    """The core as a snapshot keeps it: a value that nothing changes."""
    values: dict[str, Any] = {}
    for name in ARRAYS:
        values[name] = tuple(np.ravel(getattr(core, name)).tolist())
    return core._replace(**values)


def without_aiding(settings: Settings, now: Core) -> Core:
    """The core with the aiding blank, for when velocity does not help.

    What wheels have shown of the compass stays, unless they contradict it. So does a search that
    has just begun behind a hole.
    """
    blank = initial_core(settings)
    wheels = blank.aided.wheels if now.aided.wheels.contradict else now.aided.wheels
    return now._replace(
        aided=blank.aided._replace(wheels=wheels),
        consistency=blank.consistency,
        covariance=blank.covariance,
        velocity_history=blank.velocity_history,
        search=now.search if now.search.window.is_behind_hole else blank.search,
    )


def with_attitude(now: Core, q_ned_frd: Quaternion) -> Core:
    """The core with another attitude of the filter."""
    return now._replace(filter=now.filter._replace(q_ned_frd=q_ned_frd))


def apply_turn(now: Core, turn_ned: Quaternion, *, is_aided: bool) -> Core:
    """Turn every attitude by the same body rotation, q* K q of the filter's q."""
    q = now.filter.q_ned_frd
    turn_frd = multiply(conjugate(q), multiply(turn_ned, q))
    aided, consistency = now.aided, now.consistency
    if is_aided:
        estimate = aided.estimate
        aided_q = normalize(multiply(estimate.q_ned_frd, turn_frd))
        aided = aided._replace(estimate=estimate._replace(q_ned_frd=aided_q))
        consistency = consistency._replace(
            q_g_frd=normalize(multiply(consistency.q_g_frd, turn_frd))
        )
    memory, gathered = turn_memory(now.conditioning, now.gathered, turn_frd)
    return with_attitude(now, normalize(multiply(q, turn_frd)))._replace(
        conditioning=memory, gathered=gathered, aided=aided, consistency=consistency
    )


def with_turned_compass(
    settings: Settings, now: Core, turn_rad: float, sigma_rad: float, *, is_aided: bool
) -> Core:
    """The core for readings that are turned back by ``turn_rad`` about the body's down from now on.

    The unaided stage learns the field anew, and the aiding what is left of the turn, whose sigma is
    given. With a sigma of 0 the aiding has learnt this turn: it goes on with what is left, and the
    vehicle's own field turns with the readings.
    """
    now = now._replace(conditioning=forget_field(settings.conditioning, now.conditioning))
    if not is_aided:
        return now
    if sigma_rad > 0.0:
        P = now.covariance.copy()
        P[COMPASS_TURN, :] = P[:, COMPASS_TURN] = 0.0
        P[COMPASS_TURN, COMPASS_TURN] = sigma_rad**2
        estimate = now.aided.estimate._replace(compass_turn_rad=0.0)
        field = now.aided.field._replace(off_rad=0.0, far_off_s=0.0)
        aided = now.aided._replace(estimate=estimate, field=field)
        return now._replace(aided=aided, covariance=P)
    T, iron, back = np.eye(SIZE), slice(HARD_IRON, HARD_IRON + 3), exp((0.0, 0.0, -turn_rad))
    T[iron, iron] = rotation_matrix(back)
    estimate = now.aided.estimate
    estimate = estimate._replace(
        compass_turn_rad=estimate.compass_turn_rad - turn_rad,
        hard_iron_gauss=rotate(back, estimate.hard_iron_gauss),
    )
    aided = now.aided._replace(estimate=estimate)
    return now._replace(aided=aided, covariance=T @ now.covariance @ T.T)


def change_imu(settings: Settings, now: Core, *, is_aided: bool) -> Core:
    """The core with its attitude and velocity; the new sensors' biases are not known yet."""
    memory = forget_bias(settings.conditioning, now.conditioning)
    # what differs from others' rates is its own, too
    turning = STILL._replace(used=now.turning.used)
    now = now._replace(conditioning=memory, turning=turning, rates=())
    if not is_aided:
        return now
    aided, P = forget_biases(settings.aiding, now.aided, now.covariance)
    return now._replace(aided=aided, covariance=P)


class Context(NamedTuple):
    """What Python keeps beside the core."""

    phase: Phase = Phase.EMPTY
    reports: tuple[Any, ...] = ()  # of other sources than velocity, that wait for the IMU
    compass: Compass = Compass()  # what is known of it
    is_by_field: bool = False  # whether the aiding began with the field's heading
    last_position: LastPosition = LastPosition()  # and the field of the place
    imu_lag_s: float | None = None  # of the gyroscope's samples, as declared
    acc_lead_s: float = 0.0  # by how much the accelerometer's are younger
    vehicle_class: VehicleClass = VehicleClass.ANYTHING  # as declared


class Snapshot(NamedTuple):
    """Everything that changes. Restoring it resumes with the same results."""

    core: Core
    context: Context
