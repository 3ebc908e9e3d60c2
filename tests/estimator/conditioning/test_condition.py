"""The whole stage, on motions whose truth is known."""

import itertools
from math import cos, pi, radians, sin

import pytest

from estimator.geometry.quaternion import normalize, rotate_inverse, scale
from tests.estimator.conditioning.motion import (
    FIELD_NED,
    GRAVITY_M_S2,
    Sample,
    conditioned,
    fly,
    tumbling,
    turned,
    vector_errors_rad,
)


def resting(q, **changes):
    """What sensors read at rest with attitude ``q``."""
    acc = rotate_inverse(q, (0.0, 0.0, -GRAVITY_M_S2))
    return Sample(q, acc=acc, mag=rotate_inverse(q, FIELD_NED))._replace(**changes)


def run(sample, seconds, dt, memory=None):
    """A vehicle that goes on so; what is remembered at the end, and the last result."""
    *_, (_, out, memory) = conditioned([sample] * round(seconds / dt), dt, memory=memory)
    return memory, out


ATTITUDES = [
    (1.0, 0.0, 0.0, 0.0),
    (cos(pi / 4), sin(pi / 4), 0.0, 0.0),  # on its side
    (0.0, 1.0, 0.0, 0.0),  # on its back
    normalize((0.3, -0.5, 0.7, 0.2)),
]


@pytest.mark.parametrize("q", ATTITUDES)
@pytest.mark.parametrize("dt", [0.0025, 0.02, 0.25, 1.0])
@pytest.mark.parametrize("mag_scale", [1.0, 50.0, 430.0])
def test_rest_gives_the_true_vectors_at_any_rate_and_field_unit(q, dt, mag_scale):
    sample = resting(q)
    _, out = run(sample._replace(mag=scale(mag_scale, sample.mag)), 8.0, dt)
    assert max(vector_errors_rad(out, q)) < 1.2e-6  # measured 1.04e-6
    assert out.magnetic_confidence == pytest.approx(1.0)


@pytest.mark.parametrize("dt", [0.0035, 0.02, 0.25])
def test_bias_is_learnt_at_rest(dt):
    bias = (radians(0.4), radians(-0.3), radians(0.2))
    memory, out = run(resting(ATTITUDES[3], gyr=bias), 40.0, dt)
    # measured 0.00012 deg/s; with noise 0.03 deg/s is the steady sigma at rest
    assert out.bias_rad_s == pytest.approx(bias, abs=radians(0.00015))
    assert memory.known.vertical.rest.resting


def test_without_a_field_there_is_gravity_and_no_heading():
    _, out = run(resting(ATTITUDES[3], has_mag=False), 5.0, 0.02)
    assert not out.has_heading
    assert out.sigma_heading_rad == float("inf")
    assert vector_errors_rad(out, ATTITUDES[3])[0] < 1e-6


def test_a_gap_of_minutes_leaves_finite_values():
    memory, _ = run(resting(ATTITUDES[0]), 10.0, 0.02)
    memory, _ = run(resting(ATTITUDES[1], gyr=(0.1, 0.2, 0.3)), 120.0, 120.0, memory)
    _, out = run(resting(ATTITUDES[1]), 20.0, 0.02, memory)
    assert max(vector_errors_rad(out, ATTITUDES[1])) < radians(0.04)  # measured 0.033


def test_turning_vehicle_keeps_its_vectors():
    """A steady turn about down, from the first sample: no rest to learn from."""

    def turning(q):
        for _ in range(4000):
            gyr = rotate_inverse(q, (0.0, 0.0, 0.5))
            q = turned(q, gyr, 0.01)
            yield resting(q, gyr=gyr)

    *_, (s, out, memory) = conditioned(turning(ATTITUDES[3]), 0.01)
    assert max(vector_errors_rad(out, s.q_ned_frd)) < 1e-7  # measured 3e-8
    assert not memory.known.vertical.rest.resting


def test_samples_between_learning_steps_are_gathered_and_change_nothing_that_is_known():
    """At 1 kHz means over 18.5 ms are learnt from: those of nineteen samples each."""
    memories = [now for _, _, now in conditioned(fly(tumbling, 0.1, 0.001), 0.001)]
    learns = [now.known != before.known for before, now in itertools.pairwise(memories)]
    assert learns == [k % 19 == 0 for k in range(1, len(memories))]
    gathered_ms = [round(1e3 * now.gathered.time_s) for now in memories]
    assert gathered_ms == [k % 19 for k in range(len(memories))]
    for before, now in itertools.pairwise(memories):
        assert now.gathered.q_g_frd != before.gathered.q_g_frd
