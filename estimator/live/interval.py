"""The stream's usual interval, and what is a gap for it."""

from estimator.compilation.compiled import inlined
from estimator.conditioning.vertical.rate import FAST_STEP_S

# Weight of a new interval in the mean, which thus covers about ten samples.
SHARE = 0.1
# One gap does not mean a new rate: an interval counts as at most this many usual ones.
MOST_USUAL = 2.0
# After so many usual intervals without a sample something is missing.
GAP_INTERVALS = 3.0
# In a fast stream the readings at the ends of a gap tell how the vehicle was turning there, and
# velocity corrects within a second what they miss; a slow stream's readings tell less.
SLOW_GAP_S = 1.0


@inlined
def usual_interval(usual_s: float, dt_s: float) -> float:
    """The usual interval after one more; 0 stands for none so far."""
    if usual_s <= 0.0:
        return dt_s
    return usual_s + (min(dt_s, MOST_USUAL * usual_s) - usual_s) * SHARE


def is_gap(gap_s: float, usual_s: float, dt_s: float) -> bool:
    """Whether the vehicle has been out of sight for longer than the estimate goes on through."""
    longest_s = gap_s if usual_s < FAST_STEP_S else min(gap_s, SLOW_GAP_S)
    return dt_s > longest_s and dt_s > GAP_INTERVALS * usual_s
