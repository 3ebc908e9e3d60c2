"""Times of a replay that a figure shades: what was wrong then, and what helped."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from estimator.arrays import Bools, Floats
from estimator.conditioning.vertical.rate import LEAST_PEAK_RAD_S
from fuzzbee.replays.figure import BLUE, BROWN, GREY, ORANGE, PURPLE, RED
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

Span = tuple[float, float]


class Band(NamedTuple):
    """Spans of time that are shaded over the whole height."""

    label: str
    color: str
    alpha: float
    spans: list[Span]


def bands(time_s: Floats, trace: VehicleTrace) -> Iterator[Band]:
    """All bands that there are; those first that others may lie on."""
    aided = trace["is_aided"]
    if aided.any():
        yield Band("no velocity", BLUE, 0.12, runs(time_s, ~aided))
    confidence = trace["confidence_magnetic"]
    usual = float(np.median(confidence))
    if usual > 0.0:
        spans = runs(time_s, confidence <= CONTRADICTED * usual)
        yield Band("field doubted", PURPLE, 0.2, spans)
    yield Band("gyroscope at its end", BROWN, 0.35, _clipped(time_s, trace))
    if trace.turned_at_us is not None:
        yield Band("wrong start", RED, 0.2, _wrong(time_s, trace))
    intervals, zero_us = trace.second_opinion.intervals, trace.zero_us
    differing = [(1e-6 * (i.begin_us - zero_us), 1e-6 * (i.end_us - zero_us)) for i in intervals]
    yield Band("autopilot differs", ORANGE, 0.2, differing)
    yield Band("gap", GREY, 1.0, gaps(time_s))


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
