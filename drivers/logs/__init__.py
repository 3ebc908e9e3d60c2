"""Recorded logs, read as the events of a live link."""
