"""Parameters and state of the velocity aiding.

Its errors are small turns of the attitude seen from NED and differences of
everything else, in the order of the constants below.
"""

from itertools import accumulate
from math import radians
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.bounds import Acceleration, Angle, Field, Lag, Noise, Rate, Share, Speed, Time
from estimator.conditioning.field.magnetic import FieldLook
from estimator.types import IDENTITY, ZERO_VEC3, Quaternion, Vec2, Vec3

Array = NDArray[np.float64]

# How many components each error has in the covariance, and where it begins there.
COMPONENTS = {
    "turn": 3,  # rad, about north, east and down
    "velocity": 3,  # m/s
    "gyr_bias": 3,  # rad/s
    "acc_bias": 3,  # m/s^2
    "imu_lag": 1,  # s
    "field_lag": 1,  # s
    "compass_turn": 1,  # rad, of the compass in the vehicle, about the body's down
    "hard_iron": 3,  # gauss
    "earth": 3,  # gauss, the place's field in NED
    "receiver_lag": 1,  # s, of a receiver's reports
    "filter_lag": 1,  # s, of those of an autopilot's filter
    "receiver_error": 3,  # m/s, the slow error of a receiver's reports
    "filter_error": 3,  # m/s, the slow error of an autopilot's filter
}
(
    TURN,
    VELOCITY,
    GYR_BIAS,
    ACC_BIAS,
    IMU_LAG,
    FIELD_LAG,
    COMPASS_TURN,
    HARD_IRON,
    EARTH,
    RECEIVER_LAG,
    FILTER_LAG,
    RECEIVER_ERROR,
    FILTER_ERROR,
    SIZE,
) = accumulate(COMPONENTS.values(), initial=0)


class AidingParams(NamedTuple):
    """What is chosen; each line: meaning; effect of a small and of a large value (unit)."""

    enabled: bool = True  # off: velocity is not used

    # Noise of the IMU, as densities.
    gyr_slow_noise_1_s: Noise = 0.04  # of the rate, for each second of the IMU's step
    acc_noise: Noise = 0.05  # m/s^2/sqrt(Hz); vibration; small: stiff, large: slow
    # Errors of integration, as a share of a reading's distance from the line through two before it.
    integration_noise: Noise = 0.1  # small: relies on 4 Hz samples, large: hardly
    unseen_turn_noise: Noise = 0.3  # of readings a second apart; small: relies on the gyroscope
    # Initial biases, and their change in 2500 s.
    gyr_bias_sigma: Rate = 0.015  # rad/s; small: stiff, large: noisy
    acc_bias_sigma: Acceleration = 0.05  # m/s^2; small: stiff, large: noisy

    # Velocity reports.
    filter_noise_m_s: Speed = 0.05  # of a report by an autopilot's filter
    filter_error_m_s: Speed = 0.2  # its slow error; small: follows it, large: follows the receiver
    filter_turning_s: Lag = 0.03  # more for each m/s^2 of horizontal acceleration
    receiver_noise_m_s: Speed = 0.1  # of a receiver's report
    receiver_error_m_s: Speed = 0.15  # its slow error; small: follows it, large: follows the filter
    error_tau_s: Time = 5.0  # time constant of both slow errors
    report_sigma_m_s: Speed = 0.3  # sources less accurate than this get more noise
    sideslip_rad: Angle = 3.0  # 0.05 for wheels, also by a HEARTBEAT; 3: any direction

    # Lags.
    imu_lag_s: Lag = 0.012  # of an autopilot's IMU stream, and the error of its filter's time

    # Magnetic field.
    heading_noise: Noise = radians(3.0)  # rad/sqrt(Hz); small: follows magnets, large: slow
    hard_iron_sigma_gauss: Field = 0.02  # that calibration leaves
    field_dip_scale_rad: Angle = radians(10.0)  # dip error that about halves the weight

    # Published uncertainty, fitted to errors of simulated and recorded flights.
    colour: Share = 1.5  # sigma over that for white noise: velocity errors are slower
    least_scale: Share = 0.28  # of the covariance's sigma, however well reports agree
    scatter_share: Share = 2.3  # part of the reports' scatter due to the attitude


