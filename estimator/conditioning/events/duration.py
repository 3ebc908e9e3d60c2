"""How long a sign of an unsensed turn has lasted."""

from estimator.compilation.compiled import inlined

# One sample adds no more than this (s), however long its step: in a slow stream several samples
# in a row have to agree.
LONGEST_SIGN_S = 0.15


@inlined
def duration_s(holds: bool, lasted_s: float, dt_s: float) -> float:
    """How long (s) a condition has lasted after this step; 0 if it no longer ``holds``."""
    return lasted_s + min(dt_s, LONGEST_SIGN_S) if holds else 0.0
