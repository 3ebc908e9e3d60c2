"""Parameters, state and result of the conditioning stage.

Angles are in rad, rates in rad/s, accelerations in m/s^2, times in s. The field
may be in any unit: only its direction and its relative changes are used.

Frames: G is the gyro-propagated frame, almost inertial, which drifts slowly
against the earth; 6D is G made level by the correction C, with an arbitrary
heading; the heading correction turns 6D about down to north.
"""

from math import radians
from typing import NamedTuple

from estimator.bounds import Acceleration, Angle, Lag, Noise, Rate, Share, Time
from estimator.types import Quaternion, Vec3

# Upper triangle, row by row, of the covariance of three values and a fourth.
Covariance = tuple[float, float, float, float, float, float, float, float, float, float]
Six = tuple[float, float, float, float, float, float]
Two = tuple[float, float]


class ConditioningParams(NamedTuple):
    """What is chosen; every step has its own switch.

    Each line says: meaning; effect of a small and of a large value. Units are
    in the names.
    """

    # Switches, one a step.
    use_gravity_filter: bool = True  # low-pass the specific force in G; off: each mean as it is
    use_rest: bool = True  # bias from rest
    use_motion_bias: bool = True  # bias from levelling while moving
    use_averaging: bool = True  # gravity, for as long as shaking and turning ask for
    use_scale_error: bool = True  # the gyroscope's, from levelling in a steady turn
    use_joint_covariance: bool = True  # heading residuals also teach the bias
    use_lag: bool = True  # undo the magnetometer's lag, learnt while turning
    use_field_offset: bool = True  # take off the vehicle's own field, likewise
    use_confidence: bool = True  # off: every field sample counts in full
    use_events: bool = True  # off: no reaction to an unsensed turn
    use_step_noise: bool = True  # off: slow streams are treated as fast ones

    # Rest: how long things must be how quiet.
    rest_tau_s: Time = 0.5  # low-pass of gyro and acc; small: noise, large: late
    rest_gyr_rad_s: Rate = radians(2.0)  # small: rest is missed, large: slow motion passes for it
    rest_acc_m_s2: Acceleration = 0.5  # likewise
    rest_time_s: Time = 1.5  # small: pauses in motion pass for rest, large: late

    # Gravity.
    gravity_tau_s: Time = 2.5  # small: acceleration tilts the vertical, large: gyro drift does

    # What a slow step misses of a turn, and how a force's direction scatters.
    step_change_noise: Share = 0.45  # share of a change of rate; small: trusts the gyroscope
    step_change_s: Time = 0.12  # step at which it is half of that; likewise
    step_change_tau_s: Time = 3.0  # for so long past changes count; small: forgets motion
    step_change_memory: Share = 0.8  # their part; small: one even pair passes for calm
    step_turn_noise_1_s: Share = 0.4  # share of the rate itself, for each second of the step
    force_lasts_s: Time = 0.35  # of accelerations; small: believes the force, large: the gyroscope
    force_size_noise: Share = 1.0  # rad for a force of twice its size; likewise
    scatter_tau_s: Time = 7.0  # averaging of the scatter; small: jumpy, large: late

    # Bias.
    bias_limit_rad_s: Rate = radians(2.0)  # of the bias and of one innovation
    bias_initial_sigma_rad_s: Rate = radians(0.5)  # small: slow start, large: jumpy start
    bias_walk_rad_s: Rate = radians(0.1)  # sigma's growth in 100 s; small: stiff, large: noisy
    bias_rest_sigma_rad_s: Rate = radians(0.03)  # steady sigma at rest; small: follows noise
    bias_motion_sigma_rad_s: Rate = radians(0.1)  # likewise, moving

    # The field's calibration.
    field_lag_sigma_s: Lag = 0.05  # of the unknown lag; small: believes in none
    field_offset_sigma: Share = 0.15  # of the vehicle's own field / the place's; likewise
    calibration_high_pass_s: Time = 3.0  # small: noise, large: the place's gradients count
    calibration_noise_s: Lag = 0.005  # of the relative field, squared; small: jumpy, large: slow
    calibration_reach: Share = 0.5  # relative residual that is no matter of calibration any more
    calibration_turn: Share = 1.5  # squared distance of R from its mean that tells an offset
    calibration_walk_s: Time = 300.0  # time to forget; small: noisy, large: stiff

    # The field's confidence.
    field_tau_s: Time = 0.05  # low-pass of norm and dip; small: noise counts, large: late
    field_norm_scale: Share = 0.1  # relative deviation that counts as one; small: strict
    field_dip_scale_rad: Angle = 0.1  # likewise for the dip
    field_reference_tau_s: Time = 15.0  # small: learns the magnet, large: keeps the old place
    field_borne_s: Time = 40.0  # half of it another field has to last; likewise

    # Heading.
    heading_noise_rad2_s: Noise = (
        0.003  # of the field's heading; small: follows magnets, large: slow
    )
    heading_early_s: Time = 30.0  # for so long it is larger; small: trusts a field that is new
    heading_doubt_noise_rad2_s: Noise = 0.015  # what a doubtful field adds; small: follows magnets
    heading_tau_s: Time = 22.0  # what the heading makes of a constant drift; likewise
    heading_turning_noise_s: Noise = (
        5e-6  # drift variance per squared rate: scale errors of the gyro
    )
    heading_reach_rad: Angle = radians(25.0)  # residual that counts a quarter; small: never returns
    heading_borne_s: Time = (
        4.0  # for so long a field that looks usual must point elsewhere, at most
    )

    # Events.
    turn_heading_rad: Angle = radians(10.0)  # residual no honest drift reaches; small: false alarms
    turn_heading_tau_s: Time = 1.5  # averaging of that residual; likewise
    turn_heading_time_s: Time = 1.0  # and for so long
    turn_confidence: Share = 0.6  # of the field, averaged likewise
    turn_large_rad: Angle = radians(60.0)  # residual that needs less proof
    turn_large_time_s: Time = 0.5
    turn_large_confidence: Share = 0.8
    turn_quiet_rad: Angle = radians(20.0)  # gravity of a quiet vehicle off by so much
    turn_quiet_time_s: Time = 0.25
    turn_moving_rad: Angle = radians(60.0)  # of a moving one
    turn_moving_tau_s: Time = 1.0
    turn_moving_time_s: Time = 0.25
    turn_levelling_rad: Angle = radians(30.0)  # levelling that must have swung the heading too
    turn_levelling_tau_s: Time = 3.0
    turn_jump_rad: Angle = radians(2.5)  # turn of the field in G that is no noise
    turn_jump_usual: Share = 4.0  # and no more of what it usually turns; small: false alarms
    turn_jump_own: Share = 0.5  # likewise, of what an unknown lag and own field turn it
    turn_jump_norm: Share = 0.03  # change of its norm that tells a magnet; large: false alarms
    turn_jump_confidence: Share = 0.45  # of the field before one that comes within a step
    turn_jump_time_s: Time = (
        1.0  # for so long a field that jumped must stay; small: follows magnets
    )

    # Source.
    averaged_samples: bool = False  # samples are means over their interval, not instants


