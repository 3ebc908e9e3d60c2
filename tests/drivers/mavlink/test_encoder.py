"""Our frames, read by pymavlink's own parser."""

import hashlib
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.events import VehicleId
from drivers.mavlink import encoder
from drivers.mavlink.constants import mavlink

UNIX_US = 1_790_000_000_000_000
VEHICLE = VehicleId(7, 1)

floats = st.floats(-1e6, 1e6, width=32)
vectors = st.tuples(floats, floats, floats)
quaternions = st.tuples(floats, floats, floats, floats)
bytes_1 = st.integers(0, 255)
addresses = st.builds(VehicleId, bytes_1, bytes_1)
boot_times = st.integers(0, 2**40)


def parsed(message, **options):
    """The one message that pymavlink reads from a frame of ours."""
    frame = encoder.FrameEncoder(VEHICLE, **options).frame(message, UNIX_US)
    (read,) = mavlink().MAVLink(None).parse_buffer(frame)
    assert read.get_srcSystem() == 7
    assert read.get_srcComponent() == 1
    assert bytes(read.get_msgbuf()) == frame
    return read


def fields(message, *names):
    return tuple(getattr(message, name) for name in names)


@given(boot_times, vectors, vectors, vectors)
def test_raw_imu(boot_us, acc, gyr, mag):
    read = parsed(encoder.raw_imu(boot_us, acc, gyr, mag))
    assert read.get_type() == "RAW_IMU"
    assert read.time_usec == boot_us

    def limited(values):
        return tuple(int(np.clip(np.trunc(v), -32768, 32767)) for v in values)

    # one unit of slack where rounding of the scale decides
    for names, values in (
        (("xacc", "yacc", "zacc"), limited(1000 * v / 9.80665 for v in acc)),
        (("xgyro", "ygyro", "zgyro"), limited(1000 * v for v in gyr)),
        (("xmag", "ymag", "zmag"), limited(1000 * v for v in mag)),
    ):
        assert fields(read, *names) == pytest.approx(values, abs=1)


def test_raw_imu_of_a_level_vehicle_is_what_an_autopilot_sends():
    read = parsed(encoder.raw_imu(5, (0, 0, -9.80665), (0.0014, -0.0016, 0), (0.2, 0, -0.4004)))
    assert fields(read, "xacc", "yacc", "zacc") == (0, 0, -1000)
    assert fields(read, "xgyro", "ygyro", "zgyro") == (1, -1, 0)
    assert fields(read, "xmag", "ymag", "zmag") == (200, 0, -400)


@given(boot_times, vectors, vectors)
def test_attitude(boot_us, euler, rate):
    read = parsed(encoder.attitude(boot_us, euler, rate))
    assert read.get_type() == "ATTITUDE"
    assert read.time_boot_ms == boot_us // 1000 % 2**32
    assert fields(read, "roll", "pitch", "yaw") == euler
    assert fields(read, "rollspeed", "pitchspeed", "yawspeed") == rate


@given(boot_times, quaternions, vectors)
def test_attitude_quaternion(boot_us, q, rate):
    read = parsed(encoder.attitude_quaternion(boot_us, q, rate))
    assert read.get_type() == "ATTITUDE_QUATERNION"
    assert fields(read, "q1", "q2", "q3", "q4") == q
    assert fields(read, "rollspeed", "pitchspeed", "yawspeed") == rate
    assert list(read.repr_offset_q) == [0, 0, 0, 0]


@given(quaternions, vectors, vectors, vectors)
def test_sim_state(q, euler, acc, rate):
    read = parsed(encoder.sim_state(q, euler, acc, rate))
    assert read.get_type() == "SIM_STATE"
    assert fields(read, "q1", "q2", "q3", "q4") == q
    assert fields(read, "roll", "pitch", "yaw") == euler
    assert fields(read, "xacc", "yacc", "zacc") == acc
    assert fields(read, "xgyro", "ygyro", "zgyro") == rate
    assert fields(read, "lat", "alt", "vn", "lat_int", "lon_int") == (0, 0, 0, 0, 0)


def test_sim_state_has_the_place_in_degrees_and_in_whole_parts_of_them():
    place, velocity = (47.5, -8.25, 488.25), (1.25, -2.5, 0.75)
    still = (0.0, 0.0, 0.0)
    read = parsed(encoder.sim_state((1.0, 0.0, 0.0, 0.0), still, still, still, place, velocity))
    assert fields(read, "lat", "lon", "alt") == place
    assert fields(read, "lat_int", "lon_int") == (475_000_000, -82_500_000)
    assert fields(read, "vn", "ve", "vd") == velocity


