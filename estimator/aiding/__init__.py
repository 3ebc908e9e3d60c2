"""Velocity beside the IMU: the attitude of a vehicle that accelerates."""
