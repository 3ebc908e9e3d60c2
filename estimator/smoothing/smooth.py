"""The smoothed attitude of a recording: both ways joined, and the unaided spans piece by piece."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from estimator.aiding.search import UNKNOWN_RAD
from estimator.conditioning.field.magnetic import has_heading
from estimator.conditioning.params import LONG_S, QUICK_S
from estimator.conditioning.rate import FAST_STEP_S
from estimator.geometry.rotations import about_down, conjugate, cross, heading_of, multiply, rotate
from estimator.live.rows import OUTPUT_SIZE, RATE, SIGMA, Q
from estimator.smoothing.backward import backward
from estimator.smoothing.heading import turn_north
from estimator.smoothing.path import late_s, path_of
from estimator.smoothing.recorder import Recorder
from estimator.smoothing.recording import (
    Estimates,
    Recording,
    estimates_of,
    join,
    known_rows,
    steps_s,
)
from estimator.smoothing.vertical import level
from estimator.smoothing.windows import windows_of
from estimator.types import Bools, Floats, Times

# Fewer samples show nothing beyond the estimator's own output.
LEAST_SAMPLES = 50
# Long recordings are taken in pieces of so many seconds, with so much of their neighbours at both
# ends, which bounds the memory. Each piece has its own averaging time.
PIECE_S, MARGIN_S = 600.0, 100.0


def smooth(recording: Recording) -> None:
    """Put into the recording's output what came before and behind each sample shows.

    That is attitude, sigmas, rate and bias; the other columns stay. Fast streams without velocity
    are averaged both ways along the gyroscope's path. Elsewhere, and in vehicles between holes,
    where that average is short, the estimator goes over the recording once more, backward, and both
    estimates are joined.
    """
    recording.look_ahead()
    output, best = recording.output, estimates_of(recording.output)
    if len(output) >= LEAST_SAMPLES:
        is_joined = of_both_ways(recording)
        if is_joined.any() or len(recording.reports):
            best = join(best, backward(recording))
            is_joined |= best.is_aided
        if not is_joined.all():
            put_unaided(recording, ~is_joined, best)
    output[:, Q], output[:, SIGMA], output[:, RATE] = *best[:2], recording.rate_rad_s


def of_both_ways(recording: Recording) -> Bools:
    """The samples (N,) whose forces are not averaged, whether velocity helps or not."""
    settings, times_us = recording.last.settings, recording.rows.times_us
    is_slow = np.median(steps_s(recording.rows)) > FAST_STEP_S
    rows = np.full(len(times_us), is_slow or not settings.conditioned)
    for begin, end, _, _ in pieces(recording):
        is_short = times_us[end - 1] - times_us[begin] < 1e6 * LONG_S
        has_others = end - begin < len(rows)
        rows[begin:end] |= is_short and has_others and settings.conditioning.in_vehicle
    return rows


def put_unaided(recording: Recording, rows: Bools, into: Estimates) -> None:
    """Put the estimates of these samples (N,), piece by piece, in the place of others."""
    for begin, end, first, last in pieces(recording):
        if last - first >= LEAST_SAMPLES and rows[begin:end].any():
            inner = slice(begin - first, end - first)
            q, sigma = (each[inner] for each in of_piece(recording.part(first, last)))
            known = rows[begin:end] & known_rows(q, sigma)
            into.q_ned_frd[begin:end][known] = q[known]
            into.sigma_rad[begin:end][known] = sigma[known]


def pieces(recording: Recording) -> Iterator[tuple[int, int, int, int]]:
    """Rows (begin, end) of one IMU without a hole, and (first, last) of those that help them.

    A long stretch is divided.
    """
    times_us = recording.rows.times_us
    holes = np.flatnonzero(steps_s(recording.rows) > QUICK_S)
    ends = [*np.union1d(holes, recording.changes).astype(int).tolist(), len(times_us)]
    before = 0
    for end in ends:
        begin = before
        while begin < end:
            edges_s = np.array([-MARGIN_S, PIECE_S, PIECE_S + MARGIN_S])
            edges = np.searchsorted(times_us, times_us[begin] + 1e6 * edges_s).tolist()
            yield begin, min(edges[1], end), max(edges[0], before), min(edges[2], end)
            begin = edges[1]
        before = end


def of_piece(recording: Recording) -> tuple[Floats, Floats]:
    """The gyroscope's path levelled and turned to north (N, 4), and both sigmas (N, 2).

    Between the samples is no hole.
    """
    last, path = recording.last, path_of(recording)
    windows = windows_of(path.time_s)
    acc = recording.rows.acc_m_s2  # each at the attitude of its own time
    felt_g = rotate(path.q_g_frd, acc - late_s(recording) * cross(path.rate_rad_s, acc))
    vertical = level(last, windows, path, -felt_g)
    magnetic = last.core.conditioning.field.magnetic
    if has_heading(magnetic) and recording.rows.has_mag.any():
        q_ned_frd, heading_rad = turn_north(recording, windows, path, vertical)
    else:
        # without a field nothing but the way forward shows the heading
        before = estimates_of(recording.output)
        heading = heading_of(multiply(before.q_ned_frd, conjugate(vertical.q_6d_frd)))
        q_ned_frd = multiply(about_down(heading), vertical.q_6d_frd)
        heading_rad = before.sigma_rad[:, 1]
    shown = np.hypot(heading_rad, last.unshown_iron_rad)
    heading_rad = np.minimum(shown, np.maximum(heading_rad, UNKNOWN_RAD))
    return q_ned_frd, np.stack([vertical.sigma_rad, heading_rad], axis=-1)


def smooth_offered(recorder: Recorder, output: Floats) -> Iterator[Any]:
    """Put smoothed attitudes into the rows that a recorder was offered with its samples; which."""
    for recording in recorder.recordings():
        smooth(recording)
        output[recording.places] = recording.output
        yield recording.places


def smooth_all(recorder: Recorder) -> tuple[Times, Floats]:
    """Times (us) and smoothed output (N, OUTPUT_SIZE) of all that a recorder has taken."""
    recordings = recorder.recordings()
    for recording in recordings:
        smooth(recording)
    times_us = np.concatenate([np.zeros(0, np.int64), *(r.rows.times_us for r in recordings)])
    return times_us, np.concatenate([np.zeros((0, OUTPUT_SIZE)), *(r.output for r in recordings)])
