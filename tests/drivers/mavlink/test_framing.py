"""Frames and IMU messages of our own reading, against pymavlink's on the same bytes."""

import re
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.events import Imu, ReferenceAttitude
from drivers.mavlink import framing
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.framing import FrameFormat, FrameReader, frame_end
from drivers.samples.intake import ATTITUDE_EVERY_US
from tests.drivers.mavlink.messages import UNIX, PymavlinkParser, frame, m, only
from tests.drivers.mavlink.test_decoder import TABLE

GOOD = [frame(message, force_mavlink1=v1) for message, _ in TABLE for v1 in (False, True)]


def read(data):
    return FrameReader().feed(data)


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
    theirs = [bytes(each.get_msgbuf()) for each in PymavlinkParser().feed(data + bytes(280))]
    known = [each for each in theirs if _is_known(each)]
    assert [each for each in ours if _is_known(each)] == known


def _is_known(data):
    number = data[5] if data[0] == 0xFE else int.from_bytes(data[7:10], "little")
    return number in m.mavlink_map


def changed(byte, change):
    """The first frame with another byte there."""
    data = bytearray(GOOD[0])
    data[byte] = change(data[byte])
    return bytes(data)


BAD, UNKNOWN = changed(-1, lambda b: b ^ 0x10), b"\xfd\1\0\0\0\1\1\xff\xff\xff\0\0\0"
# what comes, the frames in it, and how many unreadable stretches are counted
STREAMS = {
    "a damaged frame": ([GOOD[2], BAD, GOOD[4]], [GOOD[2], GOOD[4]], 1),
    "each damaged stretch": (
        [*[BAD, GOOD[2]] * 3, BAD, BAD, GOOD[4]],
        [*[GOOD[2]] * 3, GOOD[4]],
        4,
    ),
    "a damaged length": ([changed(1, lambda _: 255), *GOOD * 4], GOOD * 4, 1),
    "unknown incompatibility flags": ([changed(2, lambda _: 2), GOOD[2]], [GOOD[2]], 1),
    "an unknown message before a frame": ([UNKNOWN, GOOD[0]], [UNKNOWN, GOOD[0]], 0),
    "an unknown message at the end": ([UNKNOWN], [UNKNOWN], 0),
    "an unknown message before noise": ([UNKNOWN, b"\0", GOOD[0]], [GOOD[0]], 1),
}


@pytest.mark.parametrize(("parts", "frames", "malformed"), STREAMS.values(), ids=STREAMS)
def test_what_is_unreadable_costs_itself_alone(parts, frames, malformed):
    reader = FrameReader()
    assert [each.data for each in reader.feed(b"".join(parts))] == frames
    assert reader.take_malformed() == malformed


@given(st.lists(st.binary(max_size=40), min_size=8, max_size=8))
def test_garbage_between_frames_costs_no_frame(garbage):
    """Not even garbage that begins like a frame and has a large length: at most one is kept."""
    stream = b"".join(junk + good for junk, good in zip(garbage, GOOD[:8], strict=True))
    tail = GOOD[0] * 20  # what a false start at the end still waits for
    reader = FrameReader()
    seen = [each.data for each in reader.feed(stream + tail) if _is_known(each.data)]
    assert [data for data in seen if data in GOOD[:8]][:8] == GOOD[:8]
    assert (reader.take_malformed() > 0) == any(garbage)
    assert reader.take_malformed() == 0
    for _ in range(20):
        reader.feed(b"\xfd\xff\x00" + bytes(100))
        assert len(reader._rest) <= 280


def test_a_frame_with_a_flag_that_nobody_knows_has_no_end():
    assert frame_end(b"\xfd\x01\x02" + bytes(20), 0) is None


def test_in_a_log_an_unknown_message_counts_if_a_record_or_nothing_follows():
    stamp, frames, end = bytes(8), FrameFormat(gap=8), len(UNKNOWN)
    for follower, counts in ((stamp + GOOD[0], True), (b"", True), (GOOD[0], False)):
        assert (frames.frame(UNKNOWN + follower, 0, end) is not None) == counts
    frame_at = frames.next_start(UNKNOWN + stamp + GOOD[0], 0)
    assert frame_at == end + len(stamp)  # of an unknown message it is not sure that it is one


TYPES = {"float": st.floats(width=32)}
for bits in (8, 16, 32, 64):
    TYPES[f"uint{bits}_t"] = st.integers(0, 2**bits - 1)
    TYPES[f"int{bits}_t"] = st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
FREQUENT = st.one_of(
    st.builds(kind, *(TYPES[each] for each in kind.fieldtypes))
    for kind in (m.mavlink_map[number] for number in (26, 27, 30, 32, 33, 105, 116, 129))
)


@given(FREQUENT, st.booleans())
def test_fields_of_frequent_messages_are_pymavlinks(message, v1):
    data = frame(message, force_mavlink1=v1)
    (each,) = read(data)
    ours, theirs = framing.fields(each), framing.parsed(data)
    assert type(ours).__name__ == theirs.get_type()
    for field in ours._fields:
        assert repr(getattr(ours, field)) == repr(getattr(theirs, field))


def test_of_attitudes_of_others_a_few_a_second_may_be_enough():
    """To compare ours with; a simulator's truth is none of them."""
    decoder = MavlinkDecoder(references=False)
    events = [event for data in GOOD for each in read(data) for event in decoder.events(each, UNIX)]
    others = only(ReferenceAttitude, events)
    assert only(Imu, events)
    assert {event.source for event in others} == {"autopilot"}
    arrivals_us = sorted({event.arrival_us for event in others})
    assert len(others) == len({(event.vehicle, event.arrival_us) for event in others})
    assert min(np.diff(arrivals_us), default=ATTITUDE_EVERY_US) >= ATTITUDE_EVERY_US


@given(st.lists(st.sampled_from(b"\xfd\xfe\0\0\0\0\xff")).map(bytes), st.integers(0, 9))
def test_no_marker_is_passed_over(data, position):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(framing, "_STRETCH", 5)
        found = list(framing._markers(data, position))
    assert found == [k for k in range(position, len(data)) if data[k] in b"\xfd\xfe"]


def test_a_hole_is_passed_over_at_the_speed_of_memory():

    def best_of_five(search):
        times = []
        for _ in range(5):
            begun = time.process_time()
            assert search() is None
            times.append(time.process_time() - begun)
        return min(times)

    hole = bytes(1 << 24)
    plain = best_of_five(lambda: re.search(rb"[\xfd\xfe]", hole))
    assert best_of_five(lambda: FrameFormat().next_start(hole, 0)) < plain / 4
