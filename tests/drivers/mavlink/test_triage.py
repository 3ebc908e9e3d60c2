"""What stays of frames that have waited for too long."""

import random

import numba
import pytest

from drivers.events import VehicleId
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.dialect import mavlink
from drivers.mavlink.encoder import FrameEncoder, Message
from drivers.mavlink.imu_messages import imu_number
from drivers.mavlink.scanning import Scanner
from drivers.mavlink.transports.datagrams import Datagrams, peer_number
from drivers.mavlink.transports.transport import Packet
from drivers.mavlink.triage import newest

m = mavlink()


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_of_each_stream_the_newest_stays_and_what_is_said_once():
    rng = random.Random(4)
    encoders = [FrameEncoder(VehicleId(system, 1)) for system in (1, 250)]
    kinds = (
        lambda: m.MAVLink_raw_imu_message(1, *range(9), id=rng.choice((0, 0, 2))),
        lambda: m.MAVLink_scaled_imu2_message(1, *range(9)),
        lambda: m.MAVLink_attitude_message(1, *[0.0] * 6),
        lambda: m.MAVLink_heartbeat_message(2, 3, 0, 0, 0, 3),
        lambda: m.MAVLink_param_value_message(b"A", 1.0, 9, 1, 0),
    )
    sent = []
    for _ in range(200):
        message = rng.choice(kinds)()
        message.pack(m.MAVLink(None))
        made = Message(type(message).id, message.crc_extra, bytes(message._payload))
        sent.append(rng.choice(encoders).frame(made, 0))
    scanner = Scanner(MavlinkDecoder().wanted)
    scanned = scanner.scan(packets(sent, ["a"] * len(sent)))
    frames = [scanned.frame(k) for k in range(len(sent))]
    last = {(f.system_id, f.message_id, imu_number(f)): k for k, f in enumerate(frames)}
    thinned, old = newest(scanned)
    said_once = [k for k, f in enumerate(frames) if f.message_id == m.MAVLINK_MSG_ID_PARAM_VALUE]
    kept = sorted({*last.values(), *said_once})
    assert [thinned.frames(k) for k in range(len(thinned.counts))] == [[frames[k]] for k in kept]
    assert thinned.datagrams.begins.tolist() == [scanned.datagrams.begins[k] for k in kept]
    imus = (m.MAVLINK_MSG_ID_RAW_IMU, m.MAVLINK_MSG_ID_SCALED_IMU2)
    out = [f for k, f in enumerate(frames) if k not in kept and f.message_id in imus]
    assert {each.peer for each in old} == {peer_number("a")}
    of_peer = {(each.vehicle, each.stream): each.samples for each in old}
    assert sum(of_peer.values()) == len(out)
    second = [f for f in out if imu_number(f) == 2 and f.system_id == 250]
    assert of_peer[VehicleId(250, 1), "RAW_IMU:2"] == len(second) > 3
    # another peer's frames make none of these old
    of_two, _ = newest(scanner.scan(packets(sent, ["a"] * 150 + ["b"] * 50)))
    assert len(of_two.counts) > len(kept)


def packets(sent, peers):
    return Datagrams.of([Packet(*each) for each in zip(peers, sent, strict=True)], 1)
