"""Hostile input made by a ``random.Random``: what is nearly right goes deeper than noise."""

import math
import os
import random
import struct
from pathlib import Path

import msgspec
from fastcrc import crc16
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from pymavlink.DFReader import FORMAT_TO_STRUCT

from drivers.events import VehicleId
from drivers.logs.ulog_format import CODES, FIELD
from drivers.mavlink.constants import mavlink
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.encoder import FrameEncoder, Message
from service.records import AttitudeRecord, Published, StatusRecord
from tests.drivers.logs.writers import DataflashWriter, UlogWriter

DATA = Path(__file__).parent.parent / "data"
IS_LONG = bool(os.environ.get("FUZZBEE_FUZZ_LONG"))
KINDS = [mavlink().mavlink_map[number] for number in sorted(MavlinkDecoder(texts=True).wanted)]
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
    """A strategy of what ``build`` makes of a random generator."""
    return st.integers(0, 2**64 - 1).map(lambda seed: build(random.Random(seed)))


def damage(content, rng):
    """``content`` with bits flipped, pieces cut out, repeated or put in."""
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
    body = bytes((len(payload), 0, *sender, kind.id)) + payload
    return b"\xfe" + body + struct.pack("<H", crc16.mcrf4xx(body + bytes((kind.crc_extra,))))


def stream(rng):
    """Frames, damaged ones and noise, one behind the other."""
    parts = []
    for _ in range(rng.randrange(12)):
        part = frame(rng) if rng.random() < 0.85 else rng.randbytes(rng.randrange(60))
        parts.append(damage(part, rng) if rng.random() < 0.3 else part)
    return parts


def extreme(code, rng):
    """A value of a ``struct`` format character, ordinary or at its end."""
    if code in "fd":
        return rng.choice(FLOATS) if rng.random() < 0.05 else rng.choice((rng.gauss(0.0, 5.0), 0.5))
    if code == "?":
        return rng.random() < 0.8
    bits = 8 * struct.calcsize("<" + code)
    low, high = (0, 2**bits - 1) if code.isupper() else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return rng.choice((low, high, 0, 1, rng.randint(low, high), min(high, rng.randrange(1000))))


FLOATS = (math.nan, math.inf, -math.inf, 3e38, -3e38, 1e-40, 0.0)

DATAFLASH_COLUMNS = {
    "IMU": "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ",
    "IMU2": "TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ",
    "MAG": "TimeUS,I,MagX,MagY,MagZ",
    "ATT": "TimeUS,Roll,Pitch,Yaw",
    "XKQ": "TimeUS,C,Q1,Q2,Q3,Q4",
    "XKF1": "TimeUS,C,VN,VE,VD",
    "GPS": "TimeUS,I,Status,GMS,GWk,Lat,Lng,Alt,Spd,GCrs,VZ",
    "PARM": "TimeUS,Name,Value",
    "MSG": "TimeUS,Message",
    "SIM": "TimeUS,Roll,Pitch,Yaw",
}


def dataflash_formats(rng):
    """A sound DataFlash log of messages with any types of fields, and any values."""
    log, formats = DataflashWriter(), {}
    for name, columns in DATAFLASH_COLUMNS.items():
        codes = "".join(
            rng.choice("bBhHiIfdqQcCeELMgnNZa" if rng.random() < 0.3 else "ffQ")
            for _ in columns.split(",")
        )
        codes = ("Q" if rng.random() < 0.8 else codes[0]) + codes[1:]
        formats[name] = [FORMAT_TO_STRUCT[code][0] for code in codes]
        if 3 + struct.calcsize("<" + "".join(formats[name])) > 255:
            del formats[name]
        else:
            log.format(name, codes, columns)
    for row in range(rng.randrange(60)):
        name = rng.choice([*formats, *[*formats][:1] * 5])
        stored = [dataflash_value(code, rng) for code in formats[name]]
        if formats[name][0] == "Q" and rng.random() < 0.8:
            stored[0] = 1_000_000 + 20_000 * row
        log.store(name, *stored)
    return log.data


def dataflash_value(code, rng):
    """A value as it is stored, by its ``struct`` format."""
    if code[-1] == "s":
        return rng.choice(TEXTS)
    return rng.gauss(0.0, 5.0) if code == "e" else extreme(code, rng)


TEXTS = (b"SYSID_THISMAV", b"ArduCopter V4.5", b"\xff\xfe\x80", b"", b"MAV_SYSID", b"9" * 64)

