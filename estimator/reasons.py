"""Why something is refused: the words that it is counted and published under."""

from enum import StrEnum


class Reason(StrEnum):
    """One word for each; docs/troubleshooting.md has what a person can do about it."""

    # a reading that is no data
    NOT_FINITE = "not_finite"
    ZERO_ACCELEROMETER = "zero_accelerometer"
    ACCELEROMETER_OUT_OF_RANGE = "accelerometer_out_of_range"
    GYROSCOPE_OUT_OF_RANGE = "gyroscope_out_of_range"
    MAGNETOMETER_OUT_OF_RANGE = "magnetometer_out_of_range"  # the row is used without it
    POSITION_OUT_OF_RANGE = "position_out_of_range"
    NO_INTERVAL = "no_interval"
    TOO_MANY_STREAMS = "too_many_streams"
    # a sensor at fault
    REPEATED = "repeated"
    STUCK = "stuck"
    GYROSCOPE_STUCK = "gyroscope_stuck"
    ACCELEROMETER_STUCK = "accelerometer_stuck"
    MAGNETOMETER_STUCK = "magnetometer_stuck"
    GYROSCOPE_SATURATED = "gyroscope_saturated"
    ACCELEROMETER_SATURATED = "accelerometer_saturated"
    GYROSCOPE_SPIKE = "gyroscope_spike"
    # a reading without its place in time
    DUPLICATE = "duplicate"
    OUT_OF_ORDER = "out_of_order"
    NOT_LATER = "not_later"
    CLOCK_STEP = "clock_step"
    CLOCK_PACE = "clock_pace"
    NO_CLOCK = "no_clock"
    # a velocity
    VELOCITY_NOT_FINITE = "velocity_not_finite"
    VELOCITY_OUT_OF_RANGE = "velocity_out_of_range"
    # our own estimate
    ESTIMATE_NOT_FINITE = "estimate_not_finite"
    # a frame that is not let in
    NO_PLACE = "no_place"
    SYSTEM_NOT_ALLOWED = "system_not_allowed"
    ADDRESS_CONFLICT = "address_conflict"
    UNSIGNED = "unsigned"
    WRONG_SIGNATURE = "wrong_signature"
    REPLAYED = "replayed"
    SIGNATURE_TOO_OLD = "signature_too_old"
    SIGNATURE_TOO_NEW = "signature_too_new"
