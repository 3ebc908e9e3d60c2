"""What additions.py adds, on banked turns with a heading that is off: whatever uses it shows."""

import json
import math
import os
import socket
import time
from dataclasses import replace
from operator import itemgetter

import numpy as np
import pytest

from drivers.events import VehicleId
from drivers.logs.open import open_log
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.framing import FrameReader
from drivers.mavlink.link import FrameQueue
from drivers.mavlink.messages import IMU_MESSAGES, MESSAGES
from estimator.aiding.sources.source import SOURCES
from estimator.geometry.frames import euler_rad
from estimator.live.rows import report_of, reports_between
from estimator.profile import load_profile, merge_profile, profile_to_toml
from estimator.types import ImuSample
from fuzzbee.log_replay import replay
from fuzzbee.tune.read_flight import read_flight
from tests.drivers.mavlink.messages import PX4, UNIX, m
from tests.estimator.aiding.heading_source import HEADING_SOURCE, HeadingSample
from tests.extensions.additions import GPS2_RAW, HIL_SENSOR
from tests.flight import banked_flight
from tests.fuzzbee.processes import UDP, free_endpoint, free_port, started
from tests.fuzzbee.services import await_line, keep_reading, only
from tests.programs import ROOT
from tests.service.flight_rig import Wire
from tests.service.sessions import heard, plain_client, wait_for
from tuning.flight import fly
from tuning.online.retuner import RetunedEstimator
from tuning.online.segment import fly_again

BEGIN_US = 1_000_000
TURNED_RAD = 0.12  # less than what velocity contradicts
FLIGHT = banked_flight(seconds=30.0)
# The field of the flight has no declination, as the profile has it.
PROFILE = merge_profile(load_profile("imu"), {"reference": {"declination_deg": 0.0}})


