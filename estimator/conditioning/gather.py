"""Means over a few samples, so that learning need not run at the sensor's rate."""

from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.geometry.axes import FrameAxes, to_frame
from estimator.geometry.quaternion import add, scale
from estimator.types import ZERO_VEC3, Sample, Vec3

# Learning runs on means over at least this time (s), plenty for values that change in seconds.
STEP_S = 0.0085


class Gathered(NamedTuple):
    """Sums, each times its dt, since the last learning step."""

    time_s: float = 0.0  # that the samples stand for
    gyr: Vec3 = ZERO_VEC3  # rad, FRD
    acc: Vec3 = ZERO_VEC3  # m/s, FRD
    gravity_g: Vec3 = ZERO_VEC3  # minus the specific force, turned to G, m/s
    field_g: Vec3 = ZERO_VEC3  # corrected by the calibration, turned to G, field's unit times s
    field_s: float = 0.0  # time that the field's samples stand for


NOTHING = Gathered()


@inlined
def gather(sums: Gathered, axes_g: FrameAxes, sample: Sample) -> Gathered:
    """Add one sample. Its vectors are turned to G, so that a mean is not blurred by turning."""
    gyr, acc, dt_s = sample.gyr_rad_s, sample.acc_m_s2, sample.dt_s
    field_g = sums.field_g
    field_s = sums.field_s
    if sample.has_mag:
        field_g = add(field_g, scale(dt_s, to_frame(axes_g, sample.mag)))
        field_s += dt_s
    return Gathered(
        time_s=sums.time_s + dt_s,
        gyr=add(sums.gyr, scale(dt_s, gyr)),
        acc=add(sums.acc, scale(dt_s, acc)),
        gravity_g=add(sums.gravity_g, scale(-dt_s, to_frame(axes_g, acc))),
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