class Report(NamedTuple):
    """A velocity in NED, ``ago_s`` before the IMU sample at hand; absent where not ``given``."""

    given: bool = False  # whether there is one; if not, the rest means nothing
    velocity_ned_m_s: Vec3 = ZERO_VEC3  # over ground
    has_vertical: bool = False  # whether the third component is known
    sigma_m_s: float = 0.0  # the source's accuracy, 1 sigma
    ago_s: float = 0.0  # age at the IMU sample
    late_sigma_s: float = 0.0  # uncertainty of that age, 1 sigma; 0 where it is exact


NO_REPORT = Report()


class FieldState(NamedTuple):
    """What is known about the field of the place, and how well measurements agree with it."""

    look: FieldLook = FieldLook(0.0, 0.0, 1.0)  # in NED, gauss
    off_rad: float = 0.0  # low-passed angle by which its heading is off the estimate
    samples: float = 0.0  # of the field so far
    wait_s: float = 0.0  # since the last sample of the field
    far_off_s: float = 0.0  # how long the heading has been far off
    evidence: float = 0.0  # for the place's field as read, against what was learnt; 2 ln of a ratio


class Scatter(NamedTuple):
    """How the velocity reports scatter about their prediction."""

    noise_scale: float = 1.0  # of the reports' variance; under 1 only of those that no IMU has made
    innovation: float = 1.0  # mean square, in units of its expected variance
    reports: float = 0.0  # components of reports so far
    latest: Vec3 = ZERO_VEC3  # innovation, in units of its expected sigma
    together: float = 0.0  # mean product of an innovation and the one before, in such units


class Agreement(NamedTuple):
    """How well one source's reports agree with the prediction, and how long they have not."""

    scatter: Scatter = Scatter()  # of reports about their prediction
    wait_s: float = 0.0  # since the last report
    far_off_s: float = 0.0  # how long reports have been far off


class Agreements(NamedTuple):
    """The agreements of both sources: an autopilot's filter, and a receiver."""

    by_filter: Agreement = Agreement()  # reports whose age is known
    by_receiver: Agreement = Agreement()  # reports whose age is uncertain


class AidingEstimate(NamedTuple):
    """What is estimated, in the order of its errors."""

    q_ned_frd: Quaternion = IDENTITY  # body to NED
    velocity_ned_m_s: Vec3 = ZERO_VEC3  # over ground
    gyr_bias_rad_s: Vec3 = ZERO_VEC3  # FRD
    acc_bias_m_s2: Vec3 = ZERO_VEC3  # FRD
    imu_lag_s: float = 0.0  # age of the gyroscope's samples
    field_lag_s: float = 0.0  # age of the magnetometer's readings
    compass_turn_rad: float = 0.0  # by which its readings are turned in the vehicle, about down
    hard_iron_gauss: Vec3 = ZERO_VEC3  # the vehicle's own field, FRD
    earth_gauss: Vec3 = ZERO_VEC3  # the place's field, NED
    receiver_lag_s: float = 0.0  # age of reports that do not know theirs
    filter_lag_s: float = 0.0  # how much older the others are than stamped
    receiver_error_m_s: Vec3 = ZERO_VEC3  # slow error of a receiver's reports, NED
    filter_error_m_s: Vec3 = ZERO_VEC3  # slow error of a filter's reports, NED
    acc_lead_s: float = 0.0  # by how much the accelerometer's samples are younger; never learnt


class LastStep(NamedTuple):
    """The last sample, as the next step needs it."""

    gyr_rad_s: Vec3  # as read, FRD
    gyr_before_rad_s: Vec3  # one sample earlier, FRD
    force_ned_m_s2: Vec3  # specific force, NED
    rate_rad_s: Vec3  # free of bias, with which the step was integrated, FRD
    dt_s: float  # length of the step


class Sigmas(NamedTuple):
    """The angles that 68 % of the errors lie under."""

    inclination_rad: float  # of the error of down
    heading_rad: float  # of the error about down


class Roughness(NamedTuple):
    """Mean squares over the latest readings."""

    # of how far the gyroscope's lie off the line through the two before, (rad/s)^2
    second_difference: float = 0.0
    changed: float = 0.0  # of the differences of two of them, (rad/s)^2
    knocked: float = 0.0  # of how far the forces lie off such a line, (m/s^2)^2; one counts little


