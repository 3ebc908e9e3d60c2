"""The heading of a car with a poor IMU by its velocity, whatever its compass shows."""

from math import cos, degrees, hypot, radians, sin

import numpy as np
import pytest

from estimator.aiding.beginning import blank_aiding
from estimator.aiding.course import STANDING, forward_evidence, roll_on, tilt_error_rad
from estimator.aiding.phase import Phase
from estimator.aiding.types import AidingParams, Report, Wheels
from estimator.geometry.frames import from_euler_rad
from estimator.geometry.metrics import angle_errors, rms
from estimator.geometry.quaternion import rotate, rotate_inverse
from estimator.live.aiding_span import Start, begin_aiding
from estimator.live.core import initial_core, without_aiding
from estimator.profile import load_profile, merge_profile
from estimator.types import STANDARD_GRAVITY_M_S2, ImuSample, VehicleClass, VelocitySample
from tests.flight import ZURICH, calibrated

WHEELS = AidingParams(sideslip_rad=0.05)
BLANK, _, _ = blank_aiding(WHEELS)
FIELD_NED = np.array((0.22, 0.0, 0.42))
WHEELED = {"aiding": {"sideslip_rad": 0.05}}
# of gyroscope and accelerometer
BIASES = (np.radians((2.5, -2.0, 2.4)), np.array((0.1, -0.1, 0.05)))


def ride(seed, *, seconds=60.0, reverse=False, compass_off_deg=50.0, strength=1.0, rest_s=0.0):
    """Sample, velocity or None, and true attitude, 50 times a second, behind a rest or at once."""
    rng = np.random.default_rng(seed)
    turn_field = from_euler_rad(0.0, 0.0, radians(compass_off_deg))
    sense = -1.0 if reverse else 1.0
    speed, yaw, wanted, curve = 8.0, float(rng.uniform(-3.0, 3.0)), 8.0, 0.0
    if rest_s > 0.0:
        speed, wanted = 0.0, 0.0
    dt = 0.02
    for k in range(round(seconds / dt)):
        if k % 200 == 0 and k * dt >= rest_s:
            wanted, curve = float(rng.uniform(6.0, 14.0)), float(rng.uniform(-0.03, 0.03))
        push = float(np.clip(wanted - speed, -1.0, 1.0)) * 2.0
        rate = curve * min(speed, 9.0)
        q = from_euler_rad(0.0, 0.0, yaw)
        force = (sense * push, sense * speed * rate, -STANDARD_GRAVITY_M_S2)
        gyr = np.array((0.0, 0.0, rate)) + BIASES[0] + 0.005 * rng.standard_normal(3)
        acc = np.array(force) + BIASES[1] + 0.2 * rng.standard_normal(3)
        mag = rotate(turn_field, rotate_inverse(q, tuple(strength * FIELD_NED)))
        sample = ImuSample(round(1e6 * k * dt), tuple(gyr), tuple(acc), mag, True)
        velocity = None
        if k % 5 == 0:
            output = sense * speed * np.array((cos(yaw), sin(yaw), 0.0))
            output = tuple((output + 0.05 * rng.standard_normal(3)).tolist())
            velocity = VelocitySample(sample.time_us, output, True, 0.3)
        yield sample, velocity, q
        speed, yaw = speed + push * dt, yaw + rate * dt


def driven(estimator, rows):
    """Errors (N, 3) in degrees, sigmas of the heading, and when velocity began to help, in s."""
    errors, sigmas, begun_s = [], [], None
    for sample, velocity, truth in rows:
        if velocity is not None:
            assert estimator.update_report(velocity) is None
        assert estimator.update(sample) is None
        output = estimator.attitude(sample.time_us)
        errors.append(np.degrees(angle_errors(output.q_ned_frd, truth)))
        sigmas.append(degrees(output.sigma_heading_rad))
        if begun_s is None and estimator.snapshot.context.phase is Phase.AIDED:
            begun_s = 1e-6 * sample.time_us
    return np.array(errors), np.array(sigmas), begun_s


def car_near_zurich():
    estimator = calibrated(load_profile("imu"))
    estimator.set_vehicle_class(VehicleClass.WHEELS)
    estimator.set_position(*ZURICH)
    return estimator


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_car_shows_its_heading_by_its_velocity(seed, reverse):
    estimator = calibrated(merge_profile(load_profile("imu"), WHEELED))
    errors, sigmas, begun_s = driven(estimator, ride(seed, reverse=reverse))
    late = errors[1500:]
    assert begun_s < 14.0  # measured 3.3 to 11.1
    assert max(rms(late[:, 1]), rms(late[:, 2])) < 2.0
    assert np.mean(late[:, 1] < 3.0 * sigmas[1500:]) > 0.95


def test_a_place_that_is_known_does_not_make_the_compass_right():
    """The aiding begins by the field at once, and wheels show that iron has turned it."""
    estimator = car_near_zurich()
    errors, _, _ = driven(estimator, ride(3))
    assert rms(errors[1500:, 1]) < 6.0