class LowPass(NamedTuple):
    """Coefficients of the second-order Butterworth low-pass for one time step."""

    own: float  # of the value in the new value
    cross: float  # of the slope in the new value, 1/s
    pull: float  # of the value in the new slope, s
    rate: float  # of the slope in the new slope


class Coefficients(NamedTuple):
    """What follows from the parameters and the time step, kept until that changes."""

    dt_s: float  # the time step
    factor: float  # of the averaging time of gravity
    rest: LowPass  # of gyroscope and accelerometer, with ``rest_tau_s``
    gravity: LowPass  # with ``gravity_tau_s`` times the factor
    gravity_share: float  # of a step in a mean over that time
    quick_share: float  # likewise over ``turn_moving_tau_s``
    levelling_decay: float  # what a step leaves of past levelling
    bias_growth: float  # of a bias's variance in a step, (rad/s)^2
    rest_noise: float  # variance of a bias seen at rest, (rad/s)^2
    motion_noise: float  # variance of a bias seen by levelling, (rad/s)^2
    heading_growth: float  # of the heading's variance in a step, rad^2


class Smooth(NamedTuple):
    """A low-passed vector and its scaled derivative (tau^2 times d/dt)."""

    value: Vec3  # in the input's unit and frame
    slope: Vec3  # likewise


