"""The health of one vehicle's estimate: states and allowed transitions as one table.

Silence is data: the states follow from the samples that arrive and from how
long none has arrived. Times are given, no clock is read.
"""

from enum import StrEnum

from drivers.value import Value


class State(StrEnum):
    """What the published attitude is worth."""

    WAITING = "waiting"  # the vehicle has been heard, no IMU sample has come yet
    ALIGNING = "aligning"  # IMU data arrive, no attitude yet
    RUNNING = "running"  # attitude from fresh data
    DEGRADED = "degraded"  # attitude, extrapolated: the IMU is silent
    LOST = "lost"  # silent for so long that no attitude is published


class Signal(StrEnum):
    """What can happen to a state."""

    SAMPLE = "sample"  # an IMU sample came, the estimator is not aligned
    ALIGNED = "aligned"  # an IMU sample came, the estimator is aligned
    LATE = "late"  # no IMU sample for late_after_us
    SILENT = "silent"  # no IMU sample for lost_after_us


TRANSITIONS: dict[tuple[State, Signal], State] = {
    (State.WAITING, Signal.SAMPLE): State.ALIGNING,
    (State.WAITING, Signal.ALIGNED): State.RUNNING,
    (State.ALIGNING, Signal.ALIGNED): State.RUNNING,
    (State.ALIGNING, Signal.SILENT): State.LOST,
    (State.RUNNING, Signal.SAMPLE): State.ALIGNING,  # the clock began anew
    (State.RUNNING, Signal.LATE): State.DEGRADED,
    (State.RUNNING, Signal.SILENT): State.LOST,
    (State.DEGRADED, Signal.SAMPLE): State.ALIGNING,
    (State.DEGRADED, Signal.ALIGNED): State.RUNNING,
    (State.DEGRADED, Signal.SILENT): State.LOST,
    (State.LOST, Signal.SAMPLE): State.ALIGNING,
    (State.LOST, Signal.ALIGNED): State.RUNNING,
}
"""Every pair that is not listed leaves the state as it is."""

HAS_ATTITUDE = frozenset({State.RUNNING, State.DEGRADED})

LATE_MINIMUM_US = 500_000
LATE_PERIODS = 3
LOST_MINIMUM_US = 5_000_000
LOST_PERIODS = 10


class Health(Value, frozen=True):
    """The state and when the last IMU sample arrived (host time; None before the first)."""

    state: State = State.WAITING
    last_arrival_us: int | None = None


def next_state(state: State, signal: Signal) -> State:
    """The state that follows ``state`` when ``signal`` happens."""
    return TRANSITIONS.get((state, signal), state)


def late_after_us(median_period_us: float) -> float:
    """Silence that makes a running estimate degraded: max(0.5 s, 3 median periods)."""
    return max(LATE_MINIMUM_US, LATE_PERIODS * median_period_us)


def lost_after_us(median_period_us: float) -> float:
    """Silence after which a vehicle is lost: max(5 s, 10 median periods)."""
    return max(LOST_MINIMUM_US, LOST_PERIODS * median_period_us)


def is_left_out(silence_us: int, unheard_us: int, median_period_us: float) -> bool:
    """Whether a silence is no vehicle's, where samples are left out: others of it do come."""
    is_heard = unheard_us < late_after_us(median_period_us)
    return is_heard and silence_us < lost_after_us(median_period_us)


def on_sample(health: Health, arrival_us: int, *, aligned: bool) -> Health:
    """The health after an IMU sample."""
    if aligned and health.state is State.RUNNING:
        return Health(State.RUNNING, arrival_us)  # the usual case, without a look at the table
    signal = Signal.ALIGNED if aligned else Signal.SAMPLE
    return Health(next_state(health.state, signal), arrival_us)


def on_time(health: Health, now_us: int, median_period_us: float) -> Health:
    """The health at ``now_us``, given the IMU's median period (0 if unknown)."""
    if health.last_arrival_us is None:
        return health
    silence_us = now_us - health.last_arrival_us
    if silence_us < LATE_MINIMUM_US:
        return health
    if silence_us >= lost_after_us(median_period_us):
        return Health(next_state(health.state, Signal.SILENT), health.last_arrival_us)
    if silence_us >= late_after_us(median_period_us):
        return Health(next_state(health.state, Signal.LATE), health.last_arrival_us)
    return health
