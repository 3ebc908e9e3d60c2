"""A replay as a figure: attitude, errors and sigma, gain, confidences, bias and gaps."""

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError, missing_extra
from fuzzbee.angle_curves import cut_at_wraps, euler_curves_deg
from fuzzbee.replays.comparison import Comparison
from fuzzbee.replays.trace import VehicleTrace

Floats = NDArray[np.float64]

# By suffix, the metadata that would make two files of the same figure differ.
METADATA: dict[str, dict[str, None]] = {
    ".png": {"Software": None},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None, "Producer": None, "Creator": None},
}
DOTS_PER_INCH = 120
# Silence this many median periods long, and this long (s), is a gap to be shown.
GAP_PERIODS = 5.0
LEAST_GAP_S = 0.3
# With more points a line looks the same and the file only grows.
MOST_POINTS = 20_000


def require_plot(path: Path) -> None:
    """Refuse early what cannot be drawn.

    Raises:
        InputError: an unknown suffix, or a missing library.
    """
    if path.suffix.lower() not in METADATA:
        raise InputError(f"--plot {path}: should end in {', '.join(METADATA)}")
    if find_spec("matplotlib") is None:
        raise missing_extra(f"--plot {path}", "plot")


def draw(path: Path, title: str, trace: VehicleTrace, compared: Comparison) -> None:
    """Draw the trace into a file whose suffix says how.

    Raises:
        InputError: the file cannot be written.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    time_s = 1e-6 * (trace.times_us - trace.times_us[0])
    shown = slice(None, None, 1 + len(time_s) // MOST_POINTS)
    # the salt stands for the random names that SVG elements would get
    with mpl.rc_context({"svg.hashsalt": "fuzzbee", "path.simplify": True}):
        figure = Figure(figsize=(11.0, 13.0), layout="constrained")
        axes = figure.subplots(8, 1, sharex=True)
        figure.suptitle(title)
        _attitude(axes[:3], time_s, trace, compared, shown)
        _errors(axes[3:5], time_s, trace, compared, shown)
        _internals(axes[5:], time_s, trace, shown)
        for ax in axes:
            _gaps(ax, time_s)
            ax.grid(visible=True, alpha=0.3)
        axes[-1].set_xlabel("time in s")
        suffix = path.suffix.lower()
        try:
            figure.savefig(path, format=suffix[1:], dpi=DOTS_PER_INCH, metadata=METADATA[suffix])
        except OSError as error:
            raise InputError(f"--plot {path}: {error.strerror}") from None


def _attitude(
    axes: Any, time_s: Floats, trace: VehicleTrace, compared: Comparison, shown: slice
) -> None:
    """Roll, pitch and yaw; lines are cut where an angle wraps."""
    own = euler_curves_deg(trace.estimates[shown])
    truth = euler_curves_deg(compared.truth[shown])
    truth[~compared.known[shown]] = np.nan
    for i, (ax, name) in enumerate(zip(axes, ("roll", "pitch", "yaw"), strict=True)):
        if compared.source is not None:
            ax.plot(time_s[shown], cut_at_wraps(truth[:, i]), "k-", lw=1.6, label=compared.source)
        ax.plot(time_s[shown], cut_at_wraps(own[:, i]), "C1-", lw=0.8, label="estimate")
        ax.set_ylabel(f"{name} in °")
    axes[0].legend(loc="upper right", ncols=2)


def _errors(
    axes: Any, time_s: Floats, trace: VehicleTrace, compared: Comparison, shown: slice
) -> None:
    """Inclination and heading error with the published sigma."""
    sigmas = (
        trace.column(lambda a: a.sigma_inclination_rad),
        trace.column(lambda a: a.sigma_heading_rad),
    )
    errors = np.where(compared.known[:, None], compared.errors_rad, np.nan)
    columns = (errors[:, 2], errors[:, 1])
    names = ("inclination", "heading")
    for ax, name, error, sigma in zip(axes, names, columns, sigmas, strict=True):
        ax.fill_between(
            time_s[shown], np.degrees(sigma[shown]), color="C0", alpha=0.25, lw=0, label="sigma"
        )
        ax.plot(time_s[shown], np.degrees(error[shown]), "C3-", lw=0.8, label="error")
        ax.set_ylabel(f"{name}\nerror in °")
        ax.set_ylim(0.0, _ceiling(np.degrees(error), np.degrees(sigma)))
    axes[0].legend(loc="upper right", ncols=2)


def _internals(axes: Any, time_s: Floats, trace: VehicleTrace, shown: slice) -> None:
    """Gain, confidences and bias."""
    axes[0].plot(time_s[shown], trace.column(lambda a: a.gain)[shown], "C2-", lw=0.8)
    axes[0].set_ylabel("gain K")
    gravity = trace.column(lambda a: a.confidence_gravity)
    magnetic = trace.column(lambda a: a.confidence_magnetic)
    axes[1].plot(time_s[shown], gravity[shown], "C0-", lw=0.8, label="gravity")
    axes[1].plot(time_s[shown], magnetic[shown], "C4-", lw=0.8, label="magnetic")
    axes[1].set_ylabel("confidence")
    axes[1].legend(loc="lower right", ncols=2)
    bias = np.degrees(np.array([a.gyro_bias_rad_s for a in trace.attitudes[shown]]))
    for i, name in enumerate("xyz"):
        axes[2].plot(time_s[shown], bias[:, i], lw=0.8, label=name)
    axes[2].set_ylabel("gyro bias\nin °/s")
    axes[2].legend(loc="upper right", ncols=3)


def _gaps(ax: Any, time_s: Floats) -> None:
    """Mark gaps in the stream in grey."""
    if len(time_s) < 2:
        return
    steps = np.diff(time_s)
    longest = max(LEAST_GAP_S, GAP_PERIODS * float(np.median(steps)))
    for k in np.flatnonzero(steps > longest):
        ax.axvspan(time_s[k], time_s[k + 1], color="0.8", lw=0)


def _ceiling(error: Floats, sigma: Floats) -> float:
    """A height that shows nearly all of both; rare peaks are cut off."""
    finite = np.concatenate([error[np.isfinite(error)], sigma[np.isfinite(sigma)]])
    return max(1.0, 1.3 * float(np.percentile(finite, 99.0))) if len(finite) else 1.0
