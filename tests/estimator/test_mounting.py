"""An IMU mounted otherwise, from the profile's section to the attitude."""

from math import radians

import numpy as np
import pytest

from drivers.events import Imu, Notice, VehicleId
from drivers.simulation.simulated_vehicle import simulate
from estimator.calibration import Mounting
from estimator.geometry.frames import from_euler_rad
from estimator.geometry.metrics import angle_errors
from estimator.geometry.quaternion import conjugate, rotate, scale
from estimator.profile import load_profile, merge_profile, parse_profile, profile_to_toml
from estimator.types import ImuSample
from fuzzbee.replays.trace import Replay
from fuzzbee.tune.read_flight import read_flight
from service.pipeline import Pipeline
from service.records import Message
from tests.drivers.mavlink import messages
from tests.fuzzbee.recording import SLOW
from tests.paper_noise import samples_of

ONE = VehicleId(1, 1)
ODD = {"rotation_deg": [35.0, -120.0, 77.0], "acc_sign": -1}
CALIBRATION = {
    "gyr_bias_rad_s": [0.01, 0.02, -0.03],
    "gyr_matrix": [[1.01, 0.003, 0.0], [0.0, 0.99, 0.001], [0.002, 0.0, 1.0]],
    "acc_bias_m_s2": [0.1, -0.2, 0.3],
    "acc_matrix": [[0.99, 0.0, 0.01], [0.0, 1.02, 0.0], [0.004, 0.0, 1.0]],
    "mag_offset_gauss": [0.06, -0.04, 0.05],
    "mag_matrix": [[1.05, 0.03, 0.0], [0.03, 0.97, -0.02], [0.0, -0.02, 1.0]],
}
CASES = [{}, {"acc_sign": -1}, {"rotation_deg": [180, 0, 0]}, {"rotation_deg": [0, 0, -90]}, ODD]


def profile(calibration=(), **mounting):
    sections = {"mounting": mounting, "calibration": dict(calibration)}
    return merge_profile(load_profile("imu"), sections)


def flight(mounting, seconds=6.0):
    """(event, truth) of the paper's motion without noise, as a sensor so mounted sends it."""
    made = simulate(1, round(50 * seconds), 50.0, noise=0.0, bias=0.0)
    back = conjugate(mounting.q_frd_sensor)
    for k, (body, truth) in enumerate(zip(samples_of(made), made.q_ned_frd.tolist(), strict=True)):
        gyr, acc, mag = (rotate(back, vector) for vector in body[1:4])
        sensed = ImuSample(body.time_us, gyr, scale(mounting.acc_sign, acc), mag, True)
        yield Imu(ONE, 20_000 * k, body.time_us, "RAW_IMU", sensed), tuple(truth)


def test_the_plain_mounting_leaves_samples_as_they_are():
    sample = ImuSample(1, (0.1, 0.2, 0.3), (1.0, 2.0, -9.0), (0.2, 0.0, 0.4), True)
    assert profile().has_plain_imu
    assert profile().to_body_axes(sample) is sample


def test_rotations_are_roll_then_pitch_then_yaw():
    """An IMU yawed right by 90 deg: its forward is the body's right."""
    sample = ImuSample(1, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), True)
    turned = profile(rotation_deg=(0.0, 0.0, 90.0)).to_body_axes(sample)
    assert turned.gyr_rad_s == pytest.approx((0.0, 1.0, 0.0))
    assert turned.acc_m_s2 == pytest.approx((-1.0, 0.0, 0.0))
    assert turned.mag_gauss == pytest.approx((0.0, 0.0, 1.0))
    angles = (10.0, 20.0, 30.0)
    assert Mounting(angles).q_frd_sensor == from_euler_rad(*map(radians, angles))


def errors_rad(events_and_truth, chosen):
    """The last total error of a replay with that profile, and the samples it kept."""
    replay = Replay(chosen)
    pairs = list(events_and_truth)
    replay.run([event for event, _ in pairs])
    trace = replay.traces[ONE]
    return angle_errors(tuple(trace["q_ned_frd"][-1].tolist()), pairs[-1][1]), trace


