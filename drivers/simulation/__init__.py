"""The simulated vehicle: its motion, its MAVLink process, and the source in the service."""
