"""What makes a sample unusable, whatever the filter, and what is a gap before one."""

from math import isfinite

from estimator.aiding.search import UNKNOWN_RAD
from estimator.compilation.compiled import inlined
from estimator.conditioning.params import SPAN_S
from estimator.conditioning.rate import FAST_STEP_S
from estimator.conditioning.vertical.tilt import HOLE_RAD_S
from estimator.reasons import Reason
from estimator.types import Vec3

# A rate beyond this is no vehicle's: 70 rad/s is 4000 deg/s, twice the range of common gyroscopes.
RATE_LIMIT_RAD_S = 70.0
# 40 g, well beyond the range of common accelerometers.
ACC_LIMIT_M_S2 = 400.0

# What is wrong with a sample, as compiled code returns it: its place here.
REASONS = (
    None,
    Reason.NOT_FINITE,
    Reason.GYROSCOPE_OUT_OF_RANGE,
    Reason.ACCELEROMETER_OUT_OF_RANGE,
    Reason.NOT_LATER,  # than the sample before
)
FINE, NOT_FINITE, GYROSCOPE_OUT_OF_RANGE, ACCELEROMETER_OUT_OF_RANGE, NOT_LATER = range(5)


@inlined
def fault_of(gyr: Vec3, acc: Vec3, mag: Vec3, is_later: bool = True) -> int:
    """What is wrong with a sample, :data:`FINE` if it can be used."""
    gyr_is_finite = isfinite(gyr[0]) and isfinite(gyr[1]) and isfinite(gyr[2])
    acc_is_finite = isfinite(acc[0]) and isfinite(acc[1]) and isfinite(acc[2])
    mag_is_finite = isfinite(mag[0]) and isfinite(mag[1]) and isfinite(mag[2])
    if not (gyr_is_finite and acc_is_finite and mag_is_finite):
        return NOT_FINITE
    if max(abs(gyr[0]), abs(gyr[1]), abs(gyr[2])) > RATE_LIMIT_RAD_S:
        return GYROSCOPE_OUT_OF_RANGE
    if max(abs(acc[0]), abs(acc[1]), abs(acc[2])) > ACC_LIMIT_M_S2:
        return ACCELEROMETER_OUT_OF_RANGE
    return FINE if is_later else NOT_LATER


# Of a new interval in the mean, which so goes back over about ten samples.
SHARE = 0.1
# One gap is no new rate: an interval counts up to this many mean ones.
MOST_INTERVALS = 2.0
# After so many mean intervals without a sample something is missing.
GAP_INTERVALS = 3.0
# The readings at both ends of a fast stream's hole show how the vehicle turned, and velocity
# corrects the rest within a second, as long as the attitude is not lost.
LONGEST_GAP_S = SPAN_S + UNKNOWN_RAD / HOLE_RAD_S


@inlined
def mean_interval(interval_s: float, dt_s: float) -> float:
    """The mean interval after one more; 0 means none before."""
    if interval_s <= 0.0:
        return dt_s
    return interval_s + (min(dt_s, MOST_INTERVALS * interval_s) - interval_s) * SHARE


@inlined
def is_gap(interval_s: float, dt_s: float) -> bool:
    """Whether the interval is too long for the estimate to continue through it."""
    longest_s = LONGEST_GAP_S if interval_s < FAST_STEP_S else SPAN_S
    return dt_s > longest_s and dt_s > GAP_INTERVALS * interval_s
