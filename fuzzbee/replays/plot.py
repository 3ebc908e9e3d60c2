"""A replay as a figure: attitude, errors and sigma, gain, confidences, bias and gaps."""

from collections.abc import Iterable, Sequence
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np

from estimator.arrays import Floats
from fuzzbee.attitudes import euler_curves_deg
from fuzzbee.replays.bands import Band, bands, gaps
from fuzzbee.replays.comparison import REFERENCES, has_peer
from fuzzbee.replays.figure import (
    BLACK,
    BLUE,
    COLORS,
    DARK,
    GREEN,
    ORANGE,
    PURPLE,
    RED,
    add_legend,
    add_text,
    written_figure,
)
from fuzzbee.replays.trace import VehicleTrace

PAGE_INCHES = (7.1, 9.8)  # between its margins
ROW_INCHES = 2.2
# With more points a line looks the same and the file only grows.
MOST_POINTS = 20_000
NEAR = 0.015  # of the width: names of two marks would hide each other
# The autopilot is no truth: from it an estimate only differs.
ERROR_WORDS = {"sim": "error", "autopilot": "difference"}
TIME = "time in s"


class Thinned:
    """No more points of lines over time than are seen, and none across a gap.

    Of samples at times (N,); ``time_s`` are those that are drawn, (M,).
    """

    def __init__(self, time_s: Floats) -> None:
        self._step = 1 + len(time_s) // MOST_POINTS
        shown_s, spans = time_s[:: self._step], np.reshape(gaps(time_s), (-1, 2))
        self._breaks = np.searchsorted(shown_s, spans[:, 1])
        self.time_s = np.insert(shown_s, self._breaks, spans.mean(axis=1))

    def every(self, values: Floats) -> Floats:
        """Some of the values (N,) or (N, K), and NaN in each gap."""
        return np.insert(values[:: self._step], self._breaks, np.nan, axis=0)

    def largest(self, values: Floats) -> Floats:
        """The same of values whose peaks show: the largest around each."""
        found = np.fmax.reduceat(values, np.arange(0, len(values), self._step))
        return np.insert(np.asarray(found), self._breaks, np.nan, axis=0)


def draw(title: str, path: Path, trace: VehicleTrace) -> None:
    """Draw a trace that has been compared into a file; its suffix is the format."""
    time_s = trace.time_s
    span = (float(time_s[0]), max(float(time_s[-1]), time_s[0] + 1e-3))
    with written_figure(path, title, PAGE_INCHES, is_over_log=True) as sheet:
        axes = sheet.subplots(8, 1)
        points = Thinned(time_s)
        _draw_attitudes(axes[:3], trace, points)
        _draw_errors(axes[3:5], trace, points)
        _draw_internals(axes[5:], trace, points)
        shaded, marks = list(bands(time_s, trace)), _marks(trace)
        for ax in axes:
            ax.set_xlim(span)
            _shade(ax, shaded, is_named=ax is axes[5])
            for at_s, _ in marks:
                ax.axvline(at_s, color=DARK, lw=0.5, ls=":", label="_mark")
        _name_marks(axes[0], marks, NEAR * (span[1] - span[0]))
        add_legend(axes[5], 6)  # above the gain, which has one curve
        axes[-1].set_xlabel(TIME)


def draw_angles(axes: Sequence[Any], time_s: Floats, q_ned_frd: Floats, **look: Any) -> None:
    """Roll, pitch and heading of attitudes (N, 4), each in its axes."""
    angles = euler_curves_deg(q_ned_frd)
    angles[1:][np.abs(np.diff(angles, axis=0)) > 180.0] = np.nan  # no line across a wrap
    for ax, name, angle in zip(axes, ("roll", "pitch", "heading"), angles.T, strict=True):
        ax.plot(time_s, angle, **look)
        ax.set_ylabel(f"{name} in °")


def _draw_attitudes(axes: Sequence[Any], trace: VehicleTrace, points: Thinned) -> None:
    """The reference, the autopilot beside a truth, and the estimate."""
    shown: list[tuple[str, dict[str, Any]]] = []
    if trace.reference is not None:
        look = {"color": BLACK, "label": REFERENCES[trace.reference], "lw": 1.6}
        shown.append(("reference_q_ned_frd", look))
    if has_peer(trace):
        look = {"color": GREEN, "label": "autopilot", "lw": 0.9, "ls": "--"}
        shown.append(("autopilot_q_ned_frd", look))
    shown.append(("q_ned_frd", {"color": ORANGE, "label": "estimate"}))
    for name, look in shown:
        draw_angles(axes, points.time_s, points.every(trace[name]), **look)
    add_legend(axes[0], len(shown))


def _draw_errors(axes: Sequence[Any], trace: VehicleTrace, points: Thinned) -> None:
    """Inclination and heading error with the published sigma, and the autopilot's error."""
    what, time_s = ERROR_WORDS.get(trace.reference or "", "sigma"), points.time_s
    for ax, name, i in zip(axes, ("inclination", "heading"), (2, 1), strict=True):
        ax.set_ylabel(f"{name}\n{what} in °")
        sigma = np.degrees(trace[f"sigma_{name}_rad"])
        within = points.every(sigma)
        ax.fill_between(time_s, 0.0 * within, within, color=BLUE, alpha=0.25, lw=0, label="sigma")
        if has_peer(trace):
            theirs = points.largest(np.degrees(trace["autopilot_error_rad"][:, i]))
            ax.plot(time_s, theirs, "--", color=GREEN, label="autopilot's error", lw=0.9)
        errors = np.degrees(trace["error_rad"][:, i])
        if trace.reference is not None:
            ax.plot(time_s, points.largest(errors), color=RED, label=what)
        _cap(ax, errors, sigma)
    add_legend(axes[0], 3)


