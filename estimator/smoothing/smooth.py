"""The smoothed attitude of a recording, as a summary of its steps."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from estimator.arrays import Bools, Floats, Times
from estimator.conditioning.params import LONG_S
from estimator.conditioning.rate import FAST_STEP_S
from estimator.live.rows import BIAS, RATE, SIGMA, Q
from estimator.smoothing.backward import backward
from estimator.smoothing.recorder import Recorder
from estimator.smoothing.recording import Recording, join, steps_s
from estimator.smoothing.unaided import LEAST_SAMPLES, pieces, put_unaided


class Smoothed(NamedTuple):
    """N attitudes by the whole recording."""

    q_ned_frd: Floats  # (N, 4)
    sigma_rad: Floats  # (N, 2) angles that 68 % of the errors of inclination and heading lie under
    rate_rad_s: Floats  # (N, 3) less the bias, FRD
    bias_rad_s: Floats  # (N, 3)


def smooth(recording: Recording) -> Smoothed:
    """The attitudes at the samples, by what came before and behind each.

    Fast streams without velocity are averaged both ways along the gyroscope's path. Elsewhere, and
    in vehicles between holes, where that average is short, the estimator goes over the recording
    once more, backward, and both estimates are joined. The recording's attitudes and bias are
    changed.
    """
    recording.look_ahead()
    best, n = recording.forward, len(recording.bias_rad_s)
    if n >= LEAST_SAMPLES:
        is_joined = of_both_ways(recording)
        if is_joined.any() or len(recording.reports):
            best = join(best, backward(recording))
            is_joined |= best.is_aided
        if not is_joined.all():
            put_unaided(recording, ~is_joined, best)
    return Smoothed(best.q_ned_frd, best.sigma_rad, recording.rate_rad_s, recording.bias_rad_s)


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


def smooth_offered(recorder: Recorder, output: Floats) -> Iterator[Any]:
    """Put smoothed attitudes into the rows that a recorder was offered with its samples; which."""
    for recording in recorder.recordings():
        smoothed = smooth(recording)
        for part, column in zip((Q, SIGMA, RATE, BIAS), smoothed, strict=True):
            output[recording.places, part] = column
        yield recording.places


def smooth_all(recorder: Recorder) -> tuple[Times, Smoothed]:
    """Times (us) and smoothed attitudes of all that a recorder has taken."""
    recordings = recorder.recordings()
    if len(recordings) == 1:
        return recordings[0].rows.times_us, smooth(recordings[0])
    parts = [Smoothed(*(np.zeros((0, n)) for n in (4, 2, 3, 3)))]
    parts += [smooth(recording) for recording in recordings]
    times_us = np.concatenate([np.zeros(0, np.int64), *(r.rows.times_us for r in recordings)])
    return times_us, Smoothed(*(np.concatenate(column) for column in zip(*parts, strict=True)))
