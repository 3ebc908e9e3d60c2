"""What makes a sample unusable, whatever the filter."""

from math import isfinite

from estimator.reasons import Reason
from estimator.types import ImuSample, Vec3, VelocitySample

# A rate beyond this is no vehicle's: 70 rad/s is 4000 deg/s, twice the range of common gyroscopes.
GYR_LIMIT_RAD_S = 70.0
# 40 g, well beyond the range of common accelerometers.
ACC_LIMIT_M_S2 = 400.0


def refusal(sample: ImuSample) -> Reason | None:
    """Why a sample cannot be used, None if it can."""
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
        return Reason.NOT_FINITE
    if max(abs(gx), abs(gy), abs(gz)) > GYR_LIMIT_RAD_S:
        return Reason.GYROSCOPE_OUT_OF_RANGE
    return Reason.ACCELEROMETER_OUT_OF_RANGE


def sample_in_floats(sample: ImuSample) -> ImuSample:
    """The sample with floats only, as compiled code takes them: a stream may hold integers."""
    gyr, acc, mag = sample.gyr_rad_s, sample.acc_m_s2, sample.mag_gauss
    if (
        type(gyr[0]) is type(gyr[1]) is type(gyr[2]) is float
        and type(acc[0]) is type(acc[1]) is type(acc[2]) is float
        and type(mag[0]) is type(mag[1]) is type(mag[2]) is float
    ):  # as nearly always
        return sample
    return ImuSample(sample.time_us, _floats(gyr), _floats(acc), _floats(mag), bool(sample.has_mag))


def report_in_floats(report: VelocitySample) -> VelocitySample:
    """Likewise of a velocity report."""
    return report._replace(
        velocity_ned_m_s=_floats(report.velocity_ned_m_s),
        has_vertical=bool(report.has_vertical),
        sigma_m_s=float(report.sigma_m_s),
        late_sigma_s=float(report.late_sigma_s),
    )


def _floats(v: Vec3) -> Vec3:
    return (float(v[0]), float(v[1]), float(v[2]))