def _draw_internals(axes: Sequence[Any], trace: VehicleTrace, points: Thinned) -> None:
    """Gain, confidences and bias."""
    time_s, (gain, confidence, bias) = points.time_s, axes
    gain.plot(time_s, points.largest(trace["gain"]), color=GREEN, label="_gain")
    gain.set(ylabel="gain K", ylim=(0.0, None))
    for name, color in (("gravity", BLUE), ("magnetic", PURPLE)):
        values = points.every(trace[f"confidence_{name}"])
        confidence.plot(time_s, values, color=color, label=name)
    confidence.set(ylabel="confidence", ylim=(0.0, None))
    add_legend(confidence, 2)
    values = points.every(np.degrees(trace["gyro_bias_rad_s"]))
    for axis, color, column in zip("xyz", COLORS, values.T, strict=False):
        bias.plot(time_s, column, color=color, label=axis)
    bias.set_ylabel("gyro bias\nin °/s")
    add_legend(bias, 3)


def _shade(ax: Any, shaded: Iterable[Band], *, is_named: bool) -> None:
    for label, color, alpha, spans in shaded:
        for number, span in enumerate(spans):
            name = label if is_named and number == 0 else "_band"
            ax.axvspan(*span, color=color, alpha=alpha, lw=0, label=name)


def _marks(trace: VehicleTrace) -> list[tuple[float, str]]:
    """The marks of a trace in seconds of its log, by the samples' arrivals."""
    arrivals_us = trace["arrival_us"]
    found = trace.marks.found(int(arrivals_us[0]), trace.autopilot, trace.vehicle_type)
    stamps_us = [stamp_us for stamp_us, _ in found]
    time_s = np.interp(stamps_us, arrivals_us, trace.time_s, right=np.nan).tolist()
    return [(at_s, name) for at_s, (_, name) in zip(time_s, found, strict=True) if not isnan(at_s)]


def _name_marks(ax: Any, marks: list[tuple[float, str]], near_s: float) -> None:
    """Of two that are near each other one name stands on either side."""
    last_s, is_right = -np.inf, False
    for at_s, name in marks:
        is_right, last_s = at_s - last_s < near_s and not is_right, at_s
        look: Any = {"rotation": 90.0, "fontsize": 5.5, "va": "top"}
        look["ha"] = "right" if is_right else "left"
        ax.text(at_s, 0.97, name, transform=ax.get_xaxis_transform(), **look)


def _cap(ax: Any, *angles_deg: Floats) -> None:
    """Give the axes a height that shows nearly all of those, and write there what is cut off."""
    finite = np.concatenate([each[np.isfinite(each)] for each in angles_deg])
    most = max(1.0, 1.3 * float(np.percentile(finite, 99.0))) if len(finite) else 1.0
    ax.set_ylim(0.0, most)
    peak = max((np.nanmax(line.get_ydata(), initial=0.0) for line in ax.lines), default=0.0)
    if peak > most:
        add_text(ax, f"cut off: up to {peak:.0f}°")


class ComparisonPlot:
    """Several replays in one figure: their errors or differences, a row a log, a line a profile.

    Collects replays; each keeps no more than a line needs.
    """

    def __init__(self) -> None:
        self._rows: dict[str, list[tuple[str, Floats, Floats]]] = {}
        self._words: dict[str, str] = {}  # of each log, what an angle to its reference is

    def add(self, log: str, profile: str, trace: VehicleTrace) -> None:
        """Take one replay."""
        errors, points = np.degrees(trace["error_rad"]), Thinned(trace.time_s)
        if not trace.has_heading:
            errors[:, 1] = np.nan  # a heading from nowhere has no error
        self._rows.setdefault(log, []).append((profile, points.time_s, points.largest(errors)))
        self._words[log] = ERROR_WORDS.get(trace.reference or "", "error")

    def draw(self, path: Path) -> None:
        """Write the figure."""
        size = (PAGE_INCHES[0], ROW_INCHES * (1 + len(self._rows)))
        with written_figure(path, "", size) as sheet:
            rows = sheet.subplots(len(self._rows), 2, squeeze=False)
            for log, axes in zip(self._rows, rows, strict=True):
                self._draw_row(log, axes)

    def _draw_row(self, log: str, axes: Sequence[Any]) -> None:
        replays = self._rows[log]
        span = (min(t[0] for _, t, _ in replays), max(t[-1] for _, t, _ in replays))
        for ax, name, i in zip(axes, ("inclination", "heading"), (2, 1), strict=True):
            ax.set(xlabel=TIME, ylabel=f"{name} {self._words[log]} in °", xlim=span)
            for number, (profile, time_s, errors) in enumerate(replays):
                color = COLORS[number % len(COLORS)]
                ax.plot(time_s, errors[:, i], color=color, label=profile)
            _cap(ax, *(errors[:, i] for _, _, errors in replays))
            if all(np.isnan(errors[:, i]).all() for _, _, errors in replays):
                add_text(ax, "nothing to compare with")
        axes[0].set_title(log)
        add_legend(axes[1], len(replays))
