"""The magnetic field: its calibration, how far it is believed, and the heading it shows."""
