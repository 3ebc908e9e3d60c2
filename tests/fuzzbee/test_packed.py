"""Attitudes and samples as rows of numbers: what was put in comes out."""

import numpy as np
import pytest

from estimator.types import Attitude, ImuSample
from fuzzbee.column_store import PackedAttitudes, PackedSamples

LATE_US = 2**62  # more than a float holds to the microsecond


def numbers(start, count):
    return tuple(start + 0.125 * k for k in range(count))


ATTITUDES = [
    Attitude(LATE_US + k, numbers(k, 4), numbers(10, 3), numbers(20, 3), *numbers(30, 7), north)
    for k, north in enumerate(("none", "true", "magnetic"))
]
SAMPLES = [
    ImuSample(LATE_US + k, numbers(k, 3), numbers(10, 3), numbers(20, 3), k == 1) for k in range(3)
]


@pytest.mark.parametrize(
    ("packed", "rows"), [(PackedAttitudes, ATTITUDES), (PackedSamples, SAMPLES)]
)
def test_rows_come_out_as_they_were_put_in(packed, rows):
    made = packed(rows)
    assert list(made) == rows
    assert made[-1] == rows[-1]
    assert made[1:] == rows[1:]
    assert made.times_us.tolist() == [row.time_us for row in rows]
    assert [type(value) for value in made[1]] == [type(value) for value in rows[1]]
    with pytest.raises(IndexError):
        made[3]


def test_columns_are_the_fields():
    made = PackedAttitudes(ATTITUDES)
    for name in Attitude._fields[1:-1]:
        assert (
            made.column(name).tolist() == np.array([getattr(a, name) for a in ATTITUDES]).tolist()
        )
    assert made.norths().tolist() == ["none", "true", "magnetic"]
    made.replace("q_ned_frd", np.full((3, 4), 7.0))
    made.replace("gain", np.full(3, 8.0))
    assert made[2] == ATTITUDES[2]._replace(q_ned_frd=(7.0,) * 4, gain=8.0)
    made.append(ATTITUDES[0])
    assert made[3] == ATTITUDES[0]
