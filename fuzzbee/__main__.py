"""``python -m fuzzbee``."""

from fuzzbee.cli import entry_point

entry_point()
