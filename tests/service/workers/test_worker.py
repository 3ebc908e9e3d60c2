"""A worker's loop in a thread of the test: frames in, what it makes out, until the service ends."""

import json
import pickle
import socket
import threading
import time

import pytest

from drivers.events import VehicleId
from drivers.mavlink.backlog import MOST_AT_ONCE, Arrived
from drivers.mavlink.encoder import FrameEncoder, heartbeat, raw_imu
from drivers.mavlink.frame_batch import pack_frames
from drivers.mavlink.framing import FrameReader
from estimator.profile import load_profile
from service.counts import Counts
from service.records import Message, Replaced
from service.workers.connection import Connection, Kind
from service.workers.job import Inheritance, Job, ProfileAnswer, ProfileRequest
from service.workers.report import attitudes_of
from service.workers.worker import FAILED, OK, work

PERIOD_US = 20_000
SAMPLES = 4 * MOST_AT_ONCE  # more than are decoded at one go
ONE = VehicleId(1, 1)


def job(**changes):
    plain = Job(
        load_profile("paper"), None, 100.0, None, False, None, False, False, time.monotonic(), {}
    )
    return plain._replace(**changes)


def imu_frames(count):
    encoder, begin_us = FrameEncoder(ONE), time.time_ns() // 1000 - count * PERIOD_US
    data = [
        encoder.frame(raw_imu(n * PERIOD_US, (0.0, 0.0, -9.8), (0.1, 0.0, 0.0), (0.2, 0, 0.4)), 0)
        for n in range(1, count + 1)
    ]
    return [
        Arrived(begin_us + n * PERIOD_US, frame)
        for n, each in enumerate(data, start=1)
        for frame in FrameReader().feed(each)
    ]


@pytest.fixture
def worker():
    """The service's end of a connection, and a function that ends and waits: status, messages."""
    ours, theirs = socket.socketpair()
    connection, statuses, messages = Connection(ours), [], []
    thread = threading.Thread(target=lambda: statuses.append(work(theirs, 4)), daemon=True)
    thread.start()

    def end():
        connection.end_sending()
        until_s = time.monotonic() + 20.0
        while thread.is_alive() and time.monotonic() < until_s:
            connection.wait(0.05)
            messages.extend(connection.receive())
        messages.extend(connection.receive())
        return statuses, messages

    yield connection, end
    connection.close()
    thread.join(20.0)
    theirs.close()


def test_all_that_was_handed_over_counts_though_the_service_ends_at_once(worker):
    connection, end = worker
    connection.put(Kind.JOB, pickle.dumps(job()))
    connection.put(Kind.FRAMES, pack_frames(imu_frames(SAMPLES)))
    statuses, messages = end()
    assert statuses == [OK]
    last = [pickle.loads(m.body) for m in messages if m.kind is Kind.COUNTS][-1]
    assert last.vehicles[ONE].samples == SAMPLES
    attitudes = [
        each for m in messages if m.kind is Kind.ATTITUDES for each in attitudes_of(m.body)
    ]
    assert attitudes
    assert [json.loads(payload)["sequence"] for _, payload in attitudes] == list(
        range(len(attitudes))
    )


def test_a_successor_goes_on_with_profile_counts_and_numbers(worker):
    connection, end = worker
    profile = load_profile("adaptive")
    counts = Counts(
        "running", None, "RAW_IMU", 50.0, 70_000, 1000, 3, 500, 60, {"gyroscope_spike": 4}
    )
    connection.put(Kind.JOB, pickle.dumps(job(inherited={ONE: Inheritance(profile, counts)})))
    connection.put(Kind.FRAMES, pack_frames(imu_frames(10)))
    _, messages = end()
    last = [pickle.loads(m.body) for m in messages if m.kind is Kind.COUNTS][-1].vehicles[ONE]
    assert (last.samples, last.shed, last.rejected) == (1010, 3, {"gyroscope_spike": 4})
    payloads = [p for m in messages if m.kind is Kind.ATTITUDES for _, p in attitudes_of(m.body)]
    assert json.loads(payloads[0])["sequence"] == 500


def test_a_profile_is_replaced_or_refused_and_requests_go_to_the_vehicle(worker):
    connection, end = worker
    connection.put(Kind.JOB, pickle.dumps(job(request_rate_hz=25.0)))
    encoder = FrameEncoder(ONE)
    beat = Arrived(1, FrameReader().feed(encoder.frame(heartbeat(2, 3), 0))[0])
    connection.put(Kind.FRAMES, pack_frames([beat, *imu_frames(10)]))
    time.sleep(0.2)
    for number, partial in enumerate([{"filter": {"gamma": 0.25}}, {"filter": {"gamma": "x"}}]):
        request = ProfileRequest(number, ONE, partial)
        connection.put(Kind.PROFILE, pickle.dumps(request))
    time.sleep(0.5)
    _, messages = end()
    answers = [ProfileAnswer(*pickle.loads(m.body)) for m in messages if m.kind is Kind.PROFILE]
    assert [answer.number for answer in answers] == [0, 1]
    assert answers[0].profile.filter.gamma == 0.25
    assert answers[1].profile is None
    assert "gamma" in answers[1].refusal
    outgoing = [pickle.loads(m.body) for m in messages if m.kind is Kind.OUTGOING]
    assert {each.system_id for group in outgoing for each in group} == {1}
    outputs = [o for m in messages if m.kind is Kind.OUTPUTS for o in pickle.loads(m.body)]
    assert [o.vehicle for o in outputs if isinstance(o, Replaced)] == [ONE]
    assert Message("vehicle 1: running") in outputs


def test_a_worker_that_fails_says_why(worker):
    connection, end = worker
    connection.put(Kind.JOB, pickle.dumps(job()))
    connection.put(Kind.FRAMES, b"\xff\xff\xff\xff no batch")
    statuses, messages = end()
    assert statuses == [FAILED]
    [failure] = [m.body.decode() for m in messages if m.kind is Kind.FAILURE]
    assert "Expected `array`" in failure
