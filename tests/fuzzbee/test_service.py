"""``run`` as a process: real UDP, real Zenoh sessions, a real recording."""

import json
import signal
import time

import msgspec
import pytest

from drivers.events import Imu, VehicleId
from drivers.mavlink.constants import RAW_IMU_ID
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.framing import FrameReader
from estimator.profile import load_profile
from service.pipeline import Pipeline
from tests.fuzzbee.processes import UDP, descendants, free_endpoint, free_port, is_alive
from tests.fuzzbee.recording import frames_of
from tests.fuzzbee.services import SLOW_HZ, Subscriber, end, flight, keep_reading, only, service
from tests.service.flight_rig import Wire
from tests.service.sessions import assert_without_gaps, plain_client, router, wait_for


def test_what_is_published_is_what_a_pipeline_makes_of_the_recording(tmp_path):
    """To the last digit; and nothing that was sent is missing in the recording."""
    port, endpoint, log = free_port(UDP), free_endpoint(), tmp_path / "flight.tlog"
    options = ("--record", log, *only(endpoint))
    with service(port, *options) as process, plain_client(endpoint) as session:
        lines, seen = keep_reading(process), Subscriber(session)
        time.sleep(0.3)
        with flight(4, port, rate_hz=SLOW_HZ) as sent:
            seen.wait_for_attitudes(100)
        time.sleep(0.3)
        family = descendants(process.pid)
        result = end(process, lines)
        assert not any(map(is_alive, family))  # Ctrl-C leaves nobody
    assert b"".join(frame for _, frame in frames_of(log)) == b"".join(sent)
    whole = [name for name in "1234" if not result["vehicles"][name]["shed"]]
    if not whole:
        pytest.skip("a long stall: samples of all were left out, and nobody knows which")
    for name in whole:
        records = [record for _, record in seen.attitudes[name]]
        assert_one_pipeline_says(records, frames_of(log), VehicleId(int(name), 1))


def assert_one_pipeline_says(records, frames, address):
    """Each attitude is the one after its last sample, which a record of age 0 does not show."""
    pipeline, wire = Pipeline(load_profile("paper")), Wire(MavlinkDecoder(references=False))
    every = (event for us, data in frames for event in wire.events(data, us))
    events = [event for event in every if getattr(event, "vehicle", None) == address]
    reported = [record for record in records if record["age_ms"] > 0.0]
    assert len(reported) > 0.8 * len(records)
    for record in reported:
        time_us = record["time_unix_us"]
        last_us = time_us - round(1e3 * record["age_ms"])
        while events and (not isinstance(events[0], Imu) or events[0].arrival_us <= last_us):
            pipeline.handle(events.pop(0))
        vehicle = pipeline.vehicle(address)
        vehicle.publishing.attitudes = record["sequence"]
        vehicle.on_time(time_us)
        alone = json.loads(msgspec.json.encode(vehicle.attitude(time_us)))
        for key in ("q_ned_frd", "rate_rad_s", "sigma_deg", "time_boot_us"):
            assert alone[key] == record[key]


def test_a_service_that_was_stopped_publishes_nothing_old_and_counts_every_sample():
    """Of each vehicle only what is newest still counts."""
    port, endpoint = free_port(UDP), free_endpoint()
    with service(port, *only(endpoint)) as process, plain_client(endpoint) as session:
        lines, seen = keep_reading(process), Subscriber(session)
        with flight(4, port) as sent:
            seen.wait_for_attitudes(30)
            process.send_signal(signal.SIGSTOP)
            time.sleep(2.0)
            seen.attitudes.clear()
            process.send_signal(signal.SIGCONT)
            seen.wait_for_attitudes(30)
            rows = [row for each in seen.attitudes.values() for row in each]
        # each vehicle's last; a hundred more of each waited before the others were left out
        ages_s = [arrival_s - 1e-6 * record["time_unix_us"] for arrival_s, record in rows]
        assert len([age for age in ages_s if age > 1.0]) <= 2 * 4
        # everything has been read by then
        wait_for(lambda: [each["state"] for each in seen.statuses.values()] == ["degraded"] * 4)
        result = end(process, lines)
    assert result["lost"] == 0
    frames = [frame for data in sent for frame in FrameReader().feed(data)]
    for name, counted in result["vehicles"].items():
        imu = sum((f.message_id, f.system_id) == (RAW_IMU_ID, int(name)) for f in frames)
        refused = sum(counted["rejected"].values())
        # one waits for the next
        assert 0 <= imu - counted["samples"] - counted["shed"] - refused <= 1


def test_two_services_on_a_router_each_with_its_share():
    """What a subscriber at the router sees is one fleet, its keys those of one service."""
    ports, endpoint = [free_port(UDP) for _ in range(2)], free_endpoint()
    at_router = ("-m", "client", "-e", endpoint)
    with router(endpoint):
        first, second = (("--allow-system-ids", share, *at_router) for share in ("1,3-4", "2"))
        with (
            service(ports[0], *first) as one,
            service(ports[1], *second) as two,
            plain_client(endpoint) as session,
            flight(4, *ports),  # both hear all, and take their share
        ):
            seen = Subscriber(session)
            seen.wait_for_attitudes(30)
            results = [end(each, keep_reading(each)) for each in (one, two)]
    assert [sorted(result["vehicles"]) for result in results] == [["1", "3", "4"], ["2"]]
    assert all(result["refused"]["system_not_allowed"] > 50 for result in results)
    for records in seen.attitudes.values():
        assert_without_gaps([record for _, record in records])