class Gathered(NamedTuple):
    """Sums, each times its dt, since the last learning step."""

    time_s: float  # that the samples stand for
    gyr: Vec3  # rad, FRD
    acc: Vec3  # m/s, FRD
    gravity_g: Vec3  # minus the specific force, turned to G, m/s
    field_g: Vec3  # corrected by the calibration, turned to G, field's unit times s
    field_s: float  # time that the field's samples stand for


class RestState(NamedTuple):
    """Quiet is the instant's verdict, resting that of the last ``rest_time_s``."""

    gyr: Smooth  # rad/s, FRD
    acc: Smooth  # m/s^2, FRD
    quiet: bool  # whether both are near their low-pass now
    quiet_s: float  # for how long they have been
    resting: bool  # whether that is long enough


class Force(NamedTuple):
    """Minus the specific force, seen in G: gravity, once accelerations have averaged out."""

    down: Smooth  # low-passed over ``gravity_tau_s``, m/s^2
    quick: Vec3  # the same force, followed faster, m/s^2
    unsteady: float  # mean square of what comes and goes, as a share of the square of ``down``
    age_s: float  # since the low-pass began


class GravityState(NamedTuple):
    """Frame G, gravity low-passed in it, and the correction C that levels it."""

    q_g_frd: Quaternion  # body to G
    q_6d_g: Quaternion  # C, G to 6D
    force: Force  # in G


class StepNoise(NamedTuple):
    """Variances (rad^2) of the turn that a step missed, and the changes of rate that tell them."""

    tilt: float  # about both horizontal axes together
    twist: float  # about down
    tilting: float  # squared change of rate about horizontal axes, (rad/s)^2
    twisting: float  # likewise about down


class TiltState(NamedTuple):
    """How well the vertical is known in G."""

    variance: float  # of its direction, rad^2
    scatter: float  # mean square angle of the specific force about it, rad^2
    tilting: float  # mean square change of rate between two steps, (rad/s)^2, about horizontal axes
    twisting: float  # likewise about down
    gyr: Vec3  # mean rate of the last step, rad/s, FRD
    force_g: Vec3  # minus the mean specific force of the last step, m/s^2, in G
    force: float  # usual size of the specific force, m/s^2


class Rows(NamedTuple):
    """The axes of G or of 6D, seen from the body: the rows of R, body to that frame.

    Those of 6D are level: north (of an arbitrary heading), east and down. Those of G are not.
    """

    north: Vec3  # first axis, a unit vector in FRD
    east: Vec3  # second, likewise
    down: Vec3  # third, likewise


class Estimate(NamedTuple):
    """Gyro bias and heading of 6D, with the covariance of (bias, heading)."""

    bias_rad_s: Vec3  # of the gyroscope, FRD
    heading_rad: float  # by which 6D is turned about down to north
    covariance: Covariance  # (rad/s)^2 and rad^2


class Lagged(NamedTuple):
    """Horizontal rows of R6, and R6 b, with the lag of the low-passed gravity."""

    rows: Six  # north and east, low-passed
    rows_slope: Six  # their scaled derivatives
    drift: Two  # north and east part of R6 b, low-passed, rad/s
    drift_slope: Two  # their scaled derivatives


class Calibration(NamedTuple):
    """The magnetometer's age and the vehicle's own field, with their covariance."""

    lag_s: float  # age of a reading
    offset: Vec3  # the vehicle's own field in FRD, as a share of ``scale``
    covariance: Covariance  # of (offset, lag)
    scale: float  # norm of the place's field, in the field's own unit


