"""For how long a sign has held."""

from estimator.compilation.compiled import inlined
from estimator.conditioning.times import LONGEST_STEP_S


@inlined
def duration_s(holds: bool, lasted_s: float, dt_s: float) -> float:
    """For how long (s) something has held, which it has if it ``holds`` now."""
    return lasted_s + min(dt_s, LONGEST_STEP_S) if holds else 0.0
