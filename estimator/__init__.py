"""The maths that everything shares: filter, fuzzy controller, conditioning. No I/O, no clock."""

from estimator.compilation import own_settings as own_settings