class CalibrationMeans(NamedTuple):
    """Slow means of the field over ``scale``, and of what the calibration explains it by."""

    field: Vec3  # in G
    turning: Vec3  # R (w x m), in G, 1/s; R turns body to G
    rows: Rows  # of R


class CalibrationState(NamedTuple):
    """The calibration and the means that its learning takes off."""

    learnt: Calibration  # the unknowns
    means: CalibrationMeans  # high-passing takes them off
    age_s: float  # of the means, up to ``calibration_high_pass_s``
    started: bool  # whether the means are of this attitude


class FieldLook(NamedTuple):
    """The field as it was seen lately, and how far it resembles its reference."""

    horizontal: float  # low-passed, in the field's own unit
    down: float  # low-passed, likewise
    confidence: float  # 0..1, from norm and dip


class FieldRival(NamedTuple):
    """A field that is seen in place of the one expected."""

    horizontal: float  # in the field's own unit
    down: float  # likewise
    seen_s: float  # for how long it has been seen, less the time it has not


class FieldReference(NamedTuple):
    """The field that the place and the vehicle are taken to have."""

    horizontal: float  # in the field's own unit
    down: float  # likewise
    samples: float  # how many have taught it
    age_s: float  # the time that they stand for
    borne_s: float  # for how long the field has looked so, less the time it has looked like other
    other: FieldRival  # another one that it may have
    is_new: bool  # whether this step has taken the other for it
    uneven: float  # mean square of how far norm and dip are off, as shares and angles


class MagneticState(NamedTuple):
    """What is known about the field in the level frame 6D."""

    look: FieldLook  # lately
    reference: FieldReference  # usually
    wait_s: float  # since the last sample of the field
    known: bool  # whether there has been one


class HeadingSigns(NamedTuple):
    """What the field says about an unsensed turn about the vertical."""

    mean_north: float  # of the field weighted by its confidence, in the field's own unit
    mean_east: float  # likewise
    mean_confidence: float  # of the field, averaged alike
    off_s: float  # for how long the mean field has pointed elsewhere
    large_s: float  # for how long the field itself has pointed far away
    scatter: float  # mean square of how far the mean field points elsewhere, rad^2
    borne_s: float  # for how long, less the time against it, the field has borne the heading out
    other_rad: float  # the heading that was given up last
    other_s: float  # for how much longer that is remembered


class GravitySigns(NamedTuple):
    """What the specific force says about an unsensed turn about a level axis."""

    quiet_s: float  # for how long a quiet vehicle's gravity has been off
    moving_s: float  # for how long that of a moving vehicle has
    levelled: Two  # what levelling has turned lately about north and east, rad
    wander: float  # mean square angle between quick and slow gravity, rad^2
    uneven: float  # mean square of how far the size of gravity is off, as a share


class JumpSigns(NamedTuple):
    """Whether the field turns in G, where it stands still."""

    quick: Vec3  # the field in G, low-passed a little, in its own unit
    slow: Vec3  # the same, low-passed more
    quick_norm: float  # its norm, low-passed as ``quick``: the mean of two directions is shorter
    slow_norm: float  # likewise as ``slow``
    apart_rad: float  # angle between the two
    usual: float  # its mean square, rad^2
    usual_turning: float  # mean square rate of the vehicle meanwhile, (rad/s)^2
    turning: float  # mean square rate of the vehicle lately, (rad/s)^2
    unseen: float  # variance of turns missed between samples lately, rad^2
    seen_rad: float  # largest angle of the jump at hand that has raised doubts already
    ahead_rad: float  # by how much the last reading is off ``quick``, as a share of its norm
    age_s: float  # since the first field


class TurnSigns(NamedTuple):
    """How strong each sign of an unsensed turn is, and how long it has lasted."""

    heading: HeadingSigns  # of the field
    gravity: GravitySigns  # of the specific force
    jump: JumpSigns  # of the field in G


class FieldBefore(NamedTuple):
    """The field before a turn that no sensor has felt."""

    norm: float  # in its own unit
    confidence: float  # averaged


