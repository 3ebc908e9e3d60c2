"""From a reading to a sample: its plausibility, its faults, its place in time."""
