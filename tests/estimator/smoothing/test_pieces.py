"""A long recording is smoothed piece by piece, each with what is around it."""

import numpy as np
import pytest

from estimator.conditioning.vertical.averaging import WINDOW_S
from estimator.profile import load_profile
from estimator.smoothing import Recorder, smooth_all, unaided
from estimator.smoothing.windows import low_passed
from tests.flight import banked_flight, flown


def smoothed(flight):
    recorder = Recorder(load_profile("imu"))
    flown(recorder, flight, reports=[])
    _, found = smooth_all(recorder)
    return np.hstack([found.q_ned_frd, found.sigma_rad])


def test_pieces_with_wide_margins_are_what_the_whole_is(monkeypatch):
    flight = banked_flight(seconds=40.0, rate_hz=50.0)
    whole = smoothed(flight)
    monkeypatch.setattr(unaided, "PIECE_S", 10.0)
    np.testing.assert_array_equal(smoothed(flight), whole)
    monkeypatch.setattr(unaided, "MARGIN_S", 1.0)
    assert not np.array_equal(smoothed(flight), whole)


def test_a_low_pass_there_and_back_leaves_half_at_its_cutoff():
    """sqrt(2) / (2 pi tau), as of the estimator's own."""
    tau_s = 5.0
    wave = np.sin(np.sqrt(2.0) / tau_s * WINDOW_S * np.arange(2000))[:, None]
    left = low_passed(wave, tau_s)[500:1500]
    assert np.sqrt(np.mean(left**2) / np.mean(wave**2)) == pytest.approx(0.5, abs=0.01)
