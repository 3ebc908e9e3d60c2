"""An attitude from a whole recording: what came later counts as much as what came before."""

from estimator.smoothing.recorder import Recorder
from estimator.smoothing.smooth import Smoothed, smooth_all

__all__ = ["Recorder", "Smoothed", "smooth_all"]
