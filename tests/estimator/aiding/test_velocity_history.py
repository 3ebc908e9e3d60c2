"""What was gained since a moment in the past, against the same motion in closed form."""

from math import cos, sin

import pytest

from estimator.aiding.velocity_history import (
    ROWS,
    extend_velocity_history,
    look_back,
    new_velocity_history,
)

PERIOD = 7.0  # rad/s of the swing


def velocity(t):
    return (sin(PERIOD * t), 2.0 * t, 0.5 * t * t)


def acceleration(t):
    return (PERIOD * cos(PERIOD * t), 2.0, t)


def flown(seconds, dt):
    velocity_history, t = new_velocity_history(acceleration(0.0)), 0.0
    while t < seconds - 1e-9:
        gained = tuple(b - a for a, b in zip(velocity(t), velocity(t + dt), strict=True))
        t += dt
        velocity_history = extend_velocity_history(velocity_history, gained, acceleration(t), dt)
    return velocity_history, t


def test_ahead_of_the_newest_sample_its_acceleration_goes_on():
    velocity_history, t = flown(1.0, 0.02)
    past = look_back(velocity_history, -0.01)
    assert past.gained_m_s == pytest.approx([-0.01 * a for a in acceleration(t)])


def test_before_the_history_begins_the_oldest_acceleration_goes_on():
    velocity_history, t = flown(0.1, 0.02)
    past = look_back(velocity_history, 0.3)
    wanted = [
        now - begin + 0.2 * a
        for now, begin, a in zip(velocity(t), velocity(0.0), acceleration(0.0), strict=True)
    ]
    assert past.gained_m_s == pytest.approx(wanted, abs=1e-9)


def test_quick_samples_do_not_shorten_it():
    """At 400 Hz the rows still reach back half a second."""
    velocity_history, _ = flown(1.0, 0.0025)
    assert velocity_history[0, 0] - velocity_history[ROWS - 1, 0] > 0.5
