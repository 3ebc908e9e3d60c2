"""Hostile input, structured: what is nearly right goes deeper than noise does."""

import os
import random
import struct
from pathlib import Path

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from drivers.events import VehicleId
from drivers.mavlink_codec import mavlink
from drivers.mavlink_encoder import FrameEncoder

DATA = Path(__file__).parent.parent / "data"
SCALE = int(os.environ.get("FUZZBEE_FUZZ", "1"))
NAMES = (
    "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3", "HIGHRES_IMU", "ATTITUDE",
    "ATTITUDE_QUATERNION", "SIM_STATE", "SIMSTATE", "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED",
    "GPS_RAW_INT", "PARAM_VALUE", "HEARTBEAT", "COMMAND_ACK", "STATUSTEXT",
)  # fmt: skip
m = mavlink()
KINDS = [kind for kind in m.mavlink_map.values() if kind.msgname in NAMES]


def fuzzed(cases):
    """Settings for ``cases`` cases in the fast run; FUZZBEE_FUZZ multiplies them."""
    return settings(
        max_examples=cases * SCALE,
        deadline=None,
        derandomize=SCALE == 1,
        database=None,
        suppress_health_check=list(HealthCheck),
    )


def _numbers(size):
    """Bytes that are extreme as integers and as floats, zeros, or anything."""
    extremes = [
        b"\0" * 8, b"\xff" * 8, b"\x80" + b"\0" * 7, b"\x7f" * 8,
        struct.pack("<f", float("nan")) * 2,
        struct.pack("<f", float("inf")) * 2, struct.pack("<f", -3.4e38) * 2,
        struct.pack("<f", 1e-45) * 2,
    ]  # fmt: skip
    chunk = st.one_of(st.sampled_from(extremes), st.binary(min_size=8, max_size=8))
    chunks = size // 8 + 1
    return st.lists(chunk, min_size=chunks, max_size=chunks).map(lambda c: b"".join(c)[:size])


@st.composite
def frames(draw):
    """A frame with a sound checksum: any payload, often cut, of a message that is read."""
    kind = draw(st.sampled_from(KINDS))
    payload = draw(_numbers(kind.unpacker.size))
    if kind.msgname.endswith("IMU") and draw(st.booleans()):  # a time that goes on
        stamp = draw(st.integers(0, 5)) * 10_000 + draw(st.sampled_from([0, 2**32 - 20_000]))
        payload = stamp.to_bytes(8, "little") + payload[8:]
    payload = payload[: draw(st.integers(1, len(payload)))]
    sender = VehicleId(
        draw(st.sampled_from([1, 1, 1, 2, 0, 255])), draw(st.sampled_from([1, 1, 0]))
    )
    body = FrameEncoder(sender)
    from drivers.mavlink_encoder import Message

    data = body.frame(Message(kind.id, kind.crc_extra, payload), 0)
    if draw(st.booleans()):
        return data
    return bytes(kind_v1(kind, payload, sender)) if kind.id < 256 else data


def kind_v1(kind, payload, sender):
    """The frame as MAVLink 1."""
    from fastcrc import crc16

    body = bytes((len(payload), 0, *sender, kind.id)) + payload
    return b"\xfe" + body + struct.pack("<H", crc16.mcrf4xx(body + bytes((kind.crc_extra,))))


@st.composite
def damaged(draw, data):
    """``data`` with bits flipped, pieces cut out, repeated or put in."""
    data = bytearray(data)
    rng = random.Random(draw(st.integers(0, 2**32)))
    for _ in range(draw(st.integers(0, 12))):
        if not data:
            break
        at = rng.randrange(len(data))
        match rng.randrange(5):
            case 0:
                data[at] ^= 1 << rng.randrange(8)
            case 1:
                data[at] = rng.choice((0, 0xFF, 0x80, 0xFD, 0xFE))
            case 2:
                del data[at : at + rng.randrange(1, 64)]
            case 3:
                data[at:at] = data[at : at + rng.randrange(1, 64)]
            case 4:
                data[at:at] = rng.randbytes(rng.randrange(1, 64))
    return bytes(data)


def streams():
    """Frames, damaged ones and noise, one behind the other."""
    part = st.one_of(
        frames(),
        frames().flatmap(damaged),
        st.binary(max_size=60),
    )
    return st.lists(part, max_size=12)


def clip(name, size):
    """The first bytes of a recording of tests/data."""
    return (DATA / name).read_bytes()[:size]