@given(st.text("ABCDEFGH_0123", min_size=1, max_size=16), floats, st.integers(0, 65535))
def test_param_value(name, value, index):
    read = parsed(encoder.param_value(name, value, 65535, index))
    assert fields(read, "param_id", "param_value", "param_index") == (name, value, index)
    assert fields(read, "param_count", "param_type") == (65535, 9)


@given(addresses, st.integers(0, 65535), st.lists(floats, max_size=7), bytes_1)
def test_command_long(target, command, parameters, confirmation):
    read = parsed(encoder.command_long(target, command, parameters, confirmation))
    assert fields(read, "target_system", "target_component") == target
    assert fields(read, "command", "confirmation") == (command, confirmation)
    sent = tuple(getattr(read, f"param{i}") for i in range(1, 8))
    assert sent == (*parameters, *(7 - len(parameters)) * (0.0,))


@given(addresses, st.integers(0, 65535), bytes_1)
def test_command_ack(target, command, result):
    read = parsed(encoder.command_ack(target, command, result))
    assert fields(read, "command", "result") == (command, result)
    assert fields(read, "target_system", "target_component") == target


def test_heartbeat():
    read = parsed(encoder.heartbeat(18, 8))
    assert fields(read, "type", "autopilot", "system_status") == (18, 8, 4)
    assert read.mavlink_version == 3


def test_sequence_counts_and_wraps():
    frames = encoder.FrameEncoder(VEHICLE)
    message = encoder.heartbeat(2, 3)
    data = b"".join(frames.frame(message, UNIX_US) for _ in range(300))
    messages = mavlink().MAVLink(None).parse_buffer(data)
    assert [m.get_seq() for m in messages] == [i % 256 for i in range(300)]


@settings(max_examples=20)
@given(st.binary(min_size=32, max_size=32), vectors)
def test_signed_frames_pass_with_the_key_and_fail_without(key, euler):
    frames = encoder.FrameEncoder(VEHICLE, key)
    message = encoder.attitude(1, euler, euler)
    data = b"".join(frames.frame(message, UNIX_US) for _ in range(5))  # in one tick of the clock

    def good(with_key):
        receiver = mavlink().MAVLink(None)
        receiver.robust_parsing = True
        receiver.signing.secret_key = with_key
        messages = receiver.parse_buffer(data) or []
        return sum(m.get_type() == "ATTITUDE" for m in messages)

    assert good(key) == 5
    assert good(hashlib.sha256(key).digest()) == 0


def test_key_files():
    key = bytes(range(32))
    assert encoder.signing_key(key) == key
    assert encoder.signing_key(key.hex().encode() + b"\n") == key
    phrase = hashlib.sha256(b"open sesame").digest()
    assert encoder.signing_key(b"open sesame\n") == phrase
    assert encoder.signing_key(b"z" * 64) == hashlib.sha256(b"z" * 64).digest()


def test_raw_imu_saturates():
    parsed(encoder.raw_imu(0, (1e9, -1e9, 0), (math.pi, 0, 0), (0, 0, 0)))


def test_a_signature_counts_tens_of_microseconds_since_2015():
    frames = encoder.FrameEncoder(VEHICLE, bytes(32))
    data = frames.frame(encoder.heartbeat(2, 3), 1_420_070_401_000_000)
    assert int.from_bytes(data[-12:-6], "little") == 100_000


def test_a_global_position_has_heights_upwards_and_velocity_in_ned():
    place = (47.3977419, -8.5455938, 488.25)
    read = parsed(encoder.global_position(3_000_000, place, 12.5, (1.25, -2.5, 0.75)))
    assert fields(read, "time_boot_ms", "lat", "lon") == (3000, 473977419, -85455938)
    assert fields(read, "alt", "relative_alt") == (488_250, 12_500)
    assert fields(read, "vx", "vy", "vz", "hdg") == (125, -250, 75, 65535)


@pytest.mark.parametrize(
    ("length", "parts"), [(0, 1), (49, 1), (50, 1), (51, 2), (99, 2), (100, 3)]
)
def test_a_long_text_goes_in_parts_of_which_a_zero_ends_the_last(length, parts):
    text = "abcdefghij" * 20
    sender = encoder.FrameEncoder(VEHICLE)
    made = encoder.statustexts(text[:length], 4, 9)
    got = mavlink().MAVLink(None).parse_buffer(b"".join(sender.frame(m, UNIX_US) for m in made))
    assert len(got) == parts
    assert "".join(m.text for m in got) == text[:length]
    assert [m.chunk_seq for m in got] == list(range(parts))
    assert {m.id for m in got} == ({0} if parts == 1 else {9})
    assert parts == 1 or len(got[-1].text) < 50
