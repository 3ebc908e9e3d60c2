"""Hostile input, structured: what is nearly right goes deeper than noise does.

A case is built by plain functions of a ``random.Random``, whose seed is what hypothesis draws:
drawing every byte through it would take ten times as long as parsing them.
"""

import os
import random
import struct
from pathlib import Path

from fastcrc import crc16
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from drivers.events import VehicleId
from drivers.mavlink_codec import mavlink
from drivers.mavlink_encoder import FrameEncoder, Message

DATA = Path(__file__).parent.parent / "data"
IS_LONG = bool(os.environ.get("FUZZBEE_FUZZ_LONG"))
NAMES = (
    "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3", "HIGHRES_IMU", "ATTITUDE",
    "ATTITUDE_QUATERNION", "SIM_STATE", "SIMSTATE", "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED",
    "GPS_RAW_INT", "PARAM_VALUE", "HEARTBEAT", "COMMAND_ACK", "STATUSTEXT",
)  # fmt: skip
m = mavlink()
KINDS = [kind for kind in m.mavlink_map.values() if kind.msgname in NAMES]


EXTREMES = [
    b"\0" * 8,
    b"\xff" * 8,
    b"\x80" + b"\0" * 7,
    b"\x7f" * 8,
    *(struct.pack("<f", value) * 2 for value in (float("nan"), float("inf"), -3.4e38, 1e-45)),
]


def fuzzed(fast, long):
    """Settings: so many cases each time, so many, and other ones, with FUZZBEE_FUZZ_LONG=1."""
    return settings(
        max_examples=long if IS_LONG else fast,
        deadline=None,
        derandomize=not IS_LONG,
        database=None,
        suppress_health_check=list(HealthCheck),
    )


def built(build):
    """What ``build`` makes of a random generator."""
    return st.integers(0, 2**64 - 1).map(lambda seed: build(random.Random(seed)))


def damaged(content):
    """``content`` with bits flipped, pieces cut out, repeated or put in."""
    return built(lambda rng: damage(content, rng))


def damage(content, rng):
    """See ``damaged``."""
    data = bytearray(content)
    for _ in range(rng.randrange(12)):
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


def frame(rng):
    """A frame with a sound checksum: any payload, often cut, of a message that is read."""
    kind = rng.choice(KINDS)
    size = kind.unpacker.size
    chunks = [
        rng.choice(EXTREMES) if rng.random() < 0.5 else rng.randbytes(8)
        for _ in range(size // 8 + 1)
    ]
    payload = b"".join(chunks)[:size]
    if "IMU" in kind.msgname and rng.random() < 0.7:  # a time that goes on, or wraps
        stamp = rng.randrange(6) * 10_000 + rng.choice((0, 0, 2**32 - 20_000))
        payload = stamp.to_bytes(8, "little") + payload[8:]
    if rng.random() < 0.3:
        payload = payload[: rng.randint(1, len(payload))]
    sender = VehicleId(rng.choice((1, 1, 1, 2, 0, 255)), rng.choice((1, 1, 0)))
    if kind.id < 256 and rng.random() < 0.5:
        return frame_v1(kind, payload, sender)
    return FrameEncoder(sender).frame(Message(kind.id, kind.crc_extra, payload), 0)


def frame_v1(kind, payload, sender):
    """The frame as MAVLink 1."""
    body = bytes((len(payload), 0, *sender, kind.id)) + payload
    return b"\xfe" + body + struct.pack("<H", crc16.mcrf4xx(body + bytes((kind.crc_extra,))))


def stream(rng):
    """Frames, damaged ones and noise, one behind the other."""
    parts = []
    for _ in range(rng.randrange(12)):
        part = frame(rng) if rng.random() < 0.85 else rng.randbytes(rng.randrange(60))
        parts.append(damage(part, rng) if rng.random() < 0.3 else part)
    return parts


def clip(name, size):
    """The first bytes of a recording of tests/data."""
    return (DATA / name).read_bytes()[:size]
