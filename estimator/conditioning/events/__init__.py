"""Turns of the vehicle that the gyroscope has not shown."""
