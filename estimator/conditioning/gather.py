"""Frame G, and means over a few samples, so that learning need not run at the sensor's rate."""

from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.conditioning.rate import Clipping
from estimator.geometry.axes import FrameAxes, to_frame
from estimator.geometry.quaternion import add, scale
from estimator.types import IDENTITY, ZERO_VEC3, Quaternion, Sample, Vec3

# Learning runs on means over at least this time (s), plenty for values that change in seconds.
STEP_S = 0.0185


class Gathered(NamedTuple):
    """What every sample changes: frame G, and sums, each times its dt, since the last step."""

    q_g_frd: Quaternion = IDENTITY  # body to G, as the gyroscope has carried it along
    gyr_rad_s: Vec3 = ZERO_VEC3  # the last sample's, FRD
    clipping: Clipping = Clipping()  # of the gyroscope
    goes: bool = False  # whether velocity shows that the vehicle goes somewhere
    time_s: float = 0.0  # that the samples stand for
    gyr: Vec3 = ZERO_VEC3  # rad, FRD
    acc: Vec3 = ZERO_VEC3  # m/s, FRD
    gravity_g: Vec3 = ZERO_VEC3  # minus the specific force, turned to G, m/s
    field_g: Vec3 = ZERO_VEC3  # corrected by the calibration, turned to G, field's unit times s
    field_s: float = 0.0  # time that the field's samples stand for


NOTHING = Gathered()  # before the first sample


@inlined
def gather(sums: Gathered, axes_g: FrameAxes, sample: Sample) -> Gathered:
    """Add one sample. Its vectors are turned to G, so that a mean is not blurred by turning."""
    gyr, acc, dt_s = sample.gyr_rad_s, sample.acc_m_s2, sample.dt_s
    sums = sums._replace(
        time_s=sums.time_s + dt_s,
        gyr=add(sums.gyr, scale(dt_s, gyr)),
        acc=add(sums.acc, scale(dt_s, acc)),
        gravity_g=add(sums.gravity_g, scale(-dt_s, to_frame(axes_g, acc))),
    )
    if not sample.has_mag:
        return sums
    field_g = add(sums.field_g, scale(dt_s, to_frame(axes_g, sample.mag)))
    return sums._replace(field_g=field_g, field_s=sums.field_s + dt_s)


@inlined
def means(sums: Gathered) -> Gathered:
    """The sums over their times."""
    a = 1.0 / sums.time_s
    b = 1.0 / sums.field_s if sums.field_s > 0.0 else 0.0
    return sums._replace(
        gyr=scale(a, sums.gyr),
        acc=scale(a, sums.acc),
        gravity_g=scale(a, sums.gravity_g),
        field_g=scale(b, sums.field_g),
    )


@inlined
def start_again(sums: Gathered) -> Gathered:
    """The same frame and gyroscope, with nothing summed."""
    clipping = sums.clipping._replace(aliasing=ZERO_VEC3)
    return NOTHING._replace(q_g_frd=sums.q_g_frd, gyr_rad_s=sums.gyr_rad_s, clipping=clipping)
