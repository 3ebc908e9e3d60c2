"""What compiled code finds in datagrams is what the reader of any bytes makes of them."""

import random

import numba
import pytest
from hypothesis import given

from drivers.events import VehicleId
from drivers.mavlink.constants import ATTITUDE_ID, HEARTBEAT_ID, RAW_IMU_ID
from drivers.mavlink.encoder import FrameEncoder, attitude, heartbeat, raw_imu
from drivers.mavlink.framing import FrameReader
from drivers.mavlink.scanning import Scanner, frame_of
from tests.fuzz.cases import built, damage, frame, fuzzed

WANTED = frozenset({RAW_IMU_ID, ATTITUDE_ID})
pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")


def datagrams(rng):
    """A few of each kind: whole frames, of one sender or two; damaged, cut, empty."""
    made = []
    for _ in range(6):
        data = b"".join(frame(rng) for _ in range(rng.randrange(4)))
        made.append(damage(data, rng) if rng.random() < 0.4 else data)
    return made


@fuzzed(300, 20_000)
@given(made=built(datagrams))
def test_what_is_found_is_what_a_reader_reads(made):
    for data, rows in zip(made, Scanner(frozenset(range(256))).scan(made), strict=True):
        if rows is None:
            continue
        reader = FrameReader()
        frames = reader.feed(data)
        assert [frame_of(data, row) for row in rows] == frames
        assert len({(each.system_id, each.component_id) for each in frames}) == 1
        assert reader.take_malformed() == 0
        assert reader.is_between_frames


@pytest.mark.parametrize("key", [None, bytes(32)])
def test_of_sound_datagrams_the_wanted_frames_are_found(key):
    encoder = FrameEncoder(VehicleId(200, 2), key)
    messages = (heartbeat(2, 3), raw_imu(1, *[(0.1, 0.2, 0.3)] * 3), attitude(1, *[(0.1,) * 3] * 2))
    data = b"".join(encoder.frame(message, 10**15) for message in messages)
    (rows,) = Scanner(WANTED).scan([data])
    assert [frame_of(data, row) for row in rows] == FrameReader().feed(data)[1:]
    (rows,) = Scanner(frozenset({HEARTBEAT_ID})).scan([data])
    assert [frame_of(data, row).message_id for row in rows] == [HEARTBEAT_ID]


def test_a_datagram_that_is_anything_else_is_left():
    rng = random.Random(1)
    one, other = (FrameEncoder(VehicleId(system, 1)) for system in (1, 2))
    beat = one.frame(heartbeat(2, 3), 0)
    wrong = bytearray(beat)
    wrong[-1] ^= 1
    left = [b"", beat[:-1], beat + b"\0", bytes(wrong), rng.randbytes(40)]
    left.append(beat + other.frame(heartbeat(2, 3), 0))  # of two senders
    assert Scanner(frozenset({0})).scan([*left, beat, left[1]]) == [
        *[None] * len(left),
        [[0, 1, 1, 0, len(beat), 10, 0]],
        None,
    ]