class AccelerationTilt(NamedTuple):
    """How the vehicle has accelerated over the last seconds, by IMU and reports; NED."""

    felt_m_s2: Vec3  # mean acceleration by the IMU, seen through the attitude
    reported_m_s: Vec3  # mean of the reported velocities
    latest_m_s: Vec3  # the last report


class CorrectionCusum(NamedTuple):
    """What was corrected lately, fading, and the variance that this should have (rad^2)."""

    turn_rad: Vec3  # of the attitude, by corrections and by the bias they have changed, NED
    bias_rad_s: Vec3  # mean bias of the gyroscope, FRD
    least_variance: float  # that the bias has ever had, all axes together, (rad/s)^2
    level: float  # expected mean square of the turn about north and east
    heading: float  # and about down


class Wheels(NamedTuple):
    """What is known of wheels, and what they have shown."""

    slip_scale: float = 1.0  # variance of slips, in units of what is expected
    rolled_s: float = 0.0  # for how long only slips have hidden the heading
    contradict: bool = False  # the heading that it began with: velocity points elsewhere
    show_north: bool = False  # that the field points there, which iron may have turned


class GyroscopeFault(NamedTuple):
    """Errors of the gyroscope's axes that field and force show and velocity confirms."""

    innovations: Vec3 = ZERO_VEC3  # sum of the reports', NED, each in its usual sigma; fading
    variance: float = 0.0  # of that sum if they are noise
    squares: Vec3 = ZERO_VEC3  # squared errors of the axes, (rad/s)^2, fading; mostly 0


class BiasPrior(NamedTuple):
    """Variance of an axis' bias as long as nothing has shown it."""

    gyr: float  # (rad/s)^2
    acc: float  # (m/s^2)^2


class AidingState(NamedTuple):
    """Everything that changes but the errors' covariance, which the kernels take as an array."""

    estimate: AidingEstimate  # attitude, velocity, biases, lags, fields
    last: LastStep  # the sample that the next step begins from
    sigma: Sigmas  # as published
    acceleration_tilt: AccelerationTilt  # what deceives the unaided vertical
    correction_cusum: CorrectionCusum  # what was corrected lately
    bias_prior: BiasPrior  # what biases may be
    field: FieldState = FieldState()  # how the magnetometer agrees
    agreement: Agreements = Agreements()  # how the velocity reports agree
    rough: Roughness = Roughness()  # the gyroscope's readings
    wheels: Wheels = Wheels()  # what they have shown
    gyroscope_fault: GyroscopeFault = GyroscopeFault()


class North(NamedTuple):
    """Magnetic north, as far as it is known."""

    is_known: bool
    direction: Vec2  # unit vector (north, east) in NED; counts only where it is known


class WrongForce(NamedTuple):
    """A force that asks for a turn of the attitude which the vehicle has not made."""

    turn_back_rad: Vec3 = ZERO_VEC3  # turn (NED) that undoes what it has done to the attitude
    bias_back_rad_s: Vec3 = ZERO_VEC3  # and to the gyroscope's bias, FRD
    variance: float = 0.0  # mean square by which an axis of it may be wrong, (m/s^2)^2; 0: none


NO_WRONG_FORCE = WrongForce()


class StepInputs(NamedTuple):
    """What other stages know about a sample."""

    gravity_b: Vec3  # down by the unaided conditioning stage, a unit vector in FRD
    gravity_sigma_rad: float  # of that
    aliasing: float  # variance of the turn about both level axes that the last step missed, rad^2
    north: North
    place_gauss: Vec3 = ZERO_VEC3  # the place's field by a model, NED; zero if unknown
    unsensed_turn: float = 0.0  # variance (rad^2) about any axis of a turn just shown; mostly 0
    force_scatter: float = 0.0  # mean square angle (rad^2) of a second's force off the vertical
    wrong_force: WrongForce = NO_WRONG_FORCE  # found at the last sample
    gyr_errors: Vec3 = ZERO_VEC3  # of contradicted axes, rad/s; above 0: reads too much
