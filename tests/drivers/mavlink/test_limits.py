"""What a link leaves out when too much comes, and what it reports when nothing comes."""

import pytest

from drivers import resources
from drivers.endpoint import parse_endpoint
from drivers.events import Shed, VehicleId
from drivers.mavlink import connection
from drivers.mavlink.connection import LinkDiagnostics, RateLimits
from drivers.mavlink.constants import ATTITUDE_ID, HEARTBEAT_ID, PARAM_VALUE_ID, RAW_IMU_ID
from drivers.mavlink.framing import Frame
from drivers.mavlink.link import REPORT_EVERY_US, FrameQueue


def admitted(limits, peers, packets, seconds, size=30, imu=False):
    """How many packets a second are read of senders that send that many a second each."""
    count = 0
    for number in range(int(packets * seconds)):
        now_s = 1000.0 + number / packets
        for peer in range(peers):
            name = f"10.0.{peer // 250}.{peer % 250}:{number % 7 if peers > 500 else 1}"
            count += limits.admits(name, size, now_s)
            if imu:
                limits.note_imu(name, now_s)
    return count / seconds


@pytest.mark.parametrize("peers", [1, 5, 100])
def test_a_flood_without_imu_data_has_a_budget_each_and_one_of_all_together(peers):
    """The first second's worth is there at the beginning."""
    limit_hz = min(peers * connection.PACKETS_HZ, 2000.0)
    rate_hz = admitted(RateLimits(), peers, 1000.0, 4.0)
    assert rate_hz == pytest.approx(limit_hz * 5 / 4, rel=0.02)
    if peers == 100:  # more than are remembered still share it
        assert admitted(RateLimits(), 1100, 10.0, 4.0) <= 2000.0 * 5 / 4


def test_a_large_packet_counts_as_many_and_a_clock_that_is_set_back_locks_nobody_out():
    large_hz = admitted(RateLimits(), 1, 1000.0, 4.0, size=60_000, imu=True)
    assert large_hz * 900 < connection.IMU_PACKETS_HZ * 1.5
    limits = RateLimits()
    assert limits.admits("a", 30, 5000.0)
    assert sum(limits.admits("a", 30, 10.0 + k / 100) for k in range(1000)) == 1000


def frame(system, message, number=0, component=1):
    payload = bytes(26) + bytes([number])
    return Frame(message, system, component, payload, 0, len(payload), False)


def taken(queue):
    return [(arrival_us, frame.message_id) for arrival_us, frame in queue.take(1000)]


def test_up_to_its_size_the_queue_keeps_everything_and_what_cannot_be_left_out_is_bounded():
    queue = FrameQueue(most_waiting=10)
    for number in range(10):
        queue.add(number, [frame(1, RAW_IMU_ID)])
    assert taken(queue) == [(number, RAW_IMU_ID) for number in range(10)]
    assert (queue.shed, queue.dropped, queue.take_shed(1)) == (0, 0, [])
    queue.add(0, [frame(1, PARAM_VALUE_ID, k) for k in range(25)])
    assert [frame.data[-1] for _, frame in queue.take(99)] == list(range(15, 25))
    assert queue.dropped == 15


def test_a_full_queue_keeps_the_newest_of_each_stream_and_what_is_sent_once():
    """Two IMUs in one message are two streams; heartbeats make older ones old, but do not count."""
    queue = FrameQueue(most_waiting=20)
    sent = [
        *((k, frame(1, RAW_IMU_ID)) for k in range(8)),
        *((k, frame(1, RAW_IMU_ID, 1)) for k in range(3)),
        *((k, frame(1, HEARTBEAT_ID)) for k in range(2)),
        *((k, frame(2, ATTITUDE_ID)) for k in range(5)),
        (5, frame(2, ATTITUDE_ID, component=2)),
        *((k, frame(1, PARAM_VALUE_ID)) for k in range(3)),
    ]
    for arrival_us, each in sent:
        queue.add(arrival_us, [each])
    assert taken(queue) == [
        (7, RAW_IMU_ID),
        (2, RAW_IMU_ID),
        (1, HEARTBEAT_ID),
        (4, ATTITUDE_ID),
        (5, ATTITUDE_ID),
        *((k, PARAM_VALUE_ID) for k in range(3)),
    ]
    one = VehicleId(1, 1)
    found = sorted(queue.take_shed(REPORT_EVERY_US), key=lambda each: each.samples)
    assert found == [
        Shed(one, REPORT_EVERY_US, "RAW_IMU:1", 2),
        Shed(one, REPORT_EVERY_US, "RAW_IMU", 7),
    ]
    assert queue.shed == 9


