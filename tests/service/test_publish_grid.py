"""Attitudes leave with the samples that they wait for, and as often as the rate says."""

import numpy as np
import pytest

from drivers.events import Imu
from estimator.profile import load_profile
from estimator.types import ImuSample
from service.pipeline import Pipeline
from service.records import AttitudeRecord, Published
from tests.service.streams import ONE, START_US

MINUTES = 10
RATE_HZ = 50.0
LEVEL = ((0.0, 0.0, 0.0), (0.0, 0.0, -9.81), (0.2, 0.0, 0.4))


def arrivals_us(sample_hz, seed):
    """Arrivals of a stream, up to 6 ms late and never in another order."""
    rng = np.random.default_rng(seed)
    times_us = np.arange(MINUTES * 60 * sample_hz) * 1e6 / sample_hz
    return np.maximum.accumulate(times_us + rng.uniform(0.0, 6_000.0, len(times_us))).astype(int)


def published(sample_hz, seed):
    """(host time, record, newest sample's arrival) of each attitude; the host wakes when due."""
    pipeline = Pipeline(load_profile("paper"), rate_hz=RATE_HZ)
    found = []

    def note(outputs, now_us, newest_us):
        records = [each.record for each in outputs if isinstance(each, Published)]
        attitudes = [record for record in records if isinstance(record, AttitudeRecord)]
        found.extend((now_us, record, newest_us) for record in attitudes)

    newest_us = START_US
    pipeline.tick(START_US)
    for k, arrival_us in enumerate(arrivals_us(sample_hz, seed).tolist()):
        now_us = START_US + arrival_us
        while k and pipeline.wake_us < now_us:
            woken_us = int(pipeline.wake_us) + 1
            note(pipeline.tick(woken_us), woken_us, newest_us)
        sample = ImuSample(round(1e6 * k / sample_hz) + 1, *LEVEL, True)
        event = Imu(ONE, now_us, sample.time_us, "RAW_IMU", sample)
        note(pipeline.handle(event, now_us), now_us, now_us)
        newest_us = now_us
    return found


@pytest.mark.parametrize("sample_hz", [49.98, 50.0, 50.02, 100.0, 33.0, 10.0])
def test_as_many_leave_as_the_rate_says_and_none_waits_for_the_grid(sample_hz):
    found = published(sample_hz, seed=3)
    assert [record.sequence for _, record, _ in found] == list(range(len(found)))
    found = [each for each in found if each[0] > START_US + 5_000_000]  # its rate is known then
    times_us = np.array([now_us for now_us, _, _ in found])
    passed_s = 1e-6 * (times_us[-1] - times_us[0])
    assert len(found) - 1 == pytest.approx(RATE_HZ * passed_s, abs=1.6)
    assert np.diff(times_us).max() < 3.0e6 / RATE_HZ
    if sample_hz >= RATE_HZ - 0.1:
        with_its_sample = [now_us == newest_us for now_us, _, newest_us in found]
        assert np.mean(with_its_sample) > 0.98
