"""The live estimator: its state, settings from a profile, and what is published."""
