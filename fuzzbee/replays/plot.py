"""A replay as a figure: attitude, errors and sigma, gain, confidences, bias and gaps."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drivers.mavlink.constants import mode_name
from estimator.conditioning.rate import LEAST_PEAK_RAD_S
from estimator.types import Bools, Floats
from fuzzbee.attitudes import euler_curves_deg
from fuzzbee.replays.figure import BLACK, COLORS, DARK, add_legend, add_text, written_figure
from fuzzbee.replays.report import REFERENCES
from fuzzbee.replays.score import CONVERGED_RAD
from fuzzbee.replays.trace import VehicleTrace

PAGE_INCHES = (7.1, 9.8)  # between its margins
ROW_INCHES = 2.2
MOST_POINTS = 20_000  # with more a line looks the same and the file only grows
NEAR = 0.015  # of the width: names of two marks would hide each other
# The autopilot is no truth: from it an estimate only differs.
ERROR_WORDS = {"sim": "error", "autopilot": "difference"}
TIME = "time in s"
GAP_PERIODS, LEAST_GAP_S = 5.0, 0.3  # silence for so many median periods, and so long, is shown
CONTRADICTED = 0.5  # a field is, where its confidence is this share of the usual one or less
LEAST_S = 1.0  # what lasts less is no band; bands that are nearer to each other are one
CLIPPED_SAMPLES = 2  # in a row at the same largest reading: chance has one
MOST_TEXTS = 20  # a failing autopilot repeats itself
LETTERS = 32  # of a text that are shown

Span = tuple[float, float]
Band = tuple[str, str, float, list[Span]]  # name, colour, opacity, and what is shaded


class Thinned:
    """No more points of lines over time (N,) than are seen, and none across a gap."""

    def __init__(self, time_s: Floats) -> None:
        self._step = 1 + len(time_s) // MOST_POINTS
        shown_s, spans = time_s[:: self._step], np.reshape(_gaps(time_s), (-1, 2))
        self._breaks = np.searchsorted(shown_s, spans[:, 1])
        self.time_s = np.insert(shown_s, self._breaks, spans.mean(axis=1))  # what is drawn (M,)

    def every(self, values: Floats) -> Floats:
        """Some of the values (N,) or (N, K), and NaN in each gap."""
        return np.insert(values[:: self._step], self._breaks, np.nan, axis=0)

    def largest(self, values: Floats) -> Floats:
        """The same of values whose peaks show: the largest around each."""
        found = np.fmax.reduceat(values, np.arange(0, len(values), self._step))
        return np.insert(np.asarray(found), self._breaks, np.nan, axis=0)


def draw(path: Path, trace: VehicleTrace) -> None:
    """Draw a trace that has been compared into a file; its suffix is the format."""
    time_s, points = trace.time_s, Thinned(trace.time_s)
    span = (float(time_s[0]), max(float(time_s[-1]), time_s[0] + 1e-3))
    shown: dict[str, dict[str, Any]] = {}  # columns of attitudes, and how they look
    if trace.reference is not None:
        name = REFERENCES[trace.reference]
        shown["reference_q_ned_frd"] = {"color": BLACK, "label": name, "lw": 1.6}
    if trace.has_peer:
        look = {"color": "tab:green", "label": "autopilot", "lw": 0.9, "ls": "--"}
        shown["autopilot_q_ned_frd"] = look
    shown["q_ned_frd"] = {"color": "tab:orange", "label": "estimate"}
    with written_figure(path, trace.log.path.name, PAGE_INCHES, is_over_log=True) as sheet:
        axes = sheet.subplots(8, 1, subplot_kw={"xlim": span})
        for name, look in shown.items():
            draw_angles(axes[:3], points.time_s, points.every(trace[name]), **look)
        add_legend(axes[0], len(shown))
        _draw_errors(axes[3:5], trace, points)
        _draw_internals(axes[5:], trace, points)
        _draw_times(axes, trace, time_s, NEAR * (span[1] - span[0]))
        axes[-1].set_xlabel(TIME)


def draw_angles(axes: Sequence[Any], time_s: Floats, q_ned_frd: Floats, **look: Any) -> None:
    """Roll, pitch and heading of attitudes (N, 4), each in its axes."""
    angles = euler_curves_deg(q_ned_frd)
    angles[1:][np.abs(np.diff(angles, axis=0)) > 180.0] = np.nan  # no line across a wrap
    for ax, name, angle in zip(axes, ("roll", "pitch", "heading"), angles.T, strict=True):
        ax.plot(time_s, angle, **look)
        ax.set_ylabel(f"{name} in °")


def _draw_errors(axes: Sequence[Any], trace: VehicleTrace, points: Thinned) -> None:
    """Inclination and heading error with the published sigma, and the autopilot's error."""
    what, time_s = ERROR_WORDS.get(trace.reference or "", "sigma"), points.time_s
    for ax, name, i in zip(axes, ("inclination", "heading"), (2, 1), strict=True):
        ax.set_ylabel(f"{name}\n{what} in °")
        sigma = np.degrees(trace[f"sigma_{name}_rad"])
        within = points.every(sigma)
        look = {"color": "tab:blue", "alpha": 0.25, "lw": 0, "label": "sigma"}
        ax.fill_between(time_s, 0.0 * within, within, **look)
        if trace.has_peer:
            theirs = points.largest(np.degrees(trace["autopilot_error_rad"][:, i]))
            ax.plot(time_s, theirs, "--", color="tab:green", label="autopilot's error", lw=0.9)
        errors = np.degrees(trace["error_rad"][:, i])
        if trace.reference is not None:
            ax.plot(time_s, points.largest(errors), color="tab:red", label=what)
        _cap(ax, errors, sigma)
    add_legend(axes[0], 3)


