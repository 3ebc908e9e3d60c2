"""The attitude that a whole recording shows, beside the one that was known at the time."""

import numpy as np
import pytest

from estimator.geometry.metrics import batch_angle_errors
from estimator.geometry.rotations import chained, conjugate, exp, rotate
from estimator.live import rows
from estimator.live.rows import BIAS, OUTPUT_SIZE, RATE, SIGMA, Q, cut, rows_of
from estimator.profile import load_profile, merge_profile
from estimator.smoothing import Offered, Recorder, smooth_all
from fuzzbee import Estimator, replay
from tests.fuzzbee.recording import PLANE, SLOW, G

RATE_HZ, SECONDS = 50.0, 120


@pytest.fixture(scope="module")
def shaken():
    """Readings of a body that is turned and shaken, with a biased gyroscope, and the truth."""
    rng = np.random.default_rng(2)
    t = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    tones, phases = rng.uniform(0.5, 2.5, (2, 3, 3, 1)), rng.uniform(0.0, 6.0, (2, 3, 3, 1))
    rate, push = np.sin(tones * t + phases).sum(axis=2).transpose(0, 2, 1)
    before = np.concatenate([rate[:1], rate[:-1]])
    q = chained(exp(0.5 * (before + rate) / RATE_HZ))
    force = rotate(conjugate(q), push + np.array([0.0, 0.0, -G]))
    field = rotate(conjugate(q), np.tile([0.2, 0.0, 0.4], (len(t), 1)))
    gyr = rate + np.array([0.004, -0.006, 0.005]) + rng.normal(0.0, 0.003, rate.shape)
    acc = force + rng.normal(0.0, 0.05, rate.shape)
    return gyr, acc, field + rng.normal(0.0, 0.003, rate.shape), q


def errors_deg(attitudes, q):
    """Heading and inclination (N, 2)."""
    pair = np.ascontiguousarray(attitudes.q_ned_frd), np.ascontiguousarray(q)
    return np.degrees(batch_angle_errors(*pair))[:, 1:]


def rms(values):
    return np.sqrt(np.mean(np.square(values), axis=0))


def calibrated(rate_hz):
    return Estimator(rate_hz=rate_hz, compass_calibrated=True)


def test_what_came_later_counts_too(shaken):
    *readings, q = shaken
    estimator = Estimator(rate_hz=RATE_HZ)
    smoothed = estimator.smooth(*readings)
    errors = errors_deg(smoothed, q)
    before = rms(errors_deg(estimator.update_batch(*readings), q)[500:])  # as if not smoothed
    assert rms(errors) == pytest.approx([0.507, 0.465], rel=0.2)
    assert (rms(errors[500:]) < 0.85 * before).all()
    sigma = np.degrees([smoothed.sigma_heading_rad, smoothed.sigma_inclination_rad]).T
    assert (np.mean(errors < sigma, axis=0) > 0.55).all()
    assert (smoothed.heading_reference == "magnetic").all()


def test_means_over_intervals_are_half_an_interval_old(shaken):
    *readings, q = (column.reshape(-1, 2, column.shape[1]) for column in shaken)
    averaged = merge_profile(load_profile("imu"), {"conditioning": {"averaged_samples": True}})
    estimator = Estimator(averaged, RATE_HZ / 2.0)
    smoothed = estimator.smooth(*(column.mean(axis=1) for column in readings))
    # without it 0.95 deg
    assert rms(errors_deg(smoothed, q[:, 1])) == pytest.approx([0.81, 1.15], rel=0.1)


def test_what_is_done_in_blocks_is_what_is_done_at_once(shaken, monkeypatch):
    """Slow streams are joined forward and backward; a reading an hour long takes many blocks."""
    slow = [column[:3000:10] for column in shaken[:3]]
    velocity = np.tile([np.nan, 0.0, 0.0], (len(slow[0]), 1))
    velocity[::5] = 0.0
    whole = calibrated(5.0).smooth(*slow, velocity_ned_m_s=velocity)
    monkeypatch.setattr(rows, "BLOCK", 37)
    parts = calibrated(5.0).smooth(*slow, velocity_ned_m_s=velocity)
    for name in ("q_ned_frd", "sigma_heading_rad", "sigma_inclination_rad"):
        assert np.array_equal(getattr(parts, name), getattr(whole, name))
    causal = calibrated(5.0).update_batch(*slow, velocity_ned_m_s=velocity)
    truth = shaken[3][:3000:10]
    ours, before = (rms(errors_deg(output, truth)[50:]) for output in (whole, causal))
    assert (ours < 0.85 * before).all()  # 1.8 and 2.7 deg for 2.5 and 4.0


def test_holes_refused_rows_and_few_samples_leave_an_attitude_everywhere(shaken):
    gyr, acc, mag, q = (column[:3000].copy() for column in shaken)
    times_s = np.arange(3000) / RATE_HZ
    times_s[1500:] += 3.0
    acc[100:110] = np.nan
    smoothed = Estimator().smooth(gyr, acc, mag, times_s)
    assert np.isfinite(smoothed.q_ned_frd).all()
    before = Estimator().update_batch(gyr, acc, mag, times_s)
    assert (rms(errors_deg(smoothed, q)[600:]) < rms(errors_deg(before, q)[600:])).all()
    assert len(Estimator().smooth(gyr[:3], acc[:3], mag[:3], times_s[:3])) == 3
    with pytest.warns(UserWarning, match="most of the samples could not be used"):
        refused = Estimator().smooth(gyr[:3], acc[:3] * np.nan, mag[:3], times_s[:3])
    assert np.isnan(refused.gain).all()
    assert (Estimator().smooth(gyr, acc, None, times_s).heading_reference == "none").all()


