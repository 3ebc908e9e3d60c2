"""The messages at real sockets, decoded by pymavlink."""

import math
import socket
from contextlib import ExitStack, closing
from itertools import count
from select import select

import msgspec
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega

from drivers.endpoint import parse_endpoint
from drivers.events import VehicleId
from service.records import Evicted, Published
from service.sinks.mavlink import MavlinkSink
from tests.service.records import UNIX_US, differing, record
from tests.service.sessions import wait_for

VEHICLE = VehicleId(7, 1)
KINDS = ["HEARTBEAT", "ATTITUDE_QUATERNION", "ATTITUDE_QUATERNION_COV"]


@pytest.fixture
def receiver():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        made.bind(("127.0.0.1", 0))
        made.settimeout(60.0)
        yield made


@pytest.fixture
def opened(receiver):
    """A function that opens a sink to the receiver."""
    endpoint = parse_endpoint(f"udpout:127.0.0.1:{receiver.getsockname()[1]}")
    with ExitStack() as sinks:
        yield lambda **options: sinks.enter_context(closing(MavlinkSink(endpoint, **options)))


def attitudes(count, period_us, vehicle=VEHICLE, start=0):
    times_us = (UNIX_US + n * period_us for n in range(start, start + count))
    return [Published(vehicle, record(10, 20, 30, time_unix_us=us)) for us in times_us]


def messages(receiver):
    """All that has come, up to now."""
    parser = ardupilotmega.MAVLink(None)
    receiver.setblocking(False)
    found = []
    while True:
        try:
            found += parser.parse_buffer(receiver.recv(2048)) or []
        except BlockingIOError:
            return found


def test_the_attitude_comes_from_the_onboard_computer_never_from_the_autopilot(receiver, opened):
    sink = opened()
    sink.handle(attitudes(1, 0))
    got = messages(receiver)
    assert [m.get_type() for m in got] == KINDS
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in got} == {(7, 191)}
    heartbeat, attitude, uncertain = got
    onboard = ardupilotmega.MAV_TYPE_ONBOARD_CONTROLLER, ardupilotmega.MAV_AUTOPILOT_INVALID
    assert (heartbeat.type, heartbeat.autopilot) == onboard
    sent = record(10, 20, 30)
    q = [getattr(attitude, f"q{n}") for n in range(1, 5)]
    assert q == pytest.approx(sent.q_ned_frd, abs=1e-7)
    rate = [getattr(attitude, f"{axis}speed") for axis in ("roll", "pitch", "yaw")]
    assert rate == pytest.approx(sent.rate_rad_s)
    assert attitude.time_boot_ms == 1000
    assert uncertain.time_usec == 1_000_000
    assert list(uncertain.q) == pytest.approx(sent.q_ned_frd, abs=1e-7)
    level, heading = sent.sigma_deg.inclination / 1.5096, sent.sigma_deg.heading
    roll, pitch, yaw = (math.degrees(math.sqrt(uncertain.covariance[4 * k])) for k in range(3))
    assert (roll, pitch, yaw) == pytest.approx((level, level, heading), rel=1e-3)


def test_as_a_vehicle_of_its_own_it_is_what_ground_stations_show(receiver, opened):
    """pymavlink's own view of the link, by which MAVProxy chooses what to show."""
    sink = opened(appears_as=VehicleId(200, 1))
    sink.handle(attitudes(2, 20_000) + attitudes(2, 20_000, VehicleId(8, 1)))
    station = mavutil.mavlink_connection(f"udpout:127.0.0.1:{receiver.getsockname()[1]}")
    got = messages(receiver)
    for message in got:
        station.post_message(message)
    station.close()
    assert [m.get_type() for m in got] == ["HEARTBEAT", "ATTITUDE", "ATTITUDE"]  # of vehicle 7 only
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in got} == {(200, 1)}
    assert station.probably_vehicle_heartbeat(got[0])
    assert got[0].system_status == ardupilotmega.MAV_STATE_STANDBY
    assert not got[0].base_mode & ardupilotmega.MAV_MODE_FLAG_SAFETY_ARMED
    seen = station.sysid_state[200].messages["ATTITUDE"]
    angles = [math.degrees(angle) for angle in (seen.roll, seen.pitch, seen.yaw)]
    assert angles == pytest.approx([10.0, 20.0, 30.0], abs=1e-4)


def test_it_answers_no_command(receiver, opened):
    sink = opened(appears_as=VehicleId(200, 1))
    sink.handle(attitudes(1, 0))
    _, peer = receiver.recvfrom(2048)
    station = ardupilotmega.MAVLink(None, srcSystem=255)
    command = ardupilotmega.MAV_CMD_COMPONENT_ARM_DISARM
    arm = station.command_long_encode(200, 1, command, 0, 1, *[0] * 6)
    for each in (arm, station.param_request_list_encode(200, 1)):
        receiver.sendto(each.pack(station), peer)
    messages(receiver)
    sink.handle(attitudes(1, 0, start=10))
    sink.handle(attitudes(1, 20_000, start=100))
    assert {m.get_type() for m in messages(receiver)} <= {"HEARTBEAT", "ATTITUDE"}


