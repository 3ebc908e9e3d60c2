"""What a figure shows of a replay's times: what was wrong or helped, modes, arming, warnings."""

from collections.abc import Iterator

import numpy as np

from drivers.mavlink.constants import mode_name
from estimator.arrays import Bools, Floats
from estimator.conditioning.vertical.rate import LEAST_PEAK_RAD_S
from fuzzbee.replays.score import CONVERGED_RAD
from fuzzbee.replays.trace import VehicleTrace

# Silence this many median periods long, and this long (s), is a gap to be shown.
GAP_PERIODS = 5.0
LEAST_GAP_S = 0.3
# A field is contradicted where its confidence is this share of the usual one or less.
CONTRADICTED = 0.5
# What lasts less (s) is no band, and two bands that are nearer to each other are one.
LEAST_S = 1.0
CLIPPED_SAMPLES = 2  # in a row at the same largest reading: chance has one
MOST_TEXTS = 20  # a failing autopilot repeats itself
LETTERS = 32  # of a text that are shown

Span = tuple[float, float]
Band = tuple[str, str, float, list[Span]]  # name, colour, opacity, and what is shaded


def bands(time_s: Floats, trace: VehicleTrace) -> Iterator[Band]:
    """All bands that there are; those first that others may lie on."""
    aided = trace["is_aided"]
    if aided.any():
        yield ("no velocity", "tab:blue", 0.12, runs(time_s, ~aided))
    confidence = trace["confidence_magnetic"]
    usual = float(np.median(confidence))
    if usual > 0.0:
        spans = runs(time_s, confidence <= CONTRADICTED * usual)
        yield ("field doubted", "tab:purple", 0.2, spans)
    yield ("gyroscope at its end", "tab:brown", 0.35, _clipped(time_s, trace))
    if trace.turned_at_us is not None:
        yield ("wrong start", "tab:red", 0.2, _wrong(time_s, trace))
    intervals, zero_us = trace.vehicle.comparison.intervals, trace.zero_us
    differing = [(1e-6 * (i.begin_us - zero_us), 1e-6 * (i.end_us - zero_us)) for i in intervals]
    yield ("autopilot differs", "tab:orange", 0.2, differing)
    yield ("gap", "0.8", 1.0, gaps(time_s))


def runs(time_s: Floats, flags: Bools, least_s: float = LEAST_S) -> list[Span]:
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
    return runs(time_s, again.any(axis=1), 0.0) if again.sum() >= CLIPPED_SAMPLES else []


def _wrong(time_s: Floats, trace: VehicleTrace) -> list[Span]:
    """From a start that was turned until the error is small for the first time."""
    turned = trace["time_us"] >= (trace.turned_at_us or 0)
    small = turned & (trace["error_rad"][:, 0] < CONVERGED_RAD)
    begin = int(np.argmax(turned))
    end = int(np.argmax(small)) if small.any() else len(time_s) - 1
    return [(float(time_s[begin]), float(time_s[end]))]


def gaps(time_s: Floats) -> list[Span]:
    """Begin and end of the gaps in the stream of samples at times (N,)."""
    if len(time_s) < 2:
        return []
    steps = np.diff(time_s)
    longest = max(LEAST_GAP_S, GAP_PERIODS * float(np.median(steps)))
    return [(float(time_s[k]), float(time_s[k + 1])) for k in np.flatnonzero(steps > longest)]


def marks(trace: VehicleTrace) -> list[tuple[float, str]]:
    """When modes, arming and warnings came, and their names; first the mode that it began in.

    Seconds of the log are by the samples' arrivals.
    """
    arrivals_us = trace["arrival_us"]
    begin_us = int(arrivals_us[0])
    found = [(us, mode_name(*trace.kind, number)) for us, number in trace.modes]
    began = [(begin_us, name) for us, name in found if us < begin_us][-1:]
    found += [(us, "armed" if is_armed else "disarmed") for us, is_armed in trace.arming[1:]]
    found += [(us, text[:LETTERS]) for text, us in [*trace.texts.items()][:MOST_TEXTS]]
    found = began + sorted(each for each in found if begin_us <= each[0] <= arrivals_us[-1])
    time_s = np.interp([us for us, _ in found], arrivals_us, trace.time_s).tolist()
    return [(at_s, name) for at_s, (_, name) in zip(time_s, found, strict=True)]