@pytest.mark.parametrize("mounting", CASES)
def test_a_mounted_imu_gives_the_attitude_of_one_that_sits_right(mounting):
    chosen = merge_profile(load_profile("paper"), {"mounting": mounting})
    errors, trace = errors_rad(flight(chosen.mounting), chosen)
    right, same = errors_rad(flight(Mounting()), load_profile("paper"))
    assert max(errors) < radians(1.0)
    assert errors == pytest.approx(right, abs=1e-6)
    for axis in range(3):  # what viewers and ROS are given is the body's, too
        assert trace["acc_m_s2"][-1, axis] == pytest.approx(same["acc_m_s2"][-1, axis])


def test_it_survives_being_written():
    chosen = profile(CALIBRATION, **ODD)
    read = parse_profile(profile_to_toml(chosen), "p.toml")
    assert (read.mounting, read.calibration) == (chosen.mounting, chosen.calibration)


def test_another_mounting_in_flight_aligns_anew():
    pipeline = Pipeline(load_profile("imu"))
    pairs = list(flight(Mounting(acc_sign=-1), 4.0))
    for event, _ in pairs[:100]:
        pipeline.handle(event)
    pipeline.replace_profile(ONE, {"mounting": {"acc_sign": -1}})
    pipeline.handle(pairs[100][0])
    q = pipeline.vehicle(ONE).estimator.attitude(pairs[100][0].sample.time_us).q_ned_frd
    assert angle_errors(q, pairs[100][1])[2] < radians(1.0)


def notices(chosen):
    """What the service reports of a level IMU that gives gravity: z = +1025 mg."""
    pipeline, texts = Pipeline(chosen), []
    rates = ((k, (0, 0, 300 * (k % 40 < 20))) for k in range(1, 600))
    imu = (messages.raw_imu(20_000 * k, (5, 3, 1025), gyr) for k, gyr in rates)
    events = messages.decode_all([messages.heartbeat(messages.GENERIC, 10), *imu])
    for event in events:
        texts += [x.text for x in pipeline.handle(event) if isinstance(x, Message)]
    assert {event.section for event in messages.only(Notice, events)} == {"mounting"}
    return [text for text in texts if "z is positive" in text]


def test_the_notice_names_the_lines_and_is_not_sent_where_they_are_written():
    (text,) = notices(load_profile("imu"))
    assert "[mounting] acc_sign = -1" in text
    assert "rotation_deg = [180, 0, 0]" in text
    assert notices(profile(acc_sign=-1)) == []


def test_tuning_reads_logs_as_they_are_mounted():
    mountings = profile(), profile(rotation_deg=[180.0, 0.0, 0.0])
    plain, mounted = (read_flight(SLOW, each).rows for each in mountings)
    for name in ("gyr_rad_s", "acc_m_s2", "mag_gauss"):
        assert getattr(mounted, name) == pytest.approx(getattr(plain, name) * (1.0, -1.0, -1.0))


@pytest.mark.parametrize("calibration", [{}, CALIBRATION])
@pytest.mark.parametrize("section", CASES)
def test_rows_are_turned_and_calibrated_as_samples_are(section, calibration):
    chosen = profile(calibration, **section)
    rng = np.random.default_rng(2)
    gyr, acc, mag = (rng.normal(size=(5, 3)) for _ in range(3))
    mag[3] = 0.0  # no compass stays none
    rows = chosen.to_body_rows(gyr, acc, mag)
    for k in range(5):
        sample = ImuSample(k, *(tuple(column[k].tolist()) for column in (gyr, acc, mag)), True)
        for column, vector in zip(rows, chosen.to_body_axes(sample)[1:4], strict=True):
            assert column[k] == pytest.approx(vector)
    assert not rows[2][3].any()


def test_a_calibration_is_undone_before_the_mounting():
    """M (v - b) of the sensor's readings."""
    sensed = {"gyr_bias_rad_s": (0.1, 0.2, 0.3), "acc_bias_m_s2": (1.0, 2.0, -9.0)}
    sensed["mag_offset_gauss"] = (0.2, 0.0, 0.4)
    undone = (
        np.array(CALIBRATION[f"{name[:3]}_matrix"]) @ np.subtract(reading, CALIBRATION[name])
        for name, reading in sensed.items()
    )
    right = profile(**ODD).to_body_axes(ImuSample(1, *map(tuple, undone), True))
    found = profile(CALIBRATION, **ODD).to_body_axes(ImuSample(1, *sensed.values(), True))
    assert np.array(found[1:4]) == pytest.approx(np.array(right[1:4]))
