"""Means over a few samples, so that learning need not run at the sensor's rate."""

from estimator.compilation.compiled import inlined
from estimator.conditioning.gravity import to_frame
from estimator.conditioning.types import Gathered, Rows
from estimator.geometry.quaternion import scale
from estimator.types import ZERO_VEC3, Sample, Vec3

# Learning runs on the mean of samples over at least this time (s): a hundred
# times a second is plenty for values that change within seconds.
STEP_S = 0.0085

NOTHING = Gathered(
    time_s=0.0,
    gyr=ZERO_VEC3,
    acc=ZERO_VEC3,
    gravity_g=ZERO_VEC3,
    field_g=ZERO_VEC3,
    field_s=0.0,
)


@inlined
def accumulate(sum_: Vec3, v: Vec3, dt_s: float) -> Vec3:
    """Sum + v dt."""
    return (sum_[0] + v[0] * dt_s, sum_[1] + v[1] * dt_s, sum_[2] + v[2] * dt_s)


@inlined
def gather(sums: Gathered, rows_g: Rows, sample: Sample) -> Gathered:
    """Add one sample. Its vectors are turned to G, so that a mean is not blurred by turning."""
    gyr, acc, dt_s = sample.gyr_rad_s, sample.acc_m_s2, sample.dt_s
    field_g = sums.field_g
    field_s = sums.field_s
    if sample.has_mag:
        field_g = accumulate(field_g, to_frame(rows_g, sample.mag), dt_s)
        field_s += dt_s
    return Gathered(
        time_s=sums.time_s + dt_s,
        gyr=accumulate(sums.gyr, gyr, dt_s),
        acc=accumulate(sums.acc, acc, dt_s),
        gravity_g=accumulate(sums.gravity_g, to_frame(rows_g, acc), -dt_s),
        field_g=field_g,
        field_s=field_s,
    )


@inlined
def means(sums: Gathered) -> Gathered:
    """The sums over their times."""
    a = 1.0 / sums.time_s
    b = 1.0 / sums.field_s if sums.field_s > 0.0 else 0.0
    return Gathered(
        time_s=sums.time_s,
        gyr=scale(a, sums.gyr),
        acc=scale(a, sums.acc),
        gravity_g=scale(a, sums.gravity_g),
        field_g=scale(b, sums.field_g),
        field_s=sums.field_s,
    )
