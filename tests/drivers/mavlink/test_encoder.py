"""Our frames, read by pymavlink's own parser."""

import hashlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.events import VehicleId
from drivers.mavlink import encoder
from tests.drivers.mavlink.messages import UNIX, m

VEHICLE = VehicleId(7, 1)

floats = st.floats(-1e6, 1e6, width=32)
vectors = st.tuples(floats, floats, floats)
quaternions = st.tuples(floats, floats, floats, floats)
bytes_1 = st.integers(0, 255)
addresses = st.builds(VehicleId, bytes_1, bytes_1)
boot_times = st.integers(0, 2**44)  # milliseconds begin anew after seven weeks


THEIRS = {"global_position": "global_position_int", "message_interval_request": "command_long"}


@given(boot_times, quaternions, vectors, vectors, addresses, bytes_1)
def test_frames_are_those_that_pymavlink_packs(boot_us, q, a, b, target, number):
    """Places in degrees and in whole parts of them, heights upwards, velocity in NED."""
    boot_ms, cov = boot_us // 1000 % 2**32, (1.5, 0, 0, 0, 2.5, 0, 0, 0, 3.5)
    place, whole = (47.5, -8.25, 488.25), (475_000_000, -82_500_000)
    sent, name = (boot_us, place, 12.5, (1.25, -2.5, 0.75)), "ABCDEFGH_0123456"
    readings = (0, 1e9, -9.80665), (0.0014, -0.0016, 0), (0.2, 0, -0.4004)
    for kind, ours, theirs in (
        # a level vehicle's, cut towards zero, and one that is beyond what a field holds
        ("raw_imu", (boot_us, *readings), (boot_us, 0, 32767, -1000, 1, -1, 0, 200, 0, -400)),
        ("attitude", (boot_us, a, b), (boot_ms, *a, *b)),
        ("attitude_quaternion", (boot_us, q, a), (boot_ms, *q, *a)),
        ("attitude_quaternion_cov", (boot_us, q, a, (1.5, 2.5, 3.5)), (boot_us, q, *a, cov)),
        ("sim_state", (q, a, b, a, place, b), (*q, *a, *b, *a, *place, 0, 0, *b, *whole)),
        ("global_position", sent, (boot_ms, *whole, 488_250, 12_500, 125, -250, 75, 65535)),
        ("param_value", (name, a[0], 65535, number), (name.encode(), a[0], 9, 65535, number)),
        ("message_interval_request", (target, 27, a[0], number),
         (*target, 511, number, 27, a[0], 0, 0, 0, 0, 0)),
        ("command_ack", (target, 511, number), (511, number, 0, 0, *target)),
        ("heartbeat", (number, 8), (number, 8, 0, 0, 4, 3)),
    ):  # fmt: skip
        frame = encoder.FrameEncoder(VEHICLE).frame(getattr(encoder, kind)(*ours), UNIX)
        message = getattr(m, f"MAVLink_{THEIRS.get(kind, kind)}_message")(*theirs)
        assert frame == bytes(message.pack(m.MAVLink(None, *VEHICLE)))


def test_key_files():
    key = bytes(range(32))
    assert encoder.signing_key(key) == key
    assert encoder.signing_key(key.hex().encode() + b"\n") == key
    phrase = hashlib.sha256(b"open sesame").digest()
    assert encoder.signing_key(b"open sesame\n") == phrase
    assert encoder.signing_key(b"z" * 64) == hashlib.sha256(b"z" * 64).digest()


@pytest.mark.parametrize(
    ("length", "parts"), [(0, 1), (49, 1), (50, 1), (51, 2), (99, 2), (100, 3)]
)
def test_a_long_text_goes_in_parts_of_which_a_zero_ends_the_last(length, parts):
    text = "abcdefghij" * 20
    sender = encoder.FrameEncoder(VEHICLE)
    made = encoder.statustexts(text[:length], 4, 9)
    got = m.MAVLink(None).parse_buffer(b"".join(sender.frame(each, UNIX) for each in made))
    assert len(got) == parts
    assert "".join(each.text for each in got) == text[:length]
    assert [each.chunk_seq for each in got] == list(range(parts))
    assert {each.id for each in got} == ({0} if parts == 1 else {9})
    assert parts == 1 or len(got[-1].text) < 50
