"""The maths that everything shares: filter, fuzzy controller, conditioning. No I/O, no clock."""
