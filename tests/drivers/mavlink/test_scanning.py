"""What compiled code finds in datagrams is what the reader of any bytes makes of them."""

import random

import numba
import pytest
from hypothesis import given

from drivers.events import VehicleId
from drivers.mavlink.constants import ATTITUDE_ID, HEARTBEAT_ID, RAW_IMU_ID
from drivers.mavlink.encoder import FrameEncoder, attitude, heartbeat, raw_imu
from drivers.mavlink.framing import FrameReader
from drivers.mavlink.scanning import LEFT, Scanner
from drivers.mavlink.transports.datagrams import Datagrams
from drivers.mavlink.transports.transport import Packet
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


def scan(wanted, made):
    return Scanner(wanted).scan(Datagrams.of([Packet("a", data) for data in made], 1))


def found(wanted, made):
    """The frames of each datagram, None of one that is left."""
    scanned = scan(wanted, made)
    return [None if n == LEFT else scanned.frames(k) for k, n in enumerate(scanned.counts)]


@fuzzed(300, 20_000)
@given(made=built(datagrams))
def test_what_is_found_is_what_a_reader_reads(made):
    for data, rows in zip(made, found(frozenset(range(256)), made), strict=True):
        if rows is None:
            continue
        reader = FrameReader()
        frames = reader.feed(data)
        assert rows == frames
        assert len({(each.system_id, each.component_id) for each in frames}) == 1
        assert reader.take_malformed() == 0
        assert reader.is_between_frames


@pytest.mark.parametrize("key", [None, bytes(32)])
def test_of_sound_datagrams_the_wanted_frames_are_found(key):
    encoder = FrameEncoder(VehicleId(200, 2), key)
    messages = (heartbeat(2, 3), raw_imu(1, *[(0.1, 0.2, 0.3)] * 3), attitude(1, *[(0.1,) * 3] * 2))
    data = b"".join(encoder.frame(message, 10**15) for message in messages)
    (frames,) = found(WANTED, [data])
    assert frames == FrameReader().feed(data)[1:]
    assert scan(WANTED, [b"", data]).senders.tolist() == [0, 200 << 8 | 2]
    unwanted = scan(frozenset(), [data])  # which is still known to be sound, and whose it is
    assert (unwanted.counts.tolist(), unwanted.senders.tolist()) == ([0], [200 << 8 | 2])
    (frames,) = found(frozenset({HEARTBEAT_ID}), [data])
    assert [frame.message_id for frame in frames] == [HEARTBEAT_ID]


def test_a_datagram_that_is_anything_else_is_left():
    rng = random.Random(1)
    one, other = (FrameEncoder(VehicleId(system, 1)) for system in (1, 2))
    beat = one.frame(heartbeat(2, 3), 0)
    wrong = bytearray(beat)
    wrong[-1] ^= 1
    left = [b"", beat[:-1], beat + b"\0", bytes(wrong), rng.randbytes(40)]
    left.append(beat + other.frame(heartbeat(2, 3), 0))  # of two senders
    assert found(frozenset({0}), [*left, beat, left[1]]) == [
        *[None] * len(left),
        FrameReader().feed(beat),
        None,
    ]