def _draw_internals(axes: Sequence[Any], trace: VehicleTrace, points: Thinned) -> None:
    time_s, (gain, confidence, bias) = points.time_s, axes
    gain.plot(time_s, points.largest(trace["gain"]), color="tab:green", label="_gain")
    for name, color in (("gravity", "tab:blue"), ("magnetic", "tab:purple")):
        values = points.every(trace[f"confidence_{name}"])
        confidence.plot(time_s, values, color=color, label=name)
    values = points.every(np.degrees(trace["gyro_bias_rad_s"]))
    for axis, color, column in zip("xyz", COLORS, values.T, strict=False):
        bias.plot(time_s, column, color=color, label=axis)
    for ax, label in zip(axes, ("gain K", "confidence", "gyro bias\nin °/s"), strict=True):
        ax.set_ylabel(label)
        add_legend(ax, 3)
    for ax in (gain, confidence):
        ax.set_ylim(0.0, None)


def _draw_times(axes: Sequence[Any], trace: VehicleTrace, time_s: Floats, near_s: float) -> None:
    """Bands and moments. Of two moments near each other one name stands on either side."""
    gain, moments = axes[5], _marks(trace)  # which has one curve, and so room for a legend
    for label, color, alpha, spans in _bands(time_s, trace):
        for ax in axes:
            for number, span in enumerate(spans):
                name = label if ax is gain and number == 0 else "_band"
                ax.axvspan(*span, color=color, alpha=alpha, lw=0, label=name)
    add_legend(gain, 6)
    last_s, is_right = -np.inf, False
    for at_s, name in moments:
        for ax in axes:
            ax.axvline(at_s, color=DARK, lw=0.5, ls=":", label="_mark")
        is_right, last_s = at_s - last_s < near_s and not is_right, at_s
        look: Any = {"rotation": 90.0, "fontsize": 5.5, "va": "top"}
        look["ha"] = "right" if is_right else "left"
        axes[0].text(at_s, 0.97, name, transform=axes[0].get_xaxis_transform(), **look)


def _cap(ax: Any, *angles_deg: Floats) -> None:
    """Give the axes a height that shows nearly all of those, and write there what is cut off."""
    finite = np.concatenate([each[np.isfinite(each)] for each in angles_deg])
    most = max(1.0, 1.3 * float(np.percentile(finite, 99.0))) if len(finite) else 1.0
    ax.set_ylim(0.0, most)
    peak = max((np.nanmax(line.get_ydata(), initial=0.0) for line in ax.lines), default=0.0)
    if peak > most:
        add_text(ax, f"cut off: up to {peak:.0f}°")
    elif not len(finite):
        add_text(ax, "nothing to compare with")


class ComparisonPlot:
    """Several replays in one figure: their errors or differences, a row a log, a line a profile."""

    def __init__(self) -> None:
        # by the log and by what an angle to its reference is
        self._rows: dict[tuple[str, str], list[tuple[str, Floats, Floats]]] = {}

    def add(self, profile: str, trace: VehicleTrace) -> None:
        """Take one replay, of which no more is kept than a line needs."""
        errors, points = np.degrees(trace["error_rad"]), Thinned(trace.time_s)
        if not trace.has_heading:
            errors[:, 1] = np.nan  # a heading from nowhere has no error
        line = (profile, points.time_s, points.largest(errors))
        word = ERROR_WORDS.get(trace.reference or "", "error")
        self._rows.setdefault((trace.log.path.name, word), []).append(line)

    def draw(self, path: Path) -> None:
        """Write the figure."""
        size = (PAGE_INCHES[0], ROW_INCHES * (1 + len(self._rows)))
        with written_figure(path, "", size) as sheet:
            rows = sheet.subplots(len(self._rows), 2, squeeze=False)
            for ((log, word), replays), axes in zip(self._rows.items(), rows, strict=True):
                span = (min(t[0] for _, t, _ in replays), max(t[-1] for _, t, _ in replays))
                for ax, name, i in zip(axes, ("inclination", "heading"), (2, 1), strict=True):
                    ax.set(xlabel=TIME, ylabel=f"{name} {word} in °", xlim=span)
                    for number, (profile, time_s, errors) in enumerate(replays):
                        color = COLORS[number % len(COLORS)]
                        ax.plot(time_s, errors[:, i], color=color, label=profile)
                    _cap(ax, *(errors[:, i] for *_, errors in replays))
                axes[0].set_title(log)
                add_legend(axes[1], len(replays))


