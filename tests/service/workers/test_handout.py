import socket

import pytest

from drivers.events import VehicleId
from drivers.mavlink.backlog import Arrived
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.encoder import (
    FrameEncoder,
    heartbeat,
    param_value,
    raw_imu,
    sim_state,
)
from drivers.mavlink.frame_batch import unpack_frames
from drivers.mavlink.framing import FrameReader
from estimator.types import ZERO_VEC3
from service.workers.connection import Connection, Kind
from service.workers.handout import Handout

IMU = raw_imu(1, (0.0, 0.0, -9.8), ZERO_VEC3, ZERO_VEC3)


def arrived(system, *messages, component=1, arrival_us=1):
    encoder = FrameEncoder(VehicleId(system, component))
    data = b"".join(encoder.frame(message, 0) for message in messages)
    return [Arrived(arrival_us, frame) for frame in FrameReader().feed(data)]


@pytest.fixture
def made():
    handout = Handout(2, MavlinkDecoder(references=False).wanted)
    pairs = [[Connection(end) for end in socket.socketpair()] for _ in range(3)]
    for number in range(2):
        handout.connect(number, pairs[number][0], b"job")
    yield handout, pairs
    for pair in pairs:
        for end in pair:
            end.close()


def frames(end):
    end.wait(1.0)
    batches = [m.body for m in end.receive() if m.kind is Kind.FRAMES]
    return [each for batch in batches for each in unpack_frames(batch)]


def test_all_of_a_system_goes_to_one_worker_and_what_nobody_wants_to_none(made):
    handout, pairs = made
    first = arrived(1, IMU, sim_state((1.0, 0.0, 0.0, 0.0), *(3 * [ZERO_VEC3])))
    other = arrived(2, IMU)
    late = arrived(1, param_value("COMPASS_OFS_X", 3.0, 1, 0), component=190)
    handout.take(first + other + late)
    assert frames(pairs[0][1]) == first[:1] + late
    assert frames(pairs[1][1]) == other


def test_a_successor_hears_first_what_its_vehicles_have_said_but_once(made):
    handout, pairs = made
    once = arrived(1, heartbeat(2, 3), param_value("COMPASS_OFS_X", 3.0, 1, 0))
    newer = arrived(1, param_value("COMPASS_OFS_X", 4.0, 1, 0), arrival_us=2)
    handout.take(once + arrived(1, IMU, param_value("WPNAV_SPEED", 5.0, 1, 0)) + newer)
    handout.take(arrived(2, heartbeat(2, 3)))
    successor = pairs[2]
    handout.connect(0, successor[0], b"job")
    later = arrived(1, IMU, arrival_us=3)
    handout.take(later)
    successor[1].wait(1.0)
    job, *batches = successor[1].receive()
    assert job == (Kind.JOB, b"job")
    got = [each for message in batches for each in unpack_frames(message.body)]
    assert got == [once[0], *newer, *later]
