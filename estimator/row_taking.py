"""Many samples through one estimator, which says something after each of them."""

from typing import Any

from estimator.estimator import Estimator
from estimator.live.rows import BIAS, SIGMA, Q, Rows, cut


def take(inner: Estimator, rows: Rows, said: Any, aided: Any) -> None:
    """All rows, many at a time where nothing else is to be done."""
    begin, end = 0, len(said)
    while begin < end:
        begin += inner.update_rows(cut(rows, begin, end), said[begin:end])
        if begin < end:
            time_us = take_row(inner, rows, begin)
            if inner.aligned:
                attitude = inner.attitude(time_us)
                said[begin, Q], said[begin, BIAS] = attitude.q_ned_frd, attitude.gyro_bias_rad_s
                said[begin, SIGMA] = attitude.sigma_inclination_rad, attitude.sigma_heading_rad
                aided[begin] = inner.is_aided
            begin += 1


def take_row(inner: Estimator, rows: Rows, k: int) -> int:
    """One row, by itself; its time."""
    time_us, gyr, acc, mag, has_mag = (column[k].tolist() for column in rows)
    inner.take(time_us, tuple(gyr), tuple(acc), tuple(mag), has_mag)
    return int(time_us)
