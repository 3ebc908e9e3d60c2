"""The vertical: gravity in a gyro-propagated frame, and the errors of the gyroscope."""
