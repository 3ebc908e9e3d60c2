"""Parameters, state and result of the conditioning stage.

Angles are in rad, rates in rad/s, accelerations in m/s^2, times in s. The field
may be in any unit: only its direction and its relative changes are used. A
vector "turned to G" is expressed in the gyro-propagated frame, which drifts
slowly against the earth; "6D" is G made level, with an arbitrary heading; the
heading correction ``heading_rad`` turns 6D about the vertical to north.
"""

from math import radians
from typing import NamedTuple

from estimator.types import Quaternion, Vec3

# Upper triangle, row by row, of the covariance of (bias x, y, z, heading).
Covariance = tuple[float, float, float, float, float, float, float, float, float, float]
Six = tuple[float, float, float, float, float, float]


class ConditioningParams(NamedTuple):
    """What is chosen; every step has its own switch.

    Each line says: meaning; effect of a small and of a large value (unit).
    """

    # Switches, one a step.
    use_gravity_filter: bool = True  # low-pass specific force in G; off: each sample as it is
    use_inclination_frame: bool = (
        True  # keep the correction C; off: vertical from the low-pass only
    )
    use_rest: bool = True  # bias from rest
    use_motion_bias: bool = True  # bias from the inclination correction while moving
    use_joint_covariance: bool = True  # heading residuals also teach the bias
    use_horizontal_field: bool = True  # off: the whole measured field, dip and all
    use_soft_confidence: bool = True  # off: every field sample counts in full
    use_events: bool = True  # off: no reaction to an unsensed turn

    # Rest: how long things must be how quiet.
    rest_tau_s: float = 0.5  # low-pass of gyro and acc; small: noise, large: late
    rest_gyr_rad_s: float = radians(
        2.0
    )  # small: rest is missed, large: slow motion is taken for it
    rest_acc_m_s2: float = 0.5  # likewise
    rest_time_s: float = (
        1.5  # quiet for so long is rest; small: pauses in motion count, large: late
    )

    # Gravity.
    gravity_tau_s: float = 3.0  # small: acceleration tilts the vertical, large: drift does

    # Bias.
    bias_limit_rad_s: float = radians(2.0)  # of the bias and of one innovation
    bias_initial_sigma_rad_s: float = radians(0.5)  # small: slow start, large: jumpy start
    bias_walk_rad_s: float = radians(
        0.1
    )  # growth of sigma from 0 in 100 s; small: stiff, large: noisy
    bias_rest_sigma_rad_s: float = radians(0.03)  # steady sigma at rest; small: follows noise
    bias_motion_sigma_rad_s: float = radians(0.1)  # likewise, moving

    # Magnetic field.
    field_tau_s: float = (
        0.05  # low-pass of norm and dip; small: noise lowers confidence, large: late
    )
    field_norm_scale: float = 0.05  # relative deviation that counts as one; small: strict
    field_dip_scale_rad: float = radians(10.0)  # likewise for the dip
    field_reference_tau_s: float = (
        20.0  # learning; small: learns the magnet, large: keeps an old place
    )

    # Heading.
    heading_noise_rad2_s: float = radians(1.0) ** 2 * 150.0  # of the field's heading; large: slow
    heading_tau_s: float = 15.0  # steady time constant without bias error; small: follows magnets

    # Events.
    turn_heading_rad: float = radians(60.0)  # residual no honest drift reaches; small: false alarms
    turn_heading_time_s: float = 0.5  # for so long; small: false alarms, large: late
    turn_confidence: float = 0.8  # field at least as undisturbed as this
    turn_quiet_rad: float = radians(20.0)  # quiet, and gravity off by so much
    turn_quiet_time_s: float = 0.25
    turn_levelling_rad: float = radians(30.0)  # levelling that must have swung the heading too
    turn_levelling_tau_s: float = 3.0

    # Source.
    averaged_samples: bool = False  # samples are means over their interval, not instants
    declination_rad: float = 0.0  # of the magnetic inertial vector, east positive


class LowPass(NamedTuple):
    """Coefficients of the second-order Butterworth low-pass for one time step."""

    own: float
    cross: float
    rate: float


class Coefficients(NamedTuple):
    """What follows from the parameters and the time step, kept until that changes."""

    dt_s: float
    rest: LowPass
    gravity: LowPass
    levelling_decay: float
    bias_growth: float
    rest_noise: float
    motion_noise: float
    heading_growth: float


class Smooth(NamedTuple):
    """A low-passed vector and its scaled derivative (tau times d/dt)."""

    value: Vec3
    slope: Vec3


class RestState(NamedTuple):
    """Quiet is the instant's verdict, rest that of the last ``rest_time_s``."""

    gyr: Smooth
    acc: Smooth
    quiet: bool
    quiet_s: float
    resting: bool


class GravityState(NamedTuple):
    """Frame G, the low-passed gravity in it, and its levelling."""

    q_g_frd: Quaternion
    q_6d_g: Quaternion
    down: Smooth
    levelling_rate_rad_s: tuple[float, float]  # of the last step, horizontal, in 6D
    age_s: float


class BiasState(NamedTuple):
    """Gyro bias and heading with one covariance, and what the moving bias needs."""

    bias_rad_s: Vec3
    heading_rad: float
    covariance: Covariance
    rows: Six  # low-passed first two rows of R6
    rows_slope: Six
    drift: tuple[float, float]  # low-passed R6 b
    drift_slope: tuple[float, float]


class MagneticState(NamedTuple):
    """Horizontal and downward part of the field, and their learnt references."""

    horizontal: float
    down: float
    horizontal_reference: float
    down_reference: float
    samples: float
    age_s: float
    wait_s: float  # since the last sample
    confidence: float
    known: bool


class EventState(NamedTuple):
    """How long each sign of an unsensed turn has lasted."""

    heading_s: float
    quiet_s: float
    levelled: tuple[float, float]


class ConditioningState(NamedTuple):
    """Everything that changes; a snapshot is the state itself."""

    coefficients: Coefficients
    previous_gyr_rad_s: Vec3
    started: bool
    rest: RestState
    gravity: GravityState
    bias: BiasState
    magnetic: MagneticState
    event: EventState


class Conditioned(NamedTuple):
    """The paper's vectors, and what else the filter and the publisher need.

    ``*_b`` are unit vectors measured in the body, ``*_i`` their inertial
    counterparts. The weights are 0 while a vector is unknown and 1 afterwards;
    the confidences, 0..1, describe this sample.
    """

    rate_rad_s: Vec3
    bias_rad_s: Vec3
    gravity_b: Vec3
    gravity_i: Vec3
    magnetic_b: Vec3
    magnetic_i: Vec3
    gravity_weight: float
    magnetic_weight: float
    gravity_confidence: float
    magnetic_confidence: float
    sigma_inclination_rad: float
    sigma_heading_rad: float
    resting: bool
    turned_gravity: bool
    turned_heading: bool
