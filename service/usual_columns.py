"""The numbers of vehicles that just go on, row by row; see :mod:`service.usual_vehicles`."""

from typing import Any

from service.intervals import PERIODS_KEPT

# Arrays of int64 and float64.
Whole = Any
Floats = Any

# Columns of a vehicle's whole numbers: when it was heard, the IMU message in use, and the one that
# is proving itself,
HEARD, CHOSEN, CHOSEN_US, LONGEST_SILENCE = 0, 1, 2, 3
RIVAL, RIVAL_SAMPLES, RIVAL_SINCE, RIVAL_US = 4, 5, 6, 7
# when rates came last (negative if never), whether they are used,
RATES_US, USES_RATES = 8, 9
# the message whose velocity is used, when that came last, when the receiver's did (negative if
# never), when a stride of velocity began,
VELOCITY, VELOCITY_US, RECEIVER_US, STRIDE_US = 10, 11, 12, 13
# the last sample's times, the counts, when to look for alarms, what was published last,
ARRIVAL, TIME, BOOT, HAS_MAG = 14, 15, 16, 17
SAMPLES, WORST_GAP, LOOK_US = 18, 19, 20
ATTITUDES, SHOWN_SAMPLES, SHOWN_US = 21, 22, 23
# the clock's, the median interval and the intervals it is made of, the oldest of them at AT.
CLOCK_AT, WINDOW, EVEN = 24, 25, 27
MEDIAN, PERIODS, AT, RING = 29, 30, 31, 32
# Behind the intervals what the estimator says of itself, see :class:`estimator.estimator.Lent`.
SOURCE = RING + PERIODS_KEPT
MINDS_GAPS, KNOWS_NORTH, HAS_RATES, WAITING, MINDS_PLACES = (SOURCE + k for k in range(1, 6))
STATE_SIZE = MINDS_PLACES + 1
# And of its other numbers: of the clock, of the sample, the heading's least sigma, the place.
OFFSET, SPANS, READING, LEAST_HEADING, HERE = 0, 1, 5, 14, 15
STATE_NUMBERS = 17
# A velocity that waits for a sample: time, velocity, whether that has a vertical part, both sigmas.
REPORT_SIZE = 7

# What has become of a row: taken; left; taken, but the estimate is to be checked, or judged, since
# measurements contradict it, or compared with the attitude beside these rates, or a velocity is to
# be told to whoever compares.
TAKEN, LEFT, CHECK, DOUBT, COMPARE, TELL = 0, 1, 2, 3, 4, 5