def test_what_was_left_out_is_reported_now_and_then():
    queue = FrameQueue(most_waiting=1)
    reports = []
    for number in range(4):
        now_us = 1_000_000 + number * (1 + REPORT_EVERY_US // 2)
        queue.add(now_us, [frame(1, RAW_IMU_ID), frame(1, RAW_IMU_ID)])
        reports.append(sum(each.samples for each in queue.take_shed(now_us)))
        queue.take(9)
    assert reports == [1, 0, 2, 0]
    assert queue.shed == 4
    queue.add(0, [frame(1, RAW_IMU_ID), frame(1, RAW_IMU_ID)])  # the host's clock was set back
    assert sum(each.samples for each in queue.take_shed(0)) == 2


SERIAL = parse_endpoint("/dev/ttyUSB0:57600")


def test_silence_is_reported_once_after_five_seconds_and_not_with_data():
    quiet, heard = LinkDiagnostics(SERIAL), LinkDiagnostics(SERIAL)
    assert quiet.silence(100.0, is_silent=False) is None
    lines = [quiet.silence(at_s, is_silent=True) for at_s in (200.0, 204.9, 205.0, 300.0)]
    assert [line is None for line in lines] == [True, True, False, True]
    assert lines[2].startswith("/dev/ttyUSB0:57600: nothing has arrived in 5 s")
    for at_s, is_silent in ((0.0, True), (4.0, False), (6.0, True)):
        assert heard.silence(at_s, is_silent=is_silent) is None


def test_bytes_without_a_frame_are_reported_once_and_again_after_a_frame():
    diagnostics = LinkDiagnostics(SERIAL)
    found = [diagnostics.bytes_read(100, 0, 0.5 * n) for n in range(12)]
    (text,) = [line for line in found if line]
    assert text.startswith("/dev/ttyUSB0:57600: 500 bytes and not one MAVLink frame: another baud")
    assert found.index(text) == 4
    assert diagnostics.bytes_read(100, 1, 7.0) is None
    assert any(diagnostics.bytes_read(300, 0, 8.0 + n) for n in range(5))
    few = LinkDiagnostics(SERIAL)
    assert not any(few.bytes_read(1, 0, n) for n in range(100))


GIB = 1 << 30


@pytest.mark.parametrize("version", [0, 1])
@pytest.mark.parametrize(
    ("machine", "limit", "expected"),
    [
        (16 * GIB, None, 4096),
        (16 * GIB, "max", 4096),
        (16 * GIB, 3 * GIB, 1536),  # a container that may have less
        (16 * GIB, 256 << 20, 512),
        (2 * GIB, 3 * GIB, 1024),
        (None, None, 512),
    ],
)
def test_there_is_room_for_as_many_as_machine_and_container_have(
    machine, limit, expected, version, tmp_path, monkeypatch
):
    def sysconf(name):
        if machine is None:
            raise ValueError(name)
        return {"SC_PHYS_PAGES": machine // 4096, "SC_PAGE_SIZE": 4096}[name]

    monkeypatch.setattr(resources.os, "sysconf", sysconf)
    files = tmp_path / "memory.max", tmp_path / "limit_in_bytes"
    monkeypatch.setattr(resources, "GROUP", files)
    if limit is not None:
        files[version].write_text(f"{limit}\n")
    assert resources.slots() == expected
