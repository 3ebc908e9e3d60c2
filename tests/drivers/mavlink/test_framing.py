"""Frames and IMU messages of our own reading, against pymavlink's on the same bytes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.events import VehicleId
from drivers.mavlink.decoder import FrameParser, MavlinkDecoder
from drivers.mavlink.dialect import mavlink
from drivers.mavlink.encoder import FrameEncoder, raw_imu
from drivers.mavlink.frame_decoder import FrameDecoder
from drivers.mavlink.framing import Frame, FrameReader
from drivers.mavlink.imu_messages import imu_message
from tests.drivers.mavlink.test_decoder import TABLE, UNIX, S, frame
from tests.drivers.mavlink.test_decoder import raw_imu as packed_raw_imu

m = mavlink()
GOOD = [frame(message, force_mavlink1=v1) for message, _ in TABLE for v1 in (False, True)]
int16 = st.integers(-32768, 32767)
float32 = st.floats(width=32)


def read(data):
    return FrameReader().feed(data)


def reference(data):
    return [bytes(message.get_msgbuf()) for message in FrameParser().feed(data)]


@given(st.data())
def test_a_stream_may_be_cut_anywhere(data):
    stream, reader, seen = b"".join(GOOD), FrameReader(), []
    position = 0
    while position < len(stream):
        step = data.draw(st.integers(1, 400))
        seen += reader.feed(stream[position : position + step])
        position += step
    assert [each.data for each in seen] == GOOD
    assert reader.take_malformed() == 0


@given(st.lists(st.one_of(st.sampled_from(GOOD), st.binary(max_size=40)), max_size=12))
def test_every_frame_that_pymavlink_reads_is_read(parts):
    data = b"".join(parts)
    reader = FrameReader()
    ours = [each.data for each in reader.feed(data + bytes(280))]
    known = [each for each in reference(data + bytes(280)) if _is_known(each)]
    assert [each for each in ours if _is_known(each)] == known


def _is_known(data):
    number = data[5] if data[0] == 0xFE else int.from_bytes(data[7:10], "little")
    return number in m.mavlink_map


def test_a_damaged_frame_is_counted_once_and_costs_itself_alone():
    damaged = bytearray(GOOD[0])
    damaged[-1] ^= 0x10
    reader = FrameReader()
    frames = reader.feed(GOOD[2] + bytes(damaged) + GOOD[4])
    assert [each.data for each in frames] == [GOOD[2], GOOD[4]]
    assert reader.take_malformed() == 1


def test_a_damaged_length_does_not_swallow_what_follows():
    damaged = bytearray(GOOD[0])
    damaged[1] = 255
    frames = FrameReader().feed(bytes(damaged) + b"".join(GOOD) * 4)
    assert [each.data for each in frames] == GOOD * 4


def test_frames_with_unknown_incompatibility_flags_are_refused():
    strange = bytearray(GOOD[0])
    strange[2] = 0x02
    reader = FrameReader()
    assert reader.feed(bytes(strange) + GOOD[2])[0].data == GOOD[2]
    assert reader.take_malformed() == 1


def test_an_unknown_message_counts_if_another_frame_or_nothing_follows():
    unknown = b"\xfd\x01\x00\x00\x00\x01\x01\xff\xff\xff\x00\x00\x00"
    assert [each.data for each in read(unknown + GOOD[0])] == [unknown, GOOD[0]]
    assert [each.data for each in read(unknown)] == [unknown]
    assert [each.data for each in read(unknown + b"\x00" + GOOD[0])] == [GOOD[0]]


def test_at_most_one_frame_is_kept():
    reader = FrameReader()
    for _ in range(1000):
        reader.feed(b"\xfd\xff\x00" + bytes(100))
        assert len(reader._rest) <= 280


def test_a_signed_frame_knows_where_its_payload_ends():
    encoder = FrameEncoder(VehicleId(7, 1), bytes(32))
    data = encoder.frame(raw_imu(S, (0, 0, -9.8), (0, 0, 0), (0.2, 0, 0.4)), UNIX)
    (each,) = read(data)
    assert (each.system_id, each.is_signed, each.data) == (7, True, data)
    assert each.data[each.payload_at : each.payload_end].rstrip(b"\0") == data[10:-15]


IMU_MESSAGES = st.one_of(
    st.builds(
        m.MAVLink_raw_imu_message,
        st.integers(0, 2**64 - 1),
        *[int16] * 9,
        st.integers(0, 255),
        int16,
    ),
    *(
        st.builds(kind, st.integers(0, 2**32 - 1), *[int16] * 10)
        for kind in (
            m.MAVLink_scaled_imu_message,
            m.MAVLink_scaled_imu2_message,
            m.MAVLink_scaled_imu3_message,
        )
    ),
    st.builds(
        m.MAVLink_highres_imu_message,
        st.integers(0, 2**64 - 1),
        *[float32] * 13,
        st.integers(0, 65535),
        st.integers(0, 255),
    ),
)


@given(IMU_MESSAGES, st.booleans())
def test_imu_fields_are_pymavlinks(message, v1):
    data = frame(message, force_mavlink1=v1)
    (each,) = read(data)
    name, fields = imu_message(each)
    expected = FrameParser().frame(data)
    assert name == expected.get_type()
    for field in fields._fields:
        assert repr(getattr(fields, field)) == repr(getattr(expected, field))


@pytest.mark.parametrize("force_mavlink1", [False, True], ids=["v2", "v1"])
@pytest.mark.parametrize(("message", "expected"), TABLE, ids=lambda x: type(x).__name__)
def test_the_events_are_those_of_pymavlinks_messages(message, expected, force_mavlink1):
    ours, theirs, parser = FrameDecoder(), MavlinkDecoder(), FrameParser()
    for data in (frame(packed_raw_imu(S)), frame(message, force_mavlink1=force_mavlink1)):
        (each,) = read(data)
        assert ours.events(each, UNIX) == theirs.decode(parser.frame(data), UNIX)


def test_attitudes_of_others_may_be_left_out():
    decoder = FrameDecoder(references=False)
    events = [event for data in GOOD for each in read(data) for event in decoder.events(each, UNIX)]
    kinds = {type(event).__name__ for event in events}
    assert "Imu" in kinds
    assert "ReferenceAttitude" not in kinds


def test_a_second_imu_in_the_same_message_is_another_stream():
    message = m.MAVLink_raw_imu_message(S, 0, 0, -1000, 0, 0, 0, 200, 0, 400, 2)
    (each,) = read(frame(message))
    (event,) = FrameDecoder().events(each, UNIX)
    assert event.message == "RAW_IMU:2"
    assert isinstance(each, Frame)
