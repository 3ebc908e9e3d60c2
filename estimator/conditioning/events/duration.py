"""For how long a sign has held, and what is compared with it."""

from estimator.compilation.compiled import inlined

# A single sample is a sign of no more than this (s), however long its step: of slow streams
# several in a row have to agree.
LONGEST_SIGN_S = 0.15
# Averaging (s) of what looks like a turn and is none: accelerations, and a field that wanders.
LATELY_S = 10.0


@inlined
def duration_s(holds: bool, lasted_s: float, dt_s: float) -> float:
    """For how long (s) something has held, which it has if it ``holds`` now."""
    return lasted_s + min(dt_s, LONGEST_SIGN_S) if holds else 0.0