def frames(heading=True):
    """(time in us, bytes) of the flight, by pymavlink's own classes."""
    flight, link = FLIGHT, m.MAVLink(None, srcSystem=1, srcComponent=1)
    behind = dict(flight.reports)
    for k, (sample, q) in enumerate(zip(flight.samples, flight.truth, strict=True)):
        us, messages = BEGIN_US + sample.time_us, []
        if k % 50 == 0:
            messages.append(m.MAVLink_heartbeat_message(2, PX4, 0, 0, 0, 3))
        vectors = (*sample.acc_m_s2, *sample.gyr_rad_s, *sample.mag_gauss)
        messages.append(m.MAVLink_hil_sensor_message(us, *vectors, 0, 0, 0, 0, 0b111111111))
        if k in behind:
            place, velocity = (0, 0, 0), behind[k].velocity_ned_m_s
            messages.append(m.MAVLink_local_position_ned_message(us // 1000, *place, *velocity))
        if heading and k % 10 == 0:
            yaw = round(np.degrees(euler_rad(q)[2] + TURNED_RAD) * 100) % 36000 or 36000
            messages.append(m.MAVLink_gps2_raw_message(us, 3, *(0,) * 9, 0, yaw=yaw))
        yield from ((us, bytes(each.pack(link))) for each in messages)


def tlog(path, heading=True):
    records = ((UNIX + us).to_bytes(8, "big") + data for us, data in frames(heading))
    path.write_bytes(b"".join(records))
    return path


@pytest.fixture
def added(monkeypatch):
    monkeypatch.setitem(IMU_MESSAGES, HIL_SENSOR.number, HIL_SENSOR)
    monkeypatch.setitem(MESSAGES, GPS2_RAW.number, GPS2_RAW)
    monkeypatch.setitem(SOURCES, HeadingSample, HEADING_SOURCE)


def test_without_the_entries_nothing_is_known_of_them():
    wire = Wire(MavlinkDecoder(references=False))
    events = [event for us, data in frames() for event in wire.events(data, UNIX + us)]
    assert {type(event).__name__ for event in events} == {"Heartbeat"}


@pytest.mark.usefixtures("added")
def test_under_overload_the_newest_of_each_stays():
    reader = FrameReader()
    every = [frame for _, data in frames() for frame in reader.feed(data)]
    queue = FrameQueue(most_waiting=len(every) - 1)
    queue.add(UNIX, every)
    kept = [frame.message_id for _, frame in queue.take(len(every))]
    assert sorted(kept) == [0, 32, 107, 124]
    (shed,) = queue.take_shed(UNIX)
    assert (shed.vehicle, shed.message) == (VehicleId(1, 1), "HIL_SENSOR")
    assert shed.samples == len(FLIGHT.samples) - 1


@pytest.mark.usefixtures("added")
def test_a_log_is_replayed_and_the_source_turns_the_estimate(tmp_path):
    with_it = replay(tlog(tmp_path / "with.tlog"), PROFILE)
    without = replay(tlog(tmp_path / "without.tlog", heading=False), PROFILE)
    with open_log(tmp_path / "with.tlog") as log:
        assert log.advice() is None  # it does not lack an IMU
    assert [*with_it.report.imu.messages] == ["HIL_SENSOR"]
    yaw_deg, other_deg = (flown.attitudes.euler_deg[:, 2] for flown in (with_it, without))
    turned = np.radians((yaw_deg - other_deg + 180.0) % 360.0 - 180.0)
    assert np.mean(turned[len(turned) // 2 :]) == pytest.approx(TURNED_RAD, abs=0.03)


@pytest.mark.usefixtures("added")
def test_tuning_and_retuning_repeat_the_reports(tmp_path):
    path = tlog(tmp_path / "with.tlog")
    flight = read_flight(path, PROFILE)
    called = [call for calls in flight.calls.values() for call in calls]
    headings = [call for call in called if isinstance(call.values[-1], HeadingSample)]
    assert len(headings) == len(FLIGHT.samples[::10])
    course = fly(flight, PROFILE)
    assert np.array_equal(course.q_ned_frd, replay(path, PROFILE).attitudes.q_ned_frd)

    segments, output = [], []
    estimator = RetunedEstimator(PROFILE, on_segment=segments.append)
    rows = zip(*map(np.ndarray.tolist, flight.rows), strict=True)
    samples = [ImuSample(us, *map(tuple, vectors), has_mag) for us, *vectors, has_mag in rows]
    for k, sample in enumerate(samples):
        for call in flight.calls.get(k, ()):
            call(estimator)
        for row in reports_between(flight.reports, k, k + 1):
            estimator.update_report(report_of(row))
        estimator.update(sample)
        output.append(estimator.attitude(sample.time_us).q_ned_frd)
    last = segments[-1]
    repeated = fly_again(PROFILE, last).q_ned_frd
    end = samples.index(last.samples[-1]) + 1
    assert np.array_equal(repeated, output[end - len(last.samples) : end])
    others = {
        k: [call for call in calls if not isinstance(call.values[-1], HeadingSample)]
        for k, calls in last.calls.items()
    }
    without = fly_again(PROFILE, replace(last, calls=others))
    assert not np.array_equal(without.q_ned_frd, repeated)


def test_a_service_publishes_what_it_makes_of_all_three(tmp_path):
    """A real process, UDP and Zenoh: the Python that starts has the entries in its tables."""
    program = "from tests.extensions.additions import add\nadd()\n"
    (tmp_path / "sitecustomize.py").write_text(program)
    port, endpoint = free_port(UDP), free_endpoint()
    headings, profile = tmp_path / "headings", tmp_path / "north.toml"
    profile.write_text(profile_to_toml(PROFILE))
    command = ["run", f"udpin:127.0.0.1:{port}", "--json", "--profile", str(profile)]
    command += ["--headings", str(headings), *only(endpoint)]
    with started(*command, PYTHONPATH=os.pathsep.join([str(tmp_path), ROOT])) as process:
        await_line(process, "listening")
        keep_reading(process)
        with plain_client(endpoint) as session:
            published = heard(session, "fuzzbee/1/attitude")
            time.sleep(0.3)
            fly_in_real_time(port)
            wait_for(lambda: published and headings.read_text().count("\n") > 100, 10.0)
        process.terminate()
        out = process.stdout.read()
    vehicle = json.loads(out)["vehicles"]["1"]
    assert vehicle["imu_message"] == "HIL_SENSOR"
    written = [line.split() for line in headings.read_text().splitlines()]
    assert {system for system, _ in written} == {"1"}
    fresh = (each for each in published if each["age_ms"] < 20.0)
    last = max(fresh, key=itemgetter("time_boot_us"))
    yaw_deg = last["euler_deg"][2]
    assert min(abs(float(yaw) - yaw_deg) for _, yaw in written) < 1e-6
    k = round((last["time_boot_us"] - BEGIN_US) / FLIGHT.samples[1].time_us)
    turned = math.radians(yaw_deg) - euler_rad(FLIGHT.truth[k])[2]
    assert math.remainder(turned, math.tau) == pytest.approx(TURNED_RAD, abs=0.05)


def fly_in_real_time(port):
    begin_s = time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for us, data in frames():
            if us > BEGIN_US + 10e6:
                break
            time.sleep(max(0.0, begin_s + 1e-6 * (us - BEGIN_US) - time.monotonic()))
            sender.sendto(data, ("127.0.0.1", port))
