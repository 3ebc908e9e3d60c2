"""The names of ArduPilot's parameters that are read or played here.

Source: https://ardupilot.org/copter/docs/parameters.html.
"""

# What calibrating the first compass has found, in mGauss; all zero: nobody has calibrated it
COMPASS_OFFSETS = ("COMPASS_OFS_X", "COMPASS_OFS_Y", "COMPASS_OFS_Z")
# The cutoff of the gyroscope's low-pass, Hz: a Butterworth filter of second order
GYRO_FILTER = "INS_GYRO_FILTER"
ROVER_GYRO_FILTER_HZ = 4.0  # as delivered; of other vehicles 20
COMPASS_DECLINATION = "COMPASS_DEC"  # rad
# The mounting trim, rad: roll, pitch and yaw of the IMU in the vehicle it reports on
TRIM = ("AHRS_TRIM_X", "AHRS_TRIM_Y", "AHRS_TRIM_Z")
ORIENTATION = "AHRS_ORIENTATION"  # of the board in the vehicle; applied before anything is sent
SYSTEM_ID = ("SYSID_THISMAV", "MAV_SYSID")  # until 4.6, and since