@pytest.mark.parametrize(("log", "wanted"), [(SLOW, (0.487, 0.682)), (PLANE, (0.374, 0.582))])
def test_flights(log, wanted):
    """Aided at 4 Hz: forward and backward joined. Heading and inclination, deg."""
    score = replay(log, skip_s=20.0).report.error_deg
    smoothed = replay(log, skip_s=20.0, smooth=True).report
    found = smoothed.error_deg.heading_rms, smoothed.error_deg.inclination_rms
    assert found == pytest.approx(wanted, rel=0.2)
    assert found[0] < 1.02 * score.heading_rms  # 1.00 and 0.88 of it
    assert found[1] < score.inclination_rms
    assert smoothed.coverage.heading > 0.55
    assert smoothed.coverage.inclination > 0.55


def test_of_rows_given_nothing_is_kept_twice(shaken):
    """An hour at 400 Hz fits in a GiB."""
    gyr, acc, mag = (column[:1500] for column in shaken[:3])
    rows = rows_of(np.arange(1500) * 20_000, gyr, acc, mag, np.ones(1500, np.bool_))
    output = np.full((1500, OUTPUT_SIZE), np.nan)
    first, others = [tuple(column[0].tolist()) for column in (gyr, acc, mag)], cut(rows, 1, 1500)
    recorder = Recorder(load_profile("imu"), offered=Offered(rows, output))
    recorder.take(0, *first, has_mag=True)
    assert recorder.update_rows(others, output[1:]) == (1499, 0)
    (made,) = recorder.recordings()
    assert all(np.shares_memory(*pair) for pair in zip(made.rows, rows, strict=True))
    assert np.shares_memory(made.output, output)
    alone = Recorder(load_profile("imu"))  # of rows that nobody keeps it keeps copies
    alone.take(0, *first, has_mag=True)
    assert alone.update_rows(others, output[1:].copy()) == (1499, 0)
    (own,) = alone.recordings()
    assert all(np.array_equal(*pair) for pair in zip(own.rows, rows, strict=True))
    assert np.array_equal(own.output[1:], made.output[1:], equal_nan=True)
    assert not np.shares_memory(own.output, output)


def test_recorded_sample_by_sample_it_is_the_same(shaken):
    """A log's samples come one by one, and the recorder keeps them itself; some are refused."""
    gyr, acc, mag = (column[:1500].copy() for column in shaken[:3])
    acc[100:110] = np.nan
    whole = Estimator(rate_hz=RATE_HZ).smooth(gyr, acc, mag)
    recorder = Recorder(load_profile("imu"))
    for k, readings in enumerate(zip(gyr.tolist(), acc.tolist(), mag.tolist(), strict=True)):
        recorder.take(20_000 * k, *map(tuple, readings), has_mag=True)
    times_us, smoothed = smooth_all(recorder)
    rows = times_us // 20_000
    assert len(rows) == 1490
    assert np.array_equal(whole.q_ned_frd[rows], smoothed[:, Q])
    assert np.array_equal(whole.rate_rad_s[rows], smoothed[:, RATE])
    assert np.array_equal(whole.gyro_bias_rad_s[rows], smoothed[:, BIAS])
    assert np.array_equal(whole.sigma_heading_rad[rows], smoothed[:, SIGMA][:, 1])


def test_between_holes_a_vehicle_is_joined_and_not_averaged(shaken):
    """Its accelerations last for longer than what lies between two holes of its recording."""
    gyr, acc, mag, q = shaken
    t = np.arange(len(gyr)) / RATE_HZ
    long_pushes = np.stack([1.5 * np.sin(t / 5.0), 1.5 * np.cos(t / 5.0), 0.0 * t], axis=-1)
    acc = acc + rotate(conjugate(q), long_pushes)
    kept = t % 15.0 < 12.5
    readings = (gyr[kept], acc[kept], mag[kept], t[kept])
    vehicle = merge_profile(load_profile("imu"), {"conditioning": {"in_vehicle": True}})
    causal = errors_deg(Estimator(vehicle).update_batch(*readings), q[kept])
    errors = errors_deg(Estimator(vehicle).smooth(*readings), q[kept])
    assert (rms(errors) < 0.92 * rms(causal)).all()  # inclination 9.4 for 10.6 deg; averaged 11.3


def test_what_force_and_field_show_of_their_errors_is_in_sigma(shaken):
    """A force of the wrong size, and a field that has another norm and dip for a minute."""
    gyr, acc, mag, q = shaken
    plain = calibrated(RATE_HZ).smooth(gyr, acc, mag)
    scaled = calibrated(RATE_HZ).smooth(gyr, 1.02 * acc, mag)
    grown = rms(scaled.sigma_inclination_rad) ** 2 - rms(plain.sigma_inclination_rad) ** 2
    assert np.sqrt(grown) == pytest.approx(2**0.5 * 0.02, rel=0.2)
    elsewhere = np.where(np.arange(len(q))[:, None] >= len(q) / 2, [0.0, 0.0, 0.03], 0.0)
    other = calibrated(RATE_HZ).smooth(gyr, acc, mag + rotate(conjugate(q), elsewhere))
    before, then = (rms(each.sigma_heading_rad.reshape(2, -1).T) for each in (plain, other))
    assert then.max() > 1.5 * before.max()
