"""What is chosen about the conditioning stage, and the times that the estimate shares.

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
# Quick means of gyroscope, force and field, s. Small: noisy, large: late. A smoothed path ends at a
# longer step.
QUICK_S = 0.5
# Means of force, field and velocity that are compared, s. Small: mostly noise, large: the gyroscope
# drifts. A pause of this length is a gap.
SPAN_S = 1.0
# A field that looks usual must point elsewhere for so long (s) to count: a magnet passes. The
# residual of an aided heading has the same low-pass.
CONFIRM_S = 4.0
# Accelerations that the mean force does not average out, and slips of wheels, last for so long, s.
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
FORGET_S = 600.0


class ConditioningParams(NamedTuple):
    """What is chosen; every step has its own switch.

    Each line gives the meaning, and the effect of a small and of a large value. Units are in the
    names.
    """

    # Switches, one a step.
    use_gravity_filter: bool = True  # low-pass the specific force in G; off: each mean as it is
    use_rest: bool = True  # bias from rest
    use_motion_bias: bool = True  # bias from levelling while moving
    use_averaging: bool = True  # gravity, for as long as accelerations and turning require
    use_joint_covariance: bool = True  # heading residuals also correct the bias
    use_lag: bool = True  # undo the magnetometer's lag, learnt while turning
    use_field_offset: bool = True  # take off the vehicle's own field, learnt while turning
    use_confidence: bool = True  # off: every field sample counts in full
    use_events: bool = True  # off: no reaction to an unsensed turn
    use_step_noise: bool = True  # off: slow streams are treated as fast ones

    # Rest: how long things must be how quiet.
    rest_acc_m_s2: Acceleration = 0.5  # small: rest is missed, large: slow motion passes for it
    rest_time_s: Time = 1.5  # small: pauses in motion pass for rest, large: late

    # Gravity.
    gravity_tau_s: Time = 2.5  # small: acceleration tilts the vertical, large: gyro drift does

    # What a slow step misses of a turn, and how a force's direction scatters.
    step_turn_noise_1_s: Share = 0.4  # of the rate, each second; small: the gyroscope counts
    force_lasts_s: Time = 0.35  # of accelerations; small: the force counts, large: the gyroscope
    scatter_tau_s: Time = 7.0  # averaging of the scatter; small: jumpy, large: late
    force_size_noise: Share = 1.0  # rad for a force of twice its size; small: the force counts

    # Bias.
    bias_limit_rad_s: Rate = radians(2.0)  # of one innovation, of a bias at rest; motion: 10 deg/s
    bias_initial_sigma_rad_s: Rate = radians(0.5)  # small: slow start, large: jumpy start
    bias_rest_sigma_rad_s: Rate = radians(0.03)  # steady sigma at rest; small: follows noise
    # steady sigma while moving, and its growth in 100 s; small: stiff, large: noisy
    bias_motion_sigma_rad_s: Rate = radians(0.1)

    # The field's calibration.
    field_lag_sigma_s: Lag = 0.05  # of the unknown lag; small: hardly learns one
    field_offset_sigma: Share = 0.15  # vehicle's own field / the place's; small: hardly learns one
    calibration_high_pass_s: Time = 3.0  # small: noise, large: the place's gradients count
    calibration_noise_s: Lag = 0.005  # of the relative field, squared; small: jumpy, large: slow
    calibration_reach: Share = 0.5  # relative residual that is no matter of calibration any more
    calibration_turn: Share = 1.5  # squared distance of R from its mean that shows an offset

    # The field's confidence.
    field_dip_scale_rad: Angle = 0.1  # deviation of the dip that counts as one; small: strict

    # Heading.
    heading_noise_rad2_s: Noise = 0.003  # of the field; small: follows magnets, large: slow
    heading_doubt_noise_rad2_s: Noise = 0.015  # added at low confidence; small: follows magnets
    heading_turning_noise_s: Noise = 5e-6  # drift variance per squared rate: gyro scale errors

    # Events.
    turn_heading_rad: Angle = radians(10.0)  # residual no honest drift reaches; small: false alarms
    turn_jump_rad: Angle = radians(3.2)  # turn of the field in G that is no noise

    # Source.
    # It accelerates for long, and its gyroscope is good: a HEARTBEAT decides where this is off.
    in_vehicle: bool = False
    averaged_samples: bool = False  # samples are means over their interval, not instants
