"""What compiled code calls the messages that nearly all of a stream are, and their marks."""

from math import pi

from drivers.mavlink import constants as mav
from drivers.mavlink.imu_messages import (
    IMU_MESSAGES,
)
from drivers.mavlink.messages import MESSAGES
from drivers.samples.vehicle_clock import TimeField

# What a message is to compiled code; 0 is nothing.
# They are in the order of preference.
RAW, HIGHRES, SCALED = 1, 2, 3  # the latter of three messages
KINDS = {
    mav.RAW_IMU_ID: RAW,
    mav.HIGHRES_IMU_ID: HIGHRES,
    mav.SCALED_IMU_ID: SCALED,
    mav.SCALED_IMU2_ID: SCALED + 1,
    mav.SCALED_IMU3_ID: SCALED + 2,
}
KIND_NAMES = {kind: IMU_MESSAGES[number].name for number, kind in KINDS.items()}
KIND_OF = {name: kind for kind, name in KIND_NAMES.items()}
IMUS = len(KINDS)
ATTITUDE, LOCAL_POSITION, GLOBAL_POSITION, RECEIVER = IMUS + 1, IMUS + 2, IMUS + 3, IMUS + 4
# Attitudes without rates where they are not wanted, and what says nothing.
QUATERNION, SECOND_ATTITUDE, AUTOPILOT_VERSION, SILENT = IMUS + 5, IMUS + 6, IMUS + 7, IMUS + 8
# Other streams that have a time, in the order of their kinds.
OTHERS = {
    ATTITUDE: mav.ATTITUDE_ID,
    LOCAL_POSITION: mav.LOCAL_POSITION_NED_ID,
    GLOBAL_POSITION: mav.GLOBAL_POSITION_INT_ID,
    RECEIVER: mav.GPS_RAW_INT_ID,
}
OTHER_CLOCKS = {kind: TimeField.GPS if kind == RECEIVER else TimeField.BOOT_MS for kind in OTHERS}
OTHER_NAMES = {kind: MESSAGES[number].name for kind, number in OTHERS.items()}
OTHER_OF = {name: kind for kind, name in OTHER_NAMES.items()}
ATTITUDE_NAME = OTHER_NAMES[ATTITUDE]
N_OTHERS = len(OTHERS)
# Of a payload; what follows is of no interest here.
LONGEST = 64
RADIANS = pi / 180.0
# Flags: a fresh field, a sample to be looked at, an attitude that is wanted, a velocity, a place, a
# reading that is no data; times WHY the reason for that, or why the field is none.
FRESH, TO_LOOK, GIVES, MOVES, IS_THERE, NO_DATA, WHY = 1, 2, 4, 8, 16, 32, 64
# Columns of a frame in a batch: where it begins and ends, when it arrived, what has become of it,
# and its number where it comes from.
BEGIN, STOP, ARRIVAL, FATE, NUMBER, BATCH_COLUMNS = 0, 1, 2, 3, 4, 5
READ, WAITING, NEXT = 0, 1, 2  # fates
