"""Bytes and logs to samples and back, and the simulated vehicle."""
