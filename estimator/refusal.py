"""What makes a sample unusable, whatever the filter."""

from math import isfinite

from estimator.types import ImuSample

# A rate beyond this is no vehicle's: 70 rad/s is 4000 deg/s, twice the range of common gyroscopes.
GYR_LIMIT_RAD_S = 70.0
# 40 g, well beyond the range of common accelerometers.
ACC_LIMIT_M_S2 = 400.0


def refusal(sample: ImuSample) -> str | None:
    """Why a sample cannot be used, in one word to count under; None if it can."""
    gx, gy, gz = sample.gyr_rad_s
    ax, ay, az = sample.acc_m_s2
    mx, my, mz = sample.mag_gauss
    # all samples come through here: one chain of comparisons, which no NaN passes
    if (
        -GYR_LIMIT_RAD_S <= gx <= GYR_LIMIT_RAD_S
        and -GYR_LIMIT_RAD_S <= gy <= GYR_LIMIT_RAD_S
        and -GYR_LIMIT_RAD_S <= gz <= GYR_LIMIT_RAD_S
        and -ACC_LIMIT_M_S2 <= ax <= ACC_LIMIT_M_S2
        and -ACC_LIMIT_M_S2 <= ay <= ACC_LIMIT_M_S2
        and -ACC_LIMIT_M_S2 <= az <= ACC_LIMIT_M_S2
        and isfinite(mx)
        and isfinite(my)
        and isfinite(mz)
    ):
        return None
    if not all(map(isfinite, (gx, gy, gz, ax, ay, az, mx, my, mz))):
        return "not_finite"
    if max(abs(gx), abs(gy), abs(gz)) > GYR_LIMIT_RAD_S:
        return "gyroscope_out_of_range"
    return "accelerometer_out_of_range"