# --- times: what was wrong or helped, modes, arming, warnings


def _bands(time_s: Floats, trace: VehicleTrace) -> Iterator[Band]:
    """All bands that there are; those first that others may lie on."""
    aided = trace["is_aided"]
    if aided.any():
        yield ("no velocity", "tab:blue", 0.12, _runs(time_s, ~aided))
    confidence = trace["confidence_magnetic"]
    usual = float(np.median(confidence))
    if usual > 0.0:
        spans = _runs(time_s, confidence <= CONTRADICTED * usual)
        yield ("low field confidence", "tab:purple", 0.2, spans)
    yield ("gyroscope at its end", "tab:brown", 0.35, _clipped(time_s, trace))
    if trace.turned_at_us is not None:  # until the error is small for the first time
        turned = trace["time_us"] >= trace.turned_at_us
        small = np.flatnonzero(turned & (trace["error_rad"][:, 0] < CONVERGED_RAD))
        ends = time_s[[int(np.argmax(turned)), small[0] if len(small) else -1]]
        yield ("wrong start", "tab:red", 0.2, [(float(ends[0]), float(ends[1]))])
    intervals, zero_us = trace.vehicle.comparison.intervals, trace.zero_us
    differing = [(1e-6 * (i.begin_us - zero_us), 1e-6 * (i.end_us - zero_us)) for i in intervals]
    yield ("autopilot differs", "tab:orange", 0.2, differing)
    yield ("gap", "0.8", 1.0, _gaps(time_s))


def _runs(time_s: Floats, flags: Bools, least_s: float = LEAST_S) -> list[Span]:
    """Where flags (N,) hold, for ``least_s`` at least."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    joined: list[Span] = []
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        begin_s, end_s = float(time_s[begin]), float(time_s[min(end, len(time_s) - 1)])
        if joined and begin_s - joined[-1][1] < LEAST_S:
            begin_s = joined.pop()[0]
        joined.append((begin_s, end_s))
    return [span for span in joined if span[1] - span[0] >= least_s]


def _clipped(time_s: Floats, trace: VehicleTrace) -> list[Span]:
    """Where an axis stands still at the largest reading that it ever had."""
    size = np.abs(trace["gyr_rad_s"])
    ends = size.max(axis=0, initial=0.0)
    at_end = (size == ends) & (ends >= LEAST_PEAK_RAD_S)
    again = at_end & np.roll(at_end, 1, axis=0)
    again[:1] = False
    return _runs(time_s, again.any(axis=1), 0.0) if again.sum() >= CLIPPED_SAMPLES else []


def _gaps(time_s: Floats) -> list[Span]:
    """Begin and end of the gaps in the stream of samples at times (N,)."""
    if len(time_s) < 2:
        return []
    steps = np.diff(time_s)
    longest = max(LEAST_GAP_S, GAP_PERIODS * float(np.median(steps)))
    return [(float(time_s[k]), float(time_s[k + 1])) for k in np.flatnonzero(steps > longest)]


def _marks(trace: VehicleTrace) -> list[tuple[float, str]]:
    """When modes, arming and warnings came (s), and their names; first the mode it began in."""
    arrivals_us = trace["arrival_us"]
    begin_us = int(arrivals_us[0])
    found = [(us, mode_name(*trace.kind, number)) for us, number in trace.modes]
    began = [(begin_us, name) for us, name in found if us < begin_us][-1:]
    found += [(us, "armed" if is_armed else "disarmed") for us, is_armed in trace.arming[1:]]
    found += [(us, text[:LETTERS]) for text, us in [*trace.texts.items()][:MOST_TEXTS]]
    found = began + sorted(each for each in found if begin_us <= each[0] <= arrivals_us[-1])
    time_s = np.interp([us for us, _ in found], arrivals_us, trace.time_s).tolist()
    return [(at_s, name) for at_s, (_, name) in zip(time_s, found, strict=True)]
