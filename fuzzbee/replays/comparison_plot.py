"""Several replays in one figure: their errors, a row a log, a line a profile."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from estimator.arrays import Floats
from fuzzbee.replays.comparison import Comparison
from fuzzbee.replays.plot import FIGURE_INCHES, STYLE, cap, legend_above, note, save
from fuzzbee.replays.thinned import Thinned
from fuzzbee.replays.trace import VehicleTrace

ROW_INCHES = 2.2
PANELS = (("inclination", 2), ("heading", 1))


class Curves(NamedTuple):
    """One replay's errors (M, 3: total, heading, inclination) in degrees over time (M,)."""

    log: str
    profile: str
    time_s: Floats
    errors_deg: Floats


class ComparisonPlot:
    """Collects replays; each keeps no more than a line needs."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._curves: list[Curves] = []

    def add(self, log: str, profile: str, trace: VehicleTrace, compared: Comparison) -> None:
        """Take one replay."""
        time_s = trace.time_s
        errors = np.degrees(np.where(compared.known[:, None], compared.errors_rad, np.nan))
        if not trace.has_heading:
            errors[:, 1] = np.nan  # a heading from nowhere has no error
        points = Thinned(time_s)
        self._curves.append(Curves(log, profile, points.time_s, points.largest(errors)))

    def draw(self) -> None:
        """Write the figure.

        Raises:
            InputError: the file cannot be written.
        """
        import matplotlib as mpl
        from matplotlib.figure import Figure

        logs = list(dict.fromkeys(each.log for each in self._curves))
        with mpl.rc_context(STYLE):
            size = (FIGURE_INCHES[0], ROW_INCHES * (1 + len(logs)))
            figure = Figure(figsize=size, layout="constrained")
            axes = figure.subplots(len(logs), len(PANELS), squeeze=False, sharex="row")
            for row, log in zip(axes, logs, strict=True):
                _draw_log(row, log, [each for each in self._curves if each.log == log])
            for ax in axes[-1]:
                ax.set_xlabel("time in s")
            save(figure, self._path)


def _draw_log(axes: Any, log: str, curves: list[Curves]) -> None:
    """One log's panels."""
    for ax, (name, i) in zip(axes, PANELS, strict=True):
        for each in curves:
            ax.plot(each.time_s, each.errors_deg[:, i], lw=0.8, label=each.profile)
        ax.set_ylabel(f"{name} error in °")
        errors = np.concatenate([each.errors_deg[:, i] for each in curves])
        cap(ax, errors)
        if np.isnan(errors).all():
            note(ax, "nothing to compare with")
        ax.margins(x=0.0)
        ax.grid(visible=True, alpha=0.3)
    axes[0].set_title(log, loc="left")
    legend_above(axes[-1], len(curves))
