"""When an attitude of a vehicle is shown, of which time, and how old it is called."""

from estimator.compilation.compiled import inlined
from service.host_clock import STEP_US, HostClock, lateness_us, to_vehicle_us

# While not all attitudes are published at each tick, one of an old sample still is this often.
REPEATED_US = 250_000
# A sample later than so many periods (and than STEP_US) is not made up for.
HELD_PERIODS = 2


@inlined
def is_due(is_new: bool, since_us: int) -> bool:
    """Whether there is a new sample since the attitude that was shown last, or none for long."""
    return is_new or not 0 <= since_us < REPEATED_US


@inlined
def shown_at(
    clock: HostClock, last_us: tuple[int, int], median_us: float, now_us: int
) -> tuple[int, int]:
    """The vehicle's time that is shown at ``now_us``, and how old its last sample is then (us).

    ``last_us`` is when that was taken, and when it arrived. If it came so late that the vehicle's
    clock may have stood still, the attitude is not turned on by that time: nobody knows whether it
    has passed.
    """
    taken_us, arrival_us = last_us
    since_us = now_us - arrival_us
    late_us = round(lateness_us(clock, taken_us, arrival_us))
    if late_us <= max(STEP_US, HELD_PERIODS * median_us):
        late_us = 0
    time_us = taken_us + since_us if late_us > 0 else to_vehicle_us(clock, now_us)
    return max(taken_us, time_us), since_us + late_us