def test_an_address_that_is_there_is_not_taken(receiver, opened):
    sink = opened(appears_as=VehicleId(7, 1))
    with pytest.raises(ConnectionError, match="vehicle 7 is there already"):
        sink.handle(attitudes(1, 0))
    assert messages(receiver) == []


@pytest.mark.parametrize(("rate_hz", "expected"), [(100, 50), (10, 10), (70, 50), (49, 49)])
def test_at_most_fifty_a_second_and_a_heartbeat_each_second(receiver, opened, rate_hz, expected):
    sink = opened()
    for output in attitudes(rate_hz * 2, 1_000_000 // rate_hz):
        sink.handle([output])
    kinds = [m.get_type() for m in messages(receiver)]
    assert kinds.count("HEARTBEAT") == 2
    # sigma comes five times a second
    assert kinds.count("ATTITUDE_QUATERNION_COV") == pytest.approx(10, abs=1)
    # two seconds; a jitter of the rounded period may move one over the end
    assert kinds.count("ATTITUDE_QUATERNION") == pytest.approx(2 * expected, abs=1)


def test_a_later_client_is_served_and_a_broken_link_is_reported_once():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        sink = MavlinkSink(parse_endpoint(f"tcp:127.0.0.1:{port}"))
        client, _ = server.accept()
        client.settimeout(60.0)
        sink.handle([])  # the connection is made
        sink.handle(attitudes(1, 0))
        assert client.recv(1) == b"\xfd"
        client.close()
        reported, steps = [], count(1)

        def send():
            try:
                sink.handle(attitudes(1, 20_000, start=next(steps)))
            except ConnectionError as error:
                reported.append(str(error))

        def is_readable(one):
            send()
            return select([one], [], [], 0.0)[0]

        wait_for(lambda: is_readable(server))
        again, _ = server.accept()
        with closing(again), closing(sink):
            wait_for(lambda: is_readable(again))
            assert again.recv(1) == b"\xfd"
        (line,) = reported
        assert str(port) in line


def test_another_component_sends_for_the_system_once_the_first_is_forgotten(receiver, opened):
    """Other components are not mixed in, nor is another onboard computer, which is not ours."""
    sink, other = opened(), VehicleId(7, 2)
    sink.handle(attitudes(1, 0) + attitudes(3, 20_000, other))
    sink.handle(attitudes(1, 0, vehicle=VehicleId(8, 191)))
    found = [(m.get_type(), m.get_srcSystem()) for m in messages(receiver)]
    assert found == [(kind, 7) for kind in KINDS]
    sink.handle([Evicted(other), *attitudes(1, 0, other)])
    assert messages(receiver) == []
    sink.handle([Evicted(VEHICLE), *attitudes(1, 0, other)])
    assert [m.get_type() for m in messages(receiver)] == KINDS


def statuses(status, seconds):
    times = (UNIX_US + second * 1_000_000 for second in range(seconds))
    return [Published(VEHICLE, status, time_unix_us=now_us) for now_us in times]


def texts(got):
    """Severities and whole texts, put together as MAVLink requires of a receiver."""
    printed = {}
    for m in got:
        if m.get_type() == "STATUSTEXT":
            assert (m.get_srcSystem(), m.get_srcComponent()) == (7, 191)
            severity, text = printed.get(m.id, (m.severity, ""))
            assert severity == m.severity
            printed[m.id] = (severity, text + m.text)
    return list(printed.values())


@pytest.mark.parametrize("wrong", ["autopilot", "ours", ""])
def test_a_differing_attitude_is_announced_once_in_ten_seconds(receiver, opened, wrong):
    sink = opened(attitudes=False, announces=True)
    sink.handle(statuses(differing(wrong=wrong), 25) + attitudes(3, 20_000))
    got = messages(receiver)
    assert {m.get_type() for m in got} == {"HEARTBEAT", "STATUSTEXT"}
    severities, reported = zip(*texts(got), strict=True)
    assert severities == (ardupilotmega.MAV_SEVERITY_WARNING,) * 3
    assert reported[0].startswith("autopilot heading 25 deg off ours (+-2 deg); ")
    ends = {"autopilot": "likely wrong: the autopilot's", "ours": "likely wrong: ours"}
    assert reported[0].endswith(ends.get(wrong, "which is wrong is not known"))


def test_what_agrees_is_not_announced_and_nothing_is_without_being_asked(receiver, opened):
    fine = msgspec.structs.replace(differing(), autopilot=None)
    sink = opened(attitudes=False, announces=True)
    sink.handle(statuses(fine, 25))
    assert texts(messages(receiver)) == []
    sink = opened()
    sink.handle(statuses(differing(), 25))
    assert messages(receiver) == []


def test_after_the_hosts_clock_was_set_back_it_sends_no_more_often(receiver, opened):
    sink = opened()
    sink.handle(attitudes(1, 0))
    messages(receiver)
    for start in (-360_000, -359_900):  # an hour ago, 100 a second
        sink.handle(attitudes(100, 10_000, start=start))
    got = [m for m in messages(receiver) if m.get_type() == "ATTITUDE_QUATERNION"]
    assert len(got) == pytest.approx(100, abs=1)
