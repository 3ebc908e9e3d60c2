"""A replay as a figure: attitude, errors and sigma, gain, confidences, bias and gaps."""

from collections.abc import Iterator, Sequence
from math import isnan
from pathlib import Path

import numpy as np

from estimator.arrays import Floats
from fuzzbee.attitudes import euler_curves_deg
from fuzzbee.replays.bands import bands, gaps
from fuzzbee.replays.comparison import REFERENCES, has_peer
from fuzzbee.replays.figure import save
from fuzzbee.replays.panels import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    RED,
    Area,
    Curve,
    Figure,
    Mark,
    Panel,
    Span,
    Words,
)
from fuzzbee.replays.trace import VehicleTrace

PAGE_INCHES = (7.1, 9.8)  # between its margins
ROW_INCHES = 2.2
# With more points a line looks the same and the file only grows.
MOST_POINTS = 20_000
# The autopilot is no truth: from it an estimate only differs.
ERROR_WORDS = {"sim": "error", "autopilot": "difference"}
COLORS = (BLUE, ORANGE, GREEN, RED, PURPLE)
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
    """Draw a trace that has been compared into a file whose suffix says how."""
    time_s = trace.time_s
    points, span = Thinned(time_s), (float(time_s[0]), max(float(time_s[-1]), time_s[0] + 1e-3))
    panels = [
        *angle_panels(span, [*_attitudes(trace, points)]),
        *_errors(span, trace, points),
        *_internals(span, trace, points),
    ]
    shaded, marks = list(bands(time_s, trace)), _marks(trace)
    for panel in panels:
        panel.bands = [band._replace(label="") for band in shaded]
        panel.marks = [mark._replace(label="") for mark in marks]
    panels[0].marks = marks
    panels[5].bands, panels[5].names = shaded, 6  # above the gain, which has one curve
    panels[-1].xlabel = TIME
    save(Figure(title, [[panel] for panel in panels], PAGE_INCHES, is_over_log=True), path)


def angle_panels(span: Span, curves: Sequence[Curve]) -> list[Panel]:
    """Roll, pitch and heading of curves whose y are attitudes (N, 4)."""
    panels = [Panel(span, ylabel=f"{name} in °") for name in ("roll", "pitch", "heading")]
    for curve in curves:
        angles = euler_curves_deg(curve.y)
        angles[1:][np.abs(np.diff(angles, axis=0)) > 180.0] = np.nan  # no line across a wrap
        for panel, angle in zip(panels, angles.T, strict=True):
            panel.curves.append(curve._replace(y=angle))
    panels[0].names = len(curves)
    return panels


def _attitudes(trace: VehicleTrace, points: Thinned) -> Iterator[Curve]:
    """The reference, the autopilot beside a truth, and the estimate, as attitudes (N, 4)."""
    time_s = points.time_s
    if trace.reference is not None:
        known, name = points.every(trace["reference_q_ned_frd"]), REFERENCES[trace.reference]
        yield Curve(time_s, known, BLACK, name, 1.6)
    if has_peer(trace):
        theirs = points.every(trace["autopilot_q_ned_frd"])
        yield Curve(time_s, theirs, GREEN, "autopilot", 0.9, "--")
    yield Curve(time_s, points.every(trace["q_ned_frd"]), ORANGE, "estimate")


def _errors(span: Span, trace: VehicleTrace, points: Thinned) -> list[Panel]:
    """Inclination and heading error with the published sigma, and the autopilot's error."""
    what, panels = ERROR_WORDS.get(trace.reference or "", "sigma"), []
    for name, i in (("inclination", 2), ("heading", 1)):
        panel = Panel(span, ylabel=f"{name}\n{what} in °")
        sigma = np.degrees(trace[f"sigma_{name}_rad"])
        within = points.every(sigma)
        panel.areas.append(Area(points.time_s, 0.0 * within, within, BLUE, 0.25, "sigma"))
        if has_peer(trace):
            theirs = points.largest(np.degrees(trace["autopilot_error_rad"][:, i]))
            panel.curves.append(Curve(points.time_s, theirs, GREEN, "autopilot's error", 0.9, "--"))
        errors = np.degrees(trace["error_rad"][:, i])
        if trace.reference is not None:
            panel.curves.append(Curve(points.time_s, points.largest(errors), RED, what))
        cap(panel, errors, sigma)
        panels.append(panel)
    panels[0].names = 3
    return panels


def _internals(span: Span, trace: VehicleTrace, points: Thinned) -> list[Panel]:
    """Gain, confidences and bias."""
    gain = Panel(span, ylabel="gain K", low=0.0)
    gain.curves.append(Curve(points.time_s, points.largest(trace["gain"]), GREEN))
    confidence = Panel(span, ylabel="confidence", low=0.0, names=2)
    for name, color in (("gravity", BLUE), ("magnetic", PURPLE)):
        values = points.every(trace[f"confidence_{name}"])
        confidence.curves.append(Curve(points.time_s, values, color, name))
    bias = Panel(span, ylabel="gyro bias\nin °/s", names=3)
    values = points.every(np.degrees(trace["gyro_bias_rad_s"]))
    for axis, color, column in zip("xyz", COLORS, values.T, strict=False):
        bias.curves.append(Curve(points.time_s, column, color, axis))
    return [gain, confidence, bias]


def _marks(trace: VehicleTrace) -> list[Mark]:
    """The marks of a trace in seconds of its log, by the samples' arrivals."""
    arrivals_us = trace["arrival_us"]
    found = trace.marks.found(int(arrivals_us[0]), trace.autopilot, trace.vehicle_type)
    stamps_us = [stamp_us for stamp_us, _ in found]
    time_s = np.interp(stamps_us, arrivals_us, trace.time_s, right=np.nan).tolist()
    named = zip(time_s, found, strict=True)
    return [Mark(at_s, text) for at_s, (_, text) in named if not isnan(at_s)]


def cap(panel: Panel, *angles_deg: Floats) -> None:
    """Give the panel a height that shows nearly all of those, and write there what is cut off."""
    finite = np.concatenate([each[np.isfinite(each)] for each in angles_deg])
    panel.low, panel.high = 0.0, 1.0
    if len(finite):
        panel.high = max(1.0, 1.3 * float(np.percentile(finite, 99.0)))
    peak = max((np.nanmax(curve.y, initial=0.0) for curve in panel.curves), default=0.0)
    if peak > panel.high:
        panel.words.append(Words(f"cut off: up to {peak:.0f}°"))


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
        rows = [self._panels(log) for log in self._rows]
        size = (PAGE_INCHES[0], ROW_INCHES * (1 + len(rows)))
        save(Figure("", rows, size), path)

    def _panels(self, log: str) -> list[Panel]:
        replays = self._rows[log]
        span = (min(t[0] for _, t, _ in replays), max(t[-1] for _, t, _ in replays))
        panels = []
        for name, i in (("inclination", 2), ("heading", 1)):
            panel = Panel(span, xlabel=TIME, ylabel=f"{name} {self._words[log]} in °")
            for number, (profile, time_s, errors) in enumerate(replays):
                color = COLORS[number % len(COLORS)]
                panel.curves.append(Curve(time_s, errors[:, i], color, profile))
            cap(panel, *(errors[:, i] for _, _, errors in replays))
            if all(np.isnan(errors[:, i]).all() for _, _, errors in replays):
                panel.words.append(Words("nothing to compare with"))
            panels.append(panel)
        panels[0].title, panels[1].names = log, len(replays)
        return panels
