"""The stream's usual interval, and what is a gap for it."""

# The mean goes back over about this many samples.
SAMPLES = 10.0
# One gap is no new rate: an interval counts up to this many usual ones.
MOST_USUAL = 2.0
# After so many usual intervals without a sample something is missing, but not before ``gap_s``.
GAP_INTERVALS = 3.0


def usual_interval(usual_s: float, dt_s: float) -> float:
    """With one more interval; 0 stands for none before."""
    if usual_s <= 0.0:
        return dt_s
    return usual_s + (min(dt_s, MOST_USUAL * usual_s) - usual_s) / SAMPLES


def is_gap(gap_s: float, usual_s: float, dt_s: float) -> bool:
    """Whether the vehicle has been out of sight for longer than the stream's rate explains."""
    return dt_s > gap_s and dt_s > GAP_INTERVALS * usual_s
