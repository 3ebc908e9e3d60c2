"""An attitude from a whole recording: what came later counts as much as what came before."""

from estimator.smoothing.recorder import Offered, Recorder
from estimator.smoothing.smooth import smooth_all, smooth_offered

__all__ = ["Offered", "Recorder", "smooth_all", "smooth_offered"]