ULOG_FIELDS = {
    "sensor_combined": "float[3] gyro_rad;float[3] accelerometer_m_s2;",
    "vehicle_imu": "float[3] delta_angle;float[3] delta_velocity;uint32_t delta_angle_dt;"
    "uint16_t delta_velocity_dt;",
    "vehicle_magnetometer": "float[3] magnetometer_ga;",
    "sensor_mag": "float x;float y;float z;",
    "vehicle_attitude": "float[4] q;",
    "vehicle_attitude_groundtruth": "float[4] q;",
    "vehicle_local_position": "float vx;float vy;float vz;bool v_xy_valid;bool v_z_valid;",
    "vehicle_gps_position": "uint64_t time_utc_usec;int32_t lat;int32_t lon;int32_t alt;"
    "float s_variance_m_s;float vel_n_m_s;float vel_e_m_s;float vel_d_m_s;uint8_t fix_type;",
    "sensor_gps": "uint64_t time_utc_usec;double latitude_deg;double longitude_deg;"
    "double altitude_msl_m;float vel_n_m_s;float vel_e_m_s;float vel_d_m_s;uint8_t fix_type;",
}


def ulog_formats(rng):
    """A sound ULog of topics whose fields may have any type, and any values."""
    log, topics = UlogWriter(), []
    for number, (name, fields) in enumerate(ULOG_FIELDS.items()):
        text = rng.choice(("", "uint64_t timestamp_sample;")) + fields.rstrip(";")
        if rng.random() < 0.2:
            text = text.replace("float", rng.choice(("double", "char", "int8_t", "other")))
        if rng.random() < 0.1:
            text = text.replace("[3]", rng.choice(("[2]", "[0]", "", "[300]", "[99999]")))
        log.topic(number, name, text)
        topics.append((number, [FIELD.fullmatch(each) for each in text.split(";")]))
    log.write(b"F", b"other:uint8_t a;uint8_t[3] b;")
    for k in range(rng.randrange(4)):
        number = struct.pack("<i", rng.choice((k, -1, 300)))
        log.write(b"P", b"\x12int32_t MAV_SYS_ID" + number)
    for row in range(rng.randrange(60)):
        number, fields = rng.choice([*topics, *topics[:1] * 5])
        time_us = 1_000_000 + 5000 * row if rng.random() < 0.9 else rng.getrandbits(64)
        body = struct.pack("<HQ", number, time_us)
        for kind, elements, _ in (each.groups() for each in fields):
            for _ in range(min(int(elements or 1), 400)):
                if kind in ("other", "char"):
                    body += rng.randbytes(4 if kind == "other" else 1)
                else:
                    body += struct.pack("<" + CODES[kind], extreme(CODES[kind], rng))
        log.write(b"D", body)
    return log.data


def rearranged(content, rng):
    """A recording as disks, radios and people leave it: cut, in another order, twice."""
    match rng.randrange(6):
        case 0:
            return content[: rng.randrange(len(content))]
        case 1:
            return content[rng.randrange(len(content)) :]
        case 2:
            blocks = [content[at : at + 4096] for at in range(0, len(content), 4096)]
            first, second = rng.randrange(len(blocks)), rng.randrange(len(blocks))
            blocks[first], blocks[second] = blocks[second], blocks[first]
            return b"".join(blocks)
        case 3:
            return content + content[rng.randrange(len(content)) :]
        case 4:
            at, size = rng.randrange(len(content)), rng.randrange(1, 8192)
            return content[:at] + rng.choice((b"\0", b"\xff")) * size + content[at + size :]
        case _:
            data = bytearray(content)
            for _ in range(rng.randrange(1, 200)):
                data[rng.randrange(min(len(data), 20_000))] ^= 1 << rng.randrange(8)
            return bytes(data)


def clip(name, size):
    """The first bytes of a recording of tests/data."""
    return (DATA / name).read_bytes()[:size]


def assert_finite(value):
    assert not isinstance(value, float) or math.isfinite(value)
    if isinstance(value, dict | list | tuple):
        for each in value.values() if isinstance(value, dict) else value:
            assert_finite(each)


def require_sound(outputs):
    """All numbers are finite, attitudes are unit to the last figure; how many there are."""
    records = [output.record for output in outputs if isinstance(output, Published)]
    attitudes = [record for record in records if isinstance(record, AttitudeRecord)]
    for record in records:
        assert_finite(msgspec.to_builtins(record))
    assert all(abs(math.hypot(*each.q_ned_frd) - 1.0) < 1e-6 for each in attitudes)
    assert all(isinstance(record, AttitudeRecord | StatusRecord) for record in records)
    return len(attitudes)
