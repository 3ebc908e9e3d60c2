"""The simulated vehicle: its motion, its MAVLink process, and the source inside the service."""
