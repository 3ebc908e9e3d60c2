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


@pytest.mark.parametrize("dt", [0.0025, 0.01, 0.02, 0.04])
@pytest.mark.parametrize("ago_s", [0.0, 0.013, 0.1, 0.305, 0.5])
def test_looking_back_gives_velocity_and_acceleration_of_then(dt, ago_s):
    """A swing of 1.1 Hz: 0.16 mm/s off at 50 Hz, 1 mm/s at 25 Hz (chords of its acceleration)."""
    velocity_history, t = flown(2.0, dt)
    past = look_back(velocity_history, ago_s)
    gained = [now - then for now, then in zip(velocity(t), velocity(t - ago_s), strict=True)]
    limit, acceleration_limit = (0.0002, 0.0115) if dt < 0.03 else (0.0012, 0.061)
    assert past.gained_m_s == pytest.approx(gained, abs=limit)
    assert past.acceleration_m_s2 == pytest.approx(acceleration(t - ago_s), abs=acceleration_limit)


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


def test_the_history_given_stays_as_it_is():
    velocity_history, _ = flown(0.5, 0.02)
    before = velocity_history.copy()
    extend_velocity_history(velocity_history, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0), 0.02)
    assert (velocity_history == before).all()
