"""The magnetic field: its calibration, its confidence, and the heading it shows."""
