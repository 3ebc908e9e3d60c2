import pytest

from service.health import (
    TRANSITIONS,
    Health,
    Signal,
    State,
    late_after_us,
    lost_after_us,
    next_state,
    on_sample,
    on_time,
)

PERIOD_US = 10_000


def test_a_vehicle_that_comes_goes_and_returns():
    health = on_sample(Health(), 0, aligned=False)
    assert health.state is State.ALIGNING
    health = on_sample(health, PERIOD_US, aligned=True)
    assert health.state is State.RUNNING
    last = PERIOD_US
    assert on_time(health, last + 499_999, PERIOD_US).state is State.RUNNING
    health = on_time(health, last + 500_000, PERIOD_US)
    assert health.state is State.DEGRADED
    assert on_time(health, last + 4_999_999, PERIOD_US).state is State.DEGRADED
    health = on_time(health, last + 5_000_000, PERIOD_US)
    assert health.state is State.LOST
    assert on_sample(health, last + 6_000_000, aligned=True).state is State.RUNNING


@pytest.mark.parametrize(
    ("period_us", "late_us", "lost_us"),
    [(0, 5e5, 5e6), (10_000, 5e5, 5e6), (250_000, 7.5e5, 5e6), (1_000_000, 3e6, 10e6)],
)
def test_slow_streams_are_given_more_time(period_us, late_us, lost_us):
    assert late_after_us(period_us) == late_us
    assert lost_after_us(period_us) == lost_us


def test_silence_before_the_first_sample_is_waiting():
    assert on_time(Health(), 10**12, 0).state is State.WAITING


def test_a_long_stall_goes_straight_to_lost():
    health = on_sample(Health(), 0, aligned=True)
    assert on_time(health, 6_000_000, PERIOD_US).state is State.LOST


def test_a_clock_set_back_is_no_silence():
    health = on_sample(Health(), 10**9, aligned=True)
    assert on_time(health, 0, PERIOD_US).state is State.RUNNING


def test_every_state_can_be_reached_and_left_but_for_waiting():
    assert set(TRANSITIONS.values()) == set(State) - {State.WAITING}
    assert {old for old, _ in TRANSITIONS} == set(State)


@pytest.mark.parametrize("state", State)
def test_an_aligned_sample_always_means_running(state):
    assert next_state(state, Signal.ALIGNED) is State.RUNNING


@pytest.mark.parametrize("state", [s for s in State if s is not State.ALIGNING])
def test_a_sample_without_attitude_always_means_aligning(state):
    """As after a clock that began anew: the attitude from before is not published any more."""
    assert on_sample(Health(state, 0), PERIOD_US, aligned=False).state is State.ALIGNING


def test_a_vehicle_that_falls_silent_while_aligning_is_lost_but_never_degraded():
    health = on_sample(Health(), 0, aligned=False)
    assert on_time(health, 4_999_999, PERIOD_US).state is State.ALIGNING
    assert on_time(health, 5_000_000, PERIOD_US).state is State.LOST


def test_silence_is_counted_from_the_last_sample_whatever_it_was():
    """Also from a sample that aligns nothing, and from one that ends a silence."""
    health = on_sample(Health(State.LOST, 0), 9_000_000, aligned=False)
    assert health.last_arrival_us == 9_000_000
    assert on_time(health, 13_900_000, PERIOD_US).state is State.ALIGNING
    assert on_sample(health, 9_010_000, aligned=True).last_arrival_us == 9_010_000
