"""What programs import: arrays in, attitudes out, the same estimates as those of the service."""

import msgspec
import numpy as np
import pytest

import fuzzbee
from drivers.logs.open import open_log
from estimator.profile import merge_profile
from estimator.types import ImuSample
from fuzzbee import Estimator, load_profile
from fuzzbee.replays.trace import Replay
from tests.fuzzbee.recording import FLIPS
from tests.programs import run_python

LEVEL = ((0.0, 0.0, 0.0), (0.0, 0.0, -9.8), (0.2, 0.0, 0.4))


def turning_level(n, rate_hz, rate_rad_s=0.5):
    """A level vehicle that turns right from north: readings (n, 3) without any noise."""
    yaw = rate_rad_s * np.arange(n) / rate_hz
    gyr = np.tile((0.0, 0.0, rate_rad_s), (n, 1))
    acc = np.tile((0.0, 0.0, -9.8), (n, 1))
    mag = np.stack([0.2 * np.cos(yaw), -0.2 * np.sin(yaw), np.full(n, 0.4)], axis=1)
    return gyr, acc, mag, np.degrees(yaw) % 360.0


def test_every_name_is_there_and_no_other():
    assert all(getattr(fuzzbee, name) is not None for name in fuzzbee.__all__)
    with pytest.raises(AttributeError, match="nonsense"):
        _ = fuzzbee.nonsense


def test_the_function_replay_is_not_hidden_by_the_command():
    code = "import fuzzbee.app; from fuzzbee import replay; assert callable(replay)"
    run_python("-c", code, timeout_s=900)


def test_a_turn_to_the_right_is_a_growing_heading():
    gyr, acc, mag, yaw_deg = turning_level(500, 100.0)
    attitudes = Estimator(rate_hz=100.0).update_batch(gyr, acc, mag)
    roll, pitch, heading = attitudes.euler_deg.T
    assert np.abs(roll).max() < 1e-3
    assert np.abs(pitch).max() < 1e-3
    # The field's lag is not known yet: half a degree is 17 ms at this rate
    assert np.abs((heading - yaw_deg + 180.0) % 360.0 - 180.0).max() < 0.5
    assert attitudes.time_s == pytest.approx(np.arange(500) / 100.0)
    # to the right is clockwise: seen from above in ENU it is a falling angle, from 90 deg on
    w, x, y, z = attitudes.q_enu_flu.T
    angle_deg = np.degrees(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
    expected = (90.0 - heading + 180.0) % 360.0 - 180.0
    assert angle_deg == pytest.approx(expected, abs=1e-6)


def test_it_estimates_as_the_service_does():
    """Without what arrays do not carry: velocity, rates of ATTITUDE, declination, the vehicle."""
    profile = load_profile("imu")
    profile = msgspec.structs.replace(
        profile,
        aiding={**profile.aiding, "enabled": False},
        conditioning={**profile.conditioning, "in_vehicle": True},
        reference=msgspec.structs.replace(profile.reference, declination_deg=0.0),
        rates="imu",
    )
    service = Replay(profile)
    with open_log(FLIPS) as log:
        service.run(log)
    (trace,) = service.traces.values()
    gyr, acc, mag = (trace[name] for name in ImuSample._fields[1:4])
    mine = Estimator(profile).update_batch(gyr, acc, mag, 1e-6 * trace["time_us"])
    assert len(mine) > 500
    assert np.array_equal(mine.q_ned_frd, trace["q_ned_frd"])


def test_before_the_first_sample_that_can_be_used_there_is_no_attitude():
    gyr, acc, mag, _ = turning_level(4, 100.0)
    acc[0] = np.nan
    estimator = Estimator(rate_hz=100.0)
    attitudes = estimator.update_batch(gyr, acc, mag)
    for values in (attitudes.q_ned_frd, attitudes.euler_deg, attitudes.q_enu_flu):
        assert np.isnan(values[0]).all()
        assert np.isfinite(values[1:]).all()
    assert estimator.rejected == {"not_finite": 1}
    assert Estimator().update((np.nan,) * 3, LEVEL[1], time_s=0.0) is None
    estimator.reset()
    estimator.update_velocity((0.0, 0.0, 0.0))  # of no sample yet: nothing to report
    assert [estimator.update(*LEVEL).time_us for _ in range(3)] == [0, 10_000, 20_000]
    assert not estimator.rejected
    stays = estimator.update(*LEVEL, time_s=0.0)
    assert stays.q_ned_frd == pytest.approx((1.0, 0.0, 0.0, 0.0))
    assert estimator.rejected == {"not_later": 1}


def test_the_mounting_of_a_profile_is_used():
    """An IMU that is turned right by 90 deg: its x axis is the body's y axis."""
    mounting = {"mounting": {"rotation_deg": (0.0, 0.0, 90.0)}}
    turned = Estimator(merge_profile(load_profile("imu"), mounting), rate_hz=100.0)
    gyr, acc, mag, _ = turning_level(50, 100.0)
    seen = [np.stack([v[:, 1], -v[:, 0], v[:, 2]], axis=1) for v in (gyr, acc, mag)]
    straight = Estimator(rate_hz=100.0).update_batch(gyr, acc, mag)
    # to rounding: the quaternions are of order 1
    assert turned.update_batch(*seen).q_ned_frd == pytest.approx(straight.q_ned_frd, abs=1e-12)
