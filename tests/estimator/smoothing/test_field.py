"""A field that is another one for a while, on the way back through a flight."""

import numpy as np

from estimator.geometry.metrics import batch_angle_errors
from estimator.geometry.rotations import about_down, conjugate, rotate
from estimator.profile import load_profile
from estimator.smoothing import Recorder, smooth_all
from estimator.smoothing.field import usable_fields
from tests.flight import banked_flight, flown

RATE_HZ = 10.0
TURNED_S, TURNED_RAD = (60.0, 100.0), 0.7


def disturbed_flight():
    """A flight whose field is turned to the east for 40 s."""
    flight = banked_flight(seconds=160.0, rate_hz=RATE_HZ, report_hz=5.0, bank_rad=0.1)
    q = np.array(flight.truth)
    time_s = np.arange(len(q)) / RATE_HZ
    is_turned = (time_s >= TURNED_S[0]) & (time_s < TURNED_S[1])
    field = rotate(q, np.array([s.mag_gauss for s in flight.samples]))
    field = rotate(about_down(np.where(is_turned, TURNED_RAD, 0.0)), field)
    mag = rotate(conjugate(q), field).tolist()
    for k, sample in enumerate(flight.samples):
        flight.samples[k] = sample._replace(mag_gauss=tuple(mag[k]))
    return flight, q, is_turned


def heading_deg(attitudes, q):
    """RMS from 20 s on."""
    pair = np.ascontiguousarray(attitudes), np.ascontiguousarray(q)
    errors = np.degrees(batch_angle_errors(*pair))[round(20.0 * RATE_HZ) :, 1]
    return np.sqrt(np.mean(np.square(errors)))


def test_a_field_that_points_elsewhere_for_a_while_does_not_count_on_the_way_back():
    """With it the smoothed heading would be 1.4 deg off, as known at the time it is 1.7."""
    flight, q, is_turned = disturbed_flight()
    recorder = Recorder(load_profile("imu"))
    causal = np.array([a.q_ned_frd for a in flown(recorder, flight)])
    (recording,) = recorder.recordings()
    counts = usable_fields(recording)
    assert not counts[is_turned].any()
    assert counts[~is_turned].mean() > 0.95  # all but what is less than 4 s away from it
    smoothed = heading_deg(smooth_all(recorder)[1].q_ned_frd, q)
    assert smoothed < 0.3 * heading_deg(causal, q)
    assert smoothed < 0.4
