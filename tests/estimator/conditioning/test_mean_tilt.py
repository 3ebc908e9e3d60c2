"""What a slow gyroscope cannot see: a vehicle that is shaken stays where it usually is."""

from math import pi, radians

import numpy as np

from estimator.conditioning.condition import condition
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.state import initial_state
from estimator.geometry.frames import from_euler_rad
from estimator.geometry.metrics import rms
from estimator.geometry.quaternion import angle_between_vectors, rotate_inverse
from estimator.types import STANDARD_GRAVITY_M_S2, Sample

DOWN, NO_FIELD, DT = (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 0.6
PARAMS = ConditioningParams(in_vehicle=True)


def errors_deg(tilt_error_rad, shaken_m_s2, seed=1):
    """Errors of down and of the force's direction, and sigma, (N, 3), from 20 s on.

    After 10 s of rest the gyroscope shows any rate at all.
    """
    rng, state, rows = np.random.default_rng(seed), initial_state(PARAMS), []
    for k in range(200):
        t, moves = DT * k, DT * k > 10.0
        wobble = radians(4.0) * rng.standard_normal(2) * moves
        q = from_euler_rad(tilt_error_rad(t) + wobble[0], wobble[1], 0.3)
        gyr = tuple((3.0 * moves * rng.standard_normal(3)).tolist())
        force = np.array(rotate_inverse(q, (0.0, 0.0, -STANDARD_GRAVITY_M_S2)))
        force += (shaken_m_s2 * moves + 0.02) * rng.standard_normal(3)
        state, out = condition(
            PARAMS, state, Sample(gyr, tuple(force.tolist()), NO_FIELD, False, DT)
        )
        down = rotate_inverse(q, DOWN)
        felt = tuple((-force).tolist())
        off = (angle_between_vectors(out.gravity_b, down), angle_between_vectors(felt, down))
        rows.append((*off, out.sigma_inclination_rad))
    return np.degrees(rows)[round(20.0 / DT) :]


def test_a_shaken_vehicle_is_held_at_its_usual_tilt():
    errors = errors_deg(lambda _t: radians(10.0), 6.0)
    assert rms(errors[:, 0]) < 19.0
    assert np.mean(errors[:, 0] < errors[:, 2]) > 0.8


def test_the_vertical_of_a_vehicle_that_tilts_follows_its_force():
    """Up to 69 deg in 10 s."""
    errors = errors_deg(lambda t: 1.2 * np.sin(2.0 * pi * t / 40.0) * (t > 10.0), 0.3)
    assert rms(errors[:, 0]) < 3.2
    assert np.mean(errors[:, 0] < errors[:, 2]) > 0.8
