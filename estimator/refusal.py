"""What makes a sample unusable, whatever the filter."""

from math import isfinite

from estimator.types import ImuSample

# A rate beyond this is no vehicle's: 70 rad/s is 4000 deg/s, twice the range of common gyroscopes.
GYR_LIMIT_RAD_S = 70.0
# 40 g, well beyond the range of common accelerometers.
ACC_LIMIT_M_S2 = 400.0


def refusal(sample: ImuSample) -> str | None:
    """Why a sample cannot be used, in one word to count under; None if it can."""
    if not all(isfinite(x) for x in (*sample.gyr_rad_s, *sample.acc_m_s2, *sample.mag_gauss)):
        return "not_finite"
    if max(abs(x) for x in sample.gyr_rad_s) > GYR_LIMIT_RAD_S:
        return "gyroscope_out_of_range"
    if max(abs(x) for x in sample.acc_m_s2) > ACC_LIMIT_M_S2:
        return "accelerometer_out_of_range"
    return None
