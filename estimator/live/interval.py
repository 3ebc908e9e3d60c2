"""The stream's usual interval, and what is a gap for it."""

from estimator.aiding.search import UNKNOWN_RAD
from estimator.compilation.compiled import inlined
from estimator.conditioning.times import SPAN_S
from estimator.conditioning.vertical.rate import FAST_STEP_S
from estimator.conditioning.vertical.tilt import HOLE_RAD_S

# Of a new interval in the mean, which so goes back over about ten samples.
SHARE = 0.1
# One gap is no new rate: an interval counts up to this many usual ones.
MOST_USUAL = 2.0
# After so many usual intervals without a sample something is missing.
GAP_INTERVALS = 3.0
# Of a fast stream the readings at the ends of a hole tell how the vehicle was turning there, and
# velocity corrects within a second what they miss, until the turn missed leaves nothing known.
LONGEST_GAP_S = SPAN_S + UNKNOWN_RAD / HOLE_RAD_S


@inlined
def usual_interval(usual_s: float, dt_s: float) -> float:
    """With one more interval; 0 stands for none before."""
    if usual_s <= 0.0:
        return dt_s
    return usual_s + (min(dt_s, MOST_USUAL * usual_s) - usual_s) * SHARE


@inlined
def is_gap(usual_s: float, dt_s: float) -> bool:
    """Whether the vehicle has been out of sight for longer than the estimate goes on through."""
    longest_s = LONGEST_GAP_S if usual_s < FAST_STEP_S else SPAN_S
    return dt_s > longest_s and dt_s > GAP_INTERVALS * usual_s
