"""What is a gap depends on the stream."""

import pytest

from estimator.live.refusal import is_gap, usual_interval


def usual(steps_s):
    value = 0.0
    for dt_s in steps_s:
        value = usual_interval(value, dt_s)
    return value


@pytest.mark.parametrize(
    ("step_s", "longest_s"), [(0.02, 3.618), (0.25, 1.0), (0.5, 1.5), (1.0, 3.0), (2.0, 6.0)]
)
def test_a_gap_is_three_usual_intervals_and_a_second_at_least(step_s, longest_s):
    steady = usual([step_s] * 50)
    assert not is_gap(steady, longest_s - 0.01)
    assert is_gap(steady, longest_s + 0.01)


def test_one_gap_makes_no_slow_stream():
    assert usual([0.02] * 50 + [10.0]) == pytest.approx(0.022)


def test_a_stream_that_slows_down_is_followed():
    assert usual([0.02] * 50 + [1.0] * 70) > 0.85


def test_a_slow_streams_gap_is_shorter_than_a_fast_ones():
    assert is_gap(0.2, 1.1)
    assert not is_gap(0.02, 3.6)
    assert is_gap(0.02, 3.7)
