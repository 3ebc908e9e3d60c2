"""Retuning while it runs: the colony on the last ten seconds, without a truth."""
