"""The constant errors of an IMU's sensors, found in recordings."""
