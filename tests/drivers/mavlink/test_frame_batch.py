from hypothesis import given
from hypothesis import strategies as st

from drivers.events import VehicleId
from drivers.mavlink.backlog import Arrived
from drivers.mavlink.encoder import FrameEncoder, heartbeat, param_value, raw_imu
from drivers.mavlink.frame_batch import frame_count, pack_frames, unpack_frames
from drivers.mavlink.framing import FrameReader
from estimator.types import ZERO_VEC3

MESSAGES = [
    heartbeat(2, 3),
    raw_imu(1_000_000, (0.0, 0.0, -9.8), ZERO_VEC3, (0.2, 0.0, 0.4)),
    param_value("COMPASS_OFS_X", 12.0, 900, 3),
]


def arrived_frames(choices, key=None):
    """Frames as a link reads them."""
    arrived = []
    encoder = FrameEncoder(VehicleId(7, 1), key)
    for number, (choice, arrival_us) in enumerate(choices):
        data = encoder.frame(MESSAGES[choice % len(MESSAGES)], 1_700_000_000_000_000 + number)
        arrived += [Arrived(arrival_us, frame) for frame in FrameReader().feed(data)]
    return arrived


@given(
    st.lists(st.tuples(st.integers(0, 2), st.integers(0, 2**63)), max_size=8),
    st.sampled_from([None, bytes(range(32))]),
)
def test_a_batch_gives_back_what_was_packed(choices, key):
    arrived = arrived_frames(choices, key)
    batch = pack_frames(arrived)
    assert len(arrived) == len(choices)
    assert unpack_frames(batch) == arrived
    assert frame_count(batch) == len(choices)


def test_frames_of_mavlink_1_too():
    payload = bytes(9)
    from fastcrc import crc16

    body = bytes((len(payload), 0, 1, 1, 0)) + payload
    crc = crc16.mcrf4xx(body + bytes((50,)))
    [frame] = FrameReader().feed(b"\xfe" + body + crc.to_bytes(2, "little"))
    assert unpack_frames(pack_frames([Arrived(5, frame)])) == [Arrived(5, frame)]