@pytest.mark.parametrize("off_deg", [-120.0, 0.0])
def test_a_compass_that_gave_the_heading_at_rest_is_confirmed_or_misled(off_deg):
    """The first metres decide; a compass that is right keeps its north."""
    estimator = car_near_zurich()
    north = estimator.place_field.declination_rad
    rows = ride(3, compass_off_deg=off_deg + degrees(north), rest_s=20.0, seconds=80.0)
    errors, _, begun_s = driven(estimator, rows)
    now = estimator.snapshot
    assert begun_s < 20.0
    assert now.context.phase is Phase.AIDED
    assert (now.context.compass.misled_us is None) == (off_deg == 0.0)
    assert now.core.aided.wheels.show_north == (off_deg == 0.0)
    assert rms(errors[2500:, 1]) < 1.0  # measured 0.2


@pytest.mark.parametrize("seed", [3, 4])
def test_iron_all_around_is_not_learnt_as_iron_of_its_own(seed):
    """The field is turned and weak. Wheels turn the heading by 45 deg, and nothing else."""
    estimator = car_near_zurich()
    rows = ride(seed, compass_off_deg=-45.0, strength=0.7, rest_s=20.0, seconds=60.0)
    errors, _, begun_s = driven(estimator, rows)
    estimate = estimator.snapshot.core.aided.estimate
    assert begun_s < 20.0
    assert np.linalg.norm(estimate.hard_iron_gauss) < 0.01  # measured 0.003
    assert rms(errors[2000:, 1]) < 2.5  # measured 1.2, 2.1


def test_without_a_class_there_are_no_wheels_and_the_profile_goes_first():
    estimator, own = calibrated(load_profile("imu")), {"aiding": {"sideslip_rad": 0.4}}
    for change, sideslip_rad in (
        (lambda: None, 3.0),
        (lambda: estimator.set_vehicle_class(VehicleClass.WHEELS), radians(3.0)),
        (estimator.restart, radians(3.0)),
        (lambda: estimator.replace_profile(merge_profile(load_profile("imu"), own)), 0.4),
    ):
        change()
        assert estimator.settings.aiding.sideslip_rad == pytest.approx(sideslip_rad)


def reported(velocity_ned_m_s):
    return Report(True, velocity_ned_m_s, True, 0.3)


def rolled(rng, *, sense, windows=8, tilt=(0.0, 0.0), noise_m_s2=0.1):
    """Windows of a second at speeds near 10 m/s, seen by a tilted vertical."""
    found, before = STANDING, np.array((10.0, 0.0))
    for _ in range(windows):
        change = rng.standard_normal(2)
        after = before + change
        course = after / np.hypot(*after)
        felt = sense * np.array((course @ change, course[0] * change[1] - course[1] * change[0]))
        felt = felt + STANDARD_GRAVITY_M_S2 * np.array(tilt) + noise_m_s2 * rng.standard_normal(2)
        v, w = (*before, 0.0), (*after, 0.0)
        found = roll_on(found, v, reported(w), 1.0, (*felt, -9.8), (0.0, 0.0, 1.0))
        before = after
    return found


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.2, -0.1)])
def test_pushes_distinguish_forwards_from_reverse_whatever_the_tilt(sense, tilt):
    found = rolled(np.random.default_rng(1), sense=sense, tilt=tilt)
    assert sense * forward_evidence(found) > 30.0
    assert tilt_error_rad(found, sense) == pytest.approx(hypot(*tilt), abs=0.01)


def test_a_vertical_that_follows_an_even_push_shows_no_sense():
    """The push seems to fade while the reports show that it grows: less than their noise."""
    found = STANDING
    for k, speed in enumerate((5.0, 5.6, 6.22, 6.86, 7.52, 8.2)):
        felt, after = (0.7 - 0.03 * k, 0.0, -9.8), reported((speed + 0.6 + 0.02 * k, 0.0, 0.0))
        found = roll_on(found, (speed, 0.0, 0.0), after, 1.0, felt, (0.0, 0.0, 1.0))
    assert abs(forward_evidence(found)) < 4.0


def test_what_stands_may_go_on_either_way():
    found = rolled(np.random.default_rng(3), sense=1.0)
    down = (0.0, 0.0, 1.0)
    stopped = roll_on(found, (1.0, 0.0, 0.0), reported((0.5, 0.0, 0.0)), 1.0, (-0.5, 0, -9.8), down)
    assert stopped is STANDING
    again = roll_on(stopped, (0.5, 0.0, 0.0), reported((2.5, 0.0, 0.0)), 1.0, (2.0, 0, -9.8), down)
    assert again.windows == 1.0
    assert forward_evidence(again) == 0.0


def test_what_wheels_have_shown_outlasts_a_gap_unless_they_contradict_the_compass():
    settings = calibrated(load_profile("imu")).settings
    core = initial_core(settings)
    shown = Wheels()._replace(rolled_s=4.0, show_north=True)
    for wheels, left in ((shown, shown), (shown._replace(contradict=True), Wheels())):
        paused = without_aiding(settings, core._replace(aided=core.aided._replace(wheels=wheels)))
        assert paused.aided.wheels == left
        report = Report(True, (3.0, 0.0, 0.0), True, 0.3, 0.0, 0.0)
        again = begin_aiding(settings, paused, Start((1.0, 0.0, 0.0, 0.0), 0.1), report, 0.02)
        assert again.aided.wheels == left
