"""Circles flown without noise, as simulators fly them, and sensors that are stuck in the middle."""

from math import atan2, cos, sin

import numpy as np
import pytest

from drivers.samples.sensor_faults import Readings, SensorFaults
from estimator.geometry.frames import from_euler_rad
from estimator.geometry.quaternion import rotate_inverse
from estimator.reasons import Reason
from estimator.types import ZERO_VEC3 as NO_FIELD
from tests.drivers.mavlink.messages import G, S

RATE_HZ, SPEED_M_S = 50.0, 22.0
FIELD_NED_GAUSS = (0.22, 0.05, -0.5)  # the southern hemisphere's
WEAVE_S, CIRCLE_S = 4.0, 20.0


def truncated(vector, unit):
    """MAVLink's integers: mrad/s, mg, mGauss."""
    return tuple(int(x / unit) * unit for x in vector)


def circle(turn_rad_s, iron_gauss=NO_FIELD, *, has_field=True, noise=0.0):
    """Weaving, then a turn with tan(bank) = v w / g; the field is 0.09 s late in steps of 0.1 s."""
    rng = np.random.default_rng(1)
    bank, field = atan2(SPEED_M_S * turn_rad_s, G), []
    for k in range(round((WEAVE_S + CIRCLE_S) * RATE_HZ)):
        time_s = k / RATE_HZ
        weave = max(0.0, 1.0 - time_s / WEAVE_S)
        roll = bank * (1.0 - weave) + 0.1 * weave * sin(7.0 * time_s)
        shake = 0.02 * weave * sin(11.0 * time_s)
        gyr = (shake, turn_rad_s * sin(roll), turn_rad_s * cos(roll))
        force = (shake, 0.0, -G * cos(roll) - SPEED_M_S * turn_rad_s * sin(roll))
        gyr, force = (tuple(np.array(v) + noise * rng.standard_normal(3)) for v in (gyr, force))
        if k % 5 == 0:
            late = from_euler_rad(roll, 0.0, turn_rad_s * (time_s - 0.09))
            field = np.array(rotate_inverse(late, FIELD_NED_GAUSS)) + iron_gauss
        mag = truncated(field, 1e-3) if has_field else NO_FIELD
        yield Readings(round(time_s * S), truncated(gyr, 1e-3), truncated(force, 1e-3 * G), mag)


def refusals(flight, change=lambda _, readings: readings):
    """(seconds, reason) of each refused reading; not of those held back until it is known."""
    faults = SensorFaults()
    found = [(r.raw_us / S, faults.refusal(change(r.raw_us / S, r))) for r in flight]
    return [(time_s, reason) for time_s, reason in found if reason not in (None, Reason.REPEATED)]


@pytest.mark.parametrize("turn_rad_s", [0.08, 0.3, 0.7, 1.5])
@pytest.mark.parametrize("iron", [NO_FIELD, (0.04, -0.03, 0.03)])
def test_a_steady_circle_is_no_stuck_sensor(turn_rad_s, iron):
    assert refusals(circle(turn_rad_s, iron_gauss=iron)) == []


@pytest.mark.parametrize("turn_rad_s", [0.3, -0.7])
def test_nor_without_a_field_for_a_while(turn_rad_s):
    found = refusals(circle(turn_rad_s, has_field=False))
    assert all(time_s >= WEAVE_S + 2.9 for time_s, _ in found)


def frozen(since_s, *fields):
    """From ``since_s`` on, the reading then goes on for ever in ``fields``."""
    kept = []

    def change(time_s, readings):
        if time_s < since_s:
            return readings
        kept.append(readings)
        return readings._replace(**{name: getattr(kept[0], name) for name in fields})

    return change


@pytest.mark.parametrize(
    ("fields", "has_field", "reason", "within_s"),
    [
        (("gyr_rad_s", "acc_m_s2"), True, "stuck", 1.5),
        (("gyr_rad_s", "acc_m_s2", "mag_gauss"), True, "stuck", 1.5),
        (("gyr_rad_s", "acc_m_s2"), False, "stuck", 3.1),
        (("gyr_rad_s",), True, "gyroscope_stuck", 1.5),
    ],
)
def test_a_sensor_that_freezes_in_a_circle_is_found_when_the_vehicle_leaves_it(
    fields, has_field, reason, within_s
):
    there = list(circle(0.6, noise=0.003, has_field=has_field))
    back = list(circle(-0.6, noise=0.003, has_field=has_field))
    leave = round(12.2 * RATE_HZ)
    found = refusals(there[:leave] + back[leave:], frozen(12.0, *fields))
    assert found
    assert {each for _, each in found} == {reason}
    assert found[0][0] < 12.0 + within_s
