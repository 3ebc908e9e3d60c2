"""The names of autopilots' parameters that are read or played here; ArduPilot's but where said.

Source: https://ardupilot.org/copter/docs/parameters.html.
"""

COMPASS = "COMPASS_"
# What calibrating the first compass has found, in mGauss; all zero: nobody has calibrated it
COMPASS_OFFSETS = ("COMPASS_OFS_X", "COMPASS_OFS_Y", "COMPASS_OFS_Z")
# The same of PX4, in gauss: docs.px4.io/main/en/advanced_config/parameter_reference.html
PX4_COMPASS_OFFSETS = ("CAL_MAG0_XOFF", "CAL_MAG0_YOFF", "CAL_MAG0_ZOFF")
# The cutoffs of the sensors' low-passes, Hz: Butterworth filters of second order
GYRO_FILTER, ACC_FILTER = "INS_GYRO_FILTER", "INS_ACCEL_FILTER"
ROVER_FILTERS_HZ = {GYRO_FILTER: 4.0, ACC_FILTER: 10.0}  # as delivered; of other vehicles 20
COMPASS_DECLINATION = "COMPASS_DEC"  # rad
# The mounting trim, rad: roll, pitch and yaw of the IMU in the vehicle it reports on
TRIM = ("AHRS_TRIM_X", "AHRS_TRIM_Y", "AHRS_TRIM_Z")
ORIENTATION = "AHRS_ORIENTATION"  # of the board in the vehicle; applied before anything is sent
SYSTEM_ID = ("SYSID_THISMAV", "MAV_SYSID")  # until 4.6, and since
