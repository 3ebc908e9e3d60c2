"""What is chosen about the conditioning stage, and times and limits that the estimate shares.

Angles are in rad, rates in rad/s, accelerations in m/s^2, times in s.
"""

from math import radians
from typing import NamedTuple

from estimator.bounds import Acceleration, Angle, Lag, Noise, Rate, Share, Time

# The times over which the estimate averages and remembers: the same time has the same name.

# Low-pass of the field's norm and dip, s. Small: noise counts, large: magnets are noticed late.
FIELD_S = 0.05
# Longest step (s) that counts in full: a longer one misses most of the turning and shows no own
# field, so several in a row have to agree.
LONGEST_STEP_S = 0.15
# Quick means of gyroscope, force and field, s. Small: noisy, large: late. In slow streams brief
# accelerations last for so long. A smoothed path ends at a longer step.
QUICK_S = 0.5
# Means of force, field and velocity that are compared, s. Small: mostly noise, large: the gyroscope
# drifts. A pause of this length is a gap.
SPAN_S = 1.0
# A field that looks usual must point elsewhere for so long (s) to count: a magnet passes. The
# residual of an aided heading has the same low-pass.
CONFIRM_S = 4.0
# Accelerations that the mean force does not average out, and slips of wheels, last for so long, s.
# The field's calibration is high-passed with the same time. Small: noise, large: gradients count.
ACCELERATION_LASTS_S = 3.0
# What is compared with now, s: accelerations, a drifting field, where gravity and field stood.
LATELY_S = 10.0
# Means of usual scatter, s: of the size of force and field, of the heading's residual, and of the
# signs of slow accelerations.
USUAL_S = 20.0
# Measurements count for so long, s: corrections, what velocities show of the heading, what wheels
# contradict, that a field is new. Meanwhile G drifts by less than their error.
MEMORY_S = 30.0
# Memory of headings that were given up, of how well means of the force agree, and of the usual
# residuals, s. Random walks are given for this time. Velocity helps until it is missing for longer.
LONG_S = 100.0
# What has been learnt is forgotten in so long, s: a vehicle's own field, that its compass misled.
# The strength of a place's field may change by ``NORM_SCALE`` meanwhile.
FORGET_S = 600.0

# The deviations that count, likewise.

# A residual within so many sigmas of what is expected is none too far.
REACH = 3.0
# A squared residual this many times its variance (4 sigma) is no noise: chance reaches it once in
# an hour of independent seconds.
FAR = 16.0
# A residual of the heading that counts a quarter, rad. Small: a wrong heading never returns, large:
# magnets draw it. The aiding does not begin with a less certain heading, by velocity or by field.
HEADING_REACH_RAD = radians(25.0)
# A vector that is off its mean by this share of its size has been turned, not measured badly; one
# that differs by less from what an attitude predicts is explained by it.
MOST_DEVIATION = 0.6


class ConditioningParams(NamedTuple):
    """What is chosen: the meaning of each value, and the effect of a small and of a large one."""

    # Switches for the steps.
    use_gravity_filter: bool = True  # low-pass the specific force in G; off: use each mean
    use_rest: bool = True  # learn the bias at rest
    use_motion_bias: bool = True  # learn it from levelling in motion
    use_averaging: bool = True  # average gravity as long as accelerations and turning require
    use_joint_covariance: bool = True  # heading residuals also correct the bias
    use_lag: bool = True  # undo the magnetometer's lag, learnt while turning
    use_field_offset: bool = True  # take off the vehicle's own field, learnt while turning
    use_confidence: bool = True  # off: every field sample counts in full
    use_events: bool = True  # off: no reaction to an unsensed turn
    use_step_noise: bool = True  # off: slow streams are treated as fast ones

    # When a vehicle counts as resting.
    rest_acc_m_s2: Acceleration = 0.5  # small: misses rests, large: takes slow motion for rest
    rest_time_s: Time = 1.5  # small: takes pauses for rest, large: late

    # Gravity.
    gravity_tau_s: Time = 2.5  # small: acceleration tilts the vertical, large: gyro drift does

    # Slow streams: turns between samples, and the scatter of the force's direction.
    step_turn_noise_1_s: Share = 0.4  # of the rate, each second; small: relies on the gyroscope
    scatter_tau_s: Time = 7.0  # averaging of the scatter; small: jumpy, large: late

    # Bias.
    bias_limit_rad_s: Rate = radians(2.0)  # of an innovation, a bias at rest; in motion 10 deg/s
    bias_initial_sigma_rad_s: Rate = radians(0.5)  # small: slow start, large: jumpy start
    bias_rest_sigma_rad_s: Rate = radians(0.03)  # steady sigma at rest; small: follows noise
    bias_motion_sigma_rad_s: Rate = radians(0.1)  # in motion; grows by it in 100 s; small: stiff

    # The field's calibration.
    field_lag_sigma_s: Lag = 0.05  # of the unknown lag; small: hardly learns one
    field_offset_sigma: Share = 0.15  # vehicle's own field / the place's; small: hardly learns one
    calibration_noise_s: Lag = 0.005  # of the relative field, squared; small: jumpy, large: slow
    calibration_reach: Share = 0.5  # relative residual beyond which nothing is learnt
    calibration_turn: Share = 1.5  # squared distance of R from its mean that shows an offset

    # Heading.
    heading_noise_rad2_s: Noise = 0.003  # of the field; small: follows magnets, large: slow
    heading_inflation_noise_rad2_s: Noise = 0.015  # added at low confidence; small: follows magnets
    heading_turning_noise_s: Noise = 5e-6  # drift variance per squared rate: gyro scale errors

    # Events.
    turn_heading_rad: Angle = radians(10.0)  # residual beyond any drift; small: false alarms
    turn_jump_rad: Angle = radians(3.2)  # turn of the field in G beyond noise

    # Source.
    in_vehicle: bool = False  # long accelerations, a good gyroscope; a HEARTBEAT switches it on
    averaged_samples: bool = False  # samples are means over their interval, not instants
