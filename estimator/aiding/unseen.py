"""What a slow stream's gyroscope hides between two samples, by how rough its readings are.

Readings on a line are those of a motion that the samples show; integration misses a small share of
how far they lie off it. Independent readings, of a vehicle shaken faster than it is sampled, show
hardly anything of the turning between them. The mean square of second differences shows which they
are: it is three times that of first differences for independent readings, and much less for smooth
ones.
"""

from estimator.aiding.inertial import differences
from estimator.aiding.types import TURN, VELOCITY, AidingParams, Array, LastStep, Roughness
from estimator.compilation.compiled import inlined
from estimator.conditioning.params import LATELY_S, LONGEST_STEP_S, SPAN_S
from estimator.conditioning.rate import likeness, slow_share
from estimator.conditioning.vertical.tilt import HOLE_RAD_S
from estimator.geometry.quaternion import square
from estimator.types import STANDARD_GRAVITY_M_S2, UNSEEN_STEP_S, Sample

# A smooth motion's readings have half of that and more at turns; the power leaves them out.
SHARPNESS = 3
# What a vehicle may gain in a hole beyond what the readings at its ends show, m/s^2: it tilts.
HOLE_M_S2 = HOLE_RAD_S * STANDARD_GRAVITY_M_S2


@inlined
def watch_turning(
    params: AidingParams,
    last: LastStep,
    rough: Roughness,
    P: Array,
    sample: Sample,
    aliasing: float,
) -> Roughness:
    """Add what a slow stream's step has missed to the covariance, in place.

    About both level axes this is at least ``aliasing`` (rad^2), as the unaided stage has it, if the
    readings look independent now or did lately. Readings nearer than ``UNSEEN_STEP_S`` show more
    than that: at 4 Hz it cost headings beside a compass' faults.
    """
    second_difference, change, seen_s = differences(last, sample)
    second, first, dt = square(second_difference), square(change), sample.dt_s
    level = 0.0
    if seen_s > UNSEEN_STEP_S:
        lately = likeness(max(second, rough.second_difference), max(first, rough.changed))
        level = 0.5 * aliasing * lately
    north, east = P[TURN, TURN] + level, P[TURN + 1, TURN + 1] + level
    add_unseen_turn(params, P, rough, second, dt, seen_s)
    add_hole(P, dt)
    P[TURN, TURN] = max(P[TURN, TURN], north)
    P[TURN + 1, TURN + 1] = max(P[TURN + 1, TURN + 1], east)
    share = dt / (LATELY_S + dt)
    return rough._replace(
        second_difference=rough.second_difference + share * (second - rough.second_difference),
        changed=rough.changed + share * (first - rough.changed),
    )


@inlined
def add_unseen_turn(
    params: AidingParams, P: Array, rough: Roughness, second: float, dt: float, seen_s: float
) -> None:
    """Variance of the turn that a step has missed, in place; ``second`` is in (rad/s)^2.

    The mean of two independent instants is off the mean over the step by 0.29 of the second
    difference, about every axis. The turning is seen every ``seen_s``.
    """
    slow = slow_share(seen_s)
    if slow <= 0.0:
        return
    share = params.unseen_turn_noise * seen_s / (seen_s + LONGEST_STEP_S)
    most = max(second, rough.second_difference)  # one even pair may be chance
    independent = likeness(rough.second_difference, rough.changed) ** SHARPNESS
    variance = slow * share * share * independent * most * dt * seen_s / 3.0
    for i in range(TURN, TURN + 3):
        P[i, i] += variance


@inlined
def add_hole(P: Array, dt: float) -> None:
    """Variance of a hole, in place: in it a vehicle may have turned and gained speed anyhow."""
    hole_s = dt - SPAN_S
    if hole_s <= 0.0:
        return
    for i in range(3):
        P[TURN + i, TURN + i] += (HOLE_RAD_S * hole_s) ** 2
        P[VELOCITY + i, VELOCITY + i] += (HOLE_M_S2 * hole_s) ** 2