class Doubt(NamedTuple):
    """What an unsensed turn leaves to be found anew."""

    tilt: float  # variance of the vertical that the force has not taken off yet, rad^2
    heading: float  # variance that the heading gets once the field looks as usual, rad^2
    usual_s: float  # for how long it has, less the time it has not
    before: FieldBefore  # the turn


class Spin(NamedTuple):
    """A steady turn, and the gyroscope's error of scale that shows in it."""

    turn: Smooth  # low-passed rate, in G, rad/s
    scale_error: float  # of the reading, as a share
    variance: float  # of that share
    drift_rad_s: Vec3  # what the error makes of the steady turn about level axes, FRD


class Averaging(NamedTuple):
    """How much longer than ``gravity_tau_s`` gravity is averaged, and what that follows from."""

    shaking: float  # mean square of how far accelerations tilt the force of a second, rad^2
    turning: float  # mean square of the rate that lets G drift, (rad/s)^2
    factor: float


class Clipping(NamedTuple):
    """Where the gyroscope ends, and what it has missed there."""

    peak_rad_s: Vec3  # largest reading of each axis so far, either way, FRD
    run_s: Vec3  # for how long each axis has stood at its peak
    missed: Vec3  # variance of the turn missed since the last learning step, rad^2, FRD


class Axes(NamedTuple):
    """Down and magnetic north as G has them."""

    down_g: Vec3  # unit vector in G
    north_g: Vec3  # likewise, horizontal


class Certainty(NamedTuple):
    """How far the vectors can be trusted, and how well inclination and heading are known."""

    weight: float  # of both vectors against the gyroscope; 1 for fast streams
    has_heading: bool  # whether a field has told it
    gravity_confidence: float  # 0..1, falls with unsteady force
    magnetic_confidence: float  # 0..1, of the present field; 0 without one
    sigma_inclination_rad: float  # angle that 68 % of the errors lie under
    sigma_heading_rad: float  # likewise; infinite without a heading


class Alarm(NamedTuple):
    """Which sign of an unsensed turn went off."""

    heading: bool  # the field keeps pointing elsewhere
    quiet: bool  # the gravity of a quiet vehicle does
    moving: bool  # that of a moving one does
    levelling: bool  # levelling has turned so far that the heading is wrong
    jump: float  # variance (rad^2) of the turn by which the field has jumped; 0: it has not


class ConditioningState(NamedTuple):
    """Everything that changes."""

    started: bool  # whether there has been a sample
    previous_gyr_rad_s: Vec3  # the last sample's, FRD
    gathered: Gathered  # since the last learning step
    clipping: Clipping  # of the gyroscope
    spin: Spin  # the gyroscope's scale error
    averaging: Averaging  # of gravity
    gravity: GravityState  # frame G, and down in it
    tilt: TiltState  # how well down is known
    rest: RestState  # whether the vehicle rests
    estimate: Estimate  # bias and heading
    lagged: Lagged  # what bias learning in motion compares with
    magnetic: MagneticState  # the field and its reference
    calibration: CalibrationState  # of the magnetometer
    signs: TurnSigns  # of an unsensed turn
    doubt: Doubt  # after one
    axes: Axes  # down and north, as the last learning step has them
    certainty: Certainty  # likewise
    coefficients: Coefficients  # for the last step's length


class Conditioned(NamedTuple):
    """The paper's vectors, and what else the filter and the publisher need."""

    rate_rad_s: Vec3  # free of bias, and the one that integrates best over the step; FRD
    turn: Quaternion  # by that rate over the step: the body's attitude after it in that before
    bias_rad_s: Vec3  # of the gyroscope, FRD
    gravity_b: Vec3  # down, a unit vector in FRD
    magnetic_b: Vec3  # magnetic north, horizontal, a unit vector in FRD
    weight: float  # of both vectors against the gyroscope; 1 for fast streams
    has_heading: bool  # whether a field has told it
    gravity_confidence: float  # 0..1, falls with unsteady force
    magnetic_confidence: float  # 0..1, of the present field; 0 without one
    sigma_inclination_rad: float  # angle that 68 % of the errors lie under
    sigma_heading_rad: float  # likewise; infinite without a heading
