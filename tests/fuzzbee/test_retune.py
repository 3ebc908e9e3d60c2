"""``replay --retune`` and ``run --retune`` from the command line."""

import time

import numpy as np
import pytest
from pymavlink import mavutil

from drivers.events import Imu
from drivers.mavlink.recorder import Recorder
from estimator.profile import load_profile
from fuzzbee.retuning import Retuning
from service.parameters import ParameterRequests
from service.pipeline import Pipeline
from service.sinks.mavlink import RecordingSink
from service.vehicle_status import Load, status_record
from tests.fuzzbee.recording import DATA
from tests.paper_noise import NoiseScale, samples_of, simulate_scaled
from tests.service.flight_rig import ONE, START_US, texts

LOG = DATA / "px4_hover.ulg"


def test_a_flight_in_which_no_noise_changes_is_replayed_to_the_same_digit(replayed):
    plain, retuned = (replayed(LOG, *options) for options in ((), ("--retune",)))
    assert "retuned" not in plain
    assert retuned.pop("retuned") == {"count": 0, "changes": []}
    for report in (plain, retuned):
        report.pop("wall_s")
    assert retuned == plain


@pytest.mark.slow
def test_a_live_vehicle_is_retuned_by_a_thread_beside_it(tmp_path):
    """The loop's part is done here. The decision comes by the mailbox."""
    noise = np.where(np.arange(4020) < 2000, 1.0, 5.0)  # of the vectors, from 20 s on
    made, requests = simulate_scaled(400, 4020, NoiseScale(vectors=noise)), ParameterRequests()
    with Retuning(requests, None) as retuning, Recorder(tmp_path / "x.tlog") as recorder:
        pipeline = Pipeline(load_profile("paper"), new_estimator=retuning.estimator)
        retuning.pipeline = pipeline
        sink = RecordingSink(recorder, lambda: START_US)
        for each in samples_of(made):
            pipeline.handle(Imu(ONE, START_US + each.time_us, each.time_us, "RAW_IMU", each))
        vehicle = pipeline.vehicle(ONE)
        deadline_s = time.monotonic() + 120.0
        while vehicle.profile.confidence.gravity == 1.0 and time.monotonic() < deadline_s:
            requests.serve(pipeline.replace_profile)
            time.sleep(0.02)
        outputs = pipeline.tick(START_US + 40_200_000)
        sink.handle(outputs)
        status = status_record(vehicle, START_US, Load(), 0)
    requests.close()
    assert vehicle.profile.confidence.gravity < 0.6  # vectors x5
    assert status.retuned.count == 1
    assert status.retuned.last.startswith("gain x0.")
    assert any("retuned: gain x0." in line for line in texts(outputs))
    log = mavutil.mavlink_connection(str(tmp_path / "x.tlog"))
    frame = log.recv_match()
    log.close()
    assert frame.get_type() == "STATUSTEXT"
    assert (frame.get_srcSystem(), frame.get_srcComponent()) == (1, 191)
    assert frame.text.startswith("retuned: gain x0.")
