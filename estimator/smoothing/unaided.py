"""A fast stream without velocity: the gyroscope's path, levelled and turned to north."""

from collections.abc import Iterator

import numpy as np

from estimator.aiding.search import UNKNOWN_RAD
from estimator.arrays import Bools
from estimator.conditioning.params import QUICK_S
from estimator.geometry.rotations import about_down, conjugate, cross, heading_of, multiply, rotate
from estimator.smoothing.field import field_of
from estimator.smoothing.heading import Headed, turn_north
from estimator.smoothing.path import late_s, path_of
from estimator.smoothing.recording import Estimates, Recording, known_rows, steps_s
from estimator.smoothing.vertical import level
from estimator.smoothing.windows import windows_of

# Fewer samples show nothing beyond the estimator's own output.
LEAST_SAMPLES = 50
# Long recordings are taken in pieces of so many seconds, with so much of their neighbours at both
# ends, which bounds the memory. Each piece has its own averaging time.
PIECE_S, MARGIN_S = 600.0, 100.0


def put_unaided(recording: Recording, rows: Bools, into: Estimates) -> None:
    """Put the estimates of these samples (N,), piece by piece, in the place of others."""
    for begin, end, first, last in pieces(recording):
        if last - first >= LEAST_SAMPLES and rows[begin:end].any():
            found = of_piece(recording.part(first, last)).part(slice(begin - first, end - first))
            known = rows[begin:end] & known_rows(found)
            into.q_ned_frd[begin:end][known] = found.q_ned_frd[known]
            into.sigma_rad[begin:end][known] = found.sigma_rad[known]


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


def of_piece(recording: Recording) -> Estimates:
    """The estimates of samples without a hole."""
    path = path_of(recording)
    windows = windows_of(path.time_s)
    acc = recording.rows.acc_m_s2  # each at the attitude of its own time
    felt_g = rotate(path.q_g_frd, acc - late_s(recording) * cross(path.rate_rad_s, acc))
    vertical = level(recording.last, windows, path, -felt_g)
    field = field_of(recording)
    if field.is_known and field.has_mag.any():
        params = recording.last.settings.conditioning
        headed = turn_north(params, windows, path, vertical, field)
    else:
        # without a field nothing but the way forward shows the heading
        before = recording.forward
        heading = heading_of(multiply(before.q_ned_frd, conjugate(vertical.q_6d_frd)))
        q_ned_frd = multiply(about_down(heading), vertical.q_6d_frd)
        headed = Headed(q_ned_frd, before.sigma_rad[:, 1])
    heading_rad = headed.sigma_rad
    shown = np.hypot(heading_rad, field.unshown_iron_rad)
    heading_rad = np.minimum(shown, np.maximum(heading_rad, UNKNOWN_RAD))
    sigma = np.stack([vertical.sigma_rad, heading_rad], axis=-1)
    return Estimates(headed.q_ned_frd, sigma, recording.forward.is_aided)
