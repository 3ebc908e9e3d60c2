"""Who is who on a link, how many are remembered, and whose messages are skipped."""

import pytest

from drivers.events import Forgotten, Imu, RefusedFrames, Rejected, VehicleId
from drivers.mavlink.decoder import MOST_SENDERS, MavlinkDecoder
from drivers.mavlink.framing import FrameReader
from drivers.samples.intake import MOST_STREAMS
from tests.drivers.mavlink.messages import UNIX, S, decode_all, frame, heartbeat, m, only, raw_imu


@pytest.mark.parametrize(
    "messages",
    [
        [m.MAVLink_vfr_hud_message(0, 0, 0, 0, 0, 0)],
        # cameras, stations
        [heartbeat(*kind) for kind in ((8, 30), (8, 2), (8, 6), (0, 6), (3, 6))],
        [m.MAVLink_attitude_message(1500, 0, 0, 0, 0, 0, 0)],  # of a companion without an IMU
    ],
)
def test_what_is_no_vehicle_s_becomes_nothing(messages):
    assert decode_all(messages) == []


def test_a_vehicle_may_have_system_id_255():
    events = decode_all([heartbeat(), raw_imu()], system=255)
    assert {event.vehicle for event in events} == {VehicleId(255, 1)}


def test_vehicles_on_one_link_have_clocks_of_their_own():
    decoder = MavlinkDecoder()
    first = decode_all([raw_imu(500 * S + 20_000 * k) for k in range(5)], decoder)
    second = decode_all([raw_imu(S + 20_000 * k) for k in range(5)], decoder, system=2)
    assert [e.vehicle.system_id for e in only(Imu, first + second)] == [1] * 5 + [2] * 5
    assert not only(Rejected, first + second)


def test_a_link_of_any_number_of_senders_and_streams_is_remembered_within_bounds():
    decoder, reader = MavlinkDecoder(), FrameReader()
    known, turned_away, refused = set(), 0, 0
    for number in range(MOST_SENDERS + 200):
        address = 1 + number % 250, 1 + number // 250
        (each,) = reader.feed(frame(raw_imu(), *address))
        events = decoder.events(each, UNIX + number)
        known |= {event.vehicle for event in only(Imu, events)}
        turned_away += sum(event.frames for event in only(RefusedFrames, events))
    assert len(known) == MOST_SENDERS
    assert turned_away == 200  # every sample is accounted for
    for instance in range(256):
        message = m.MAVLink_raw_imu_message(
            S + instance, 0, 0, -1000, 0, 0, 1, 0, 0, 0, id=instance
        )
        (each,) = reader.feed(frame(message))
        events = only(Rejected, decoder.events(each, UNIX))
        refused += [event.reason for event in events] == ["too_many_streams"]
    assert refused == 256 - MOST_STREAMS


def test_a_sender_with_an_imu_takes_the_slot_of_whoever_has_none_and_is_silent_for_longest(
    monkeypatch,
):
    """A table that is full of heartbeats, all of them fresh."""
    monkeypatch.setattr("drivers.mavlink.decoder.MOST_SENDERS", 3)
    decoder = MavlinkDecoder()
    for system in (1, 2, 3, 1):
        assert len(decode_all([heartbeat()], decoder, system=system)) == 1
    gone, imu = decode_all([raw_imu()], decoder, system=7)
    assert gone == Forgotten(VehicleId(2, 1), UNIX)
    assert imu.vehicle == VehicleId(7, 1)


def test_other_imus_are_skipped_while_the_one_in_use_comes():
    """Half a second after its end they are decoded; a better one always, all if none is known."""
    sent = []
    for k in range(100):
        sent += [raw_imu(S + 20_000 * k)] if k < 50 else []
        others = m.MAVLink_scaled_imu2_message, m.MAVLink_scaled_imu3_message
        sent += [other(1000 + 20 * k, 0, 0, -1000, *[0] * 6) for other in others]

    def taken(in_use):
        decoder = MavlinkDecoder()
        decoder.imu_in_use = lambda _: in_use
        events = only(Imu, decode_all(sent, decoder, interval_us=20_000 // 3))
        return {name: sum(e.message == name for e in events) for name in
                ("RAW_IMU", "SCALED_IMU2", "SCALED_IMU3")}  # fmt: skip

    assert taken(None) == {"RAW_IMU": 50, "SCALED_IMU2": 100, "SCALED_IMU3": 100}
    first = taken("RAW_IMU")
    assert first["RAW_IMU"] == 50
    assert 10 < first["SCALED_IMU2"] < 50  # of the 50 after RAW_IMU ended, less half a second
    assert taken("SCALED_IMU2") == {"RAW_IMU": 50, "SCALED_IMU2": 100, "SCALED_IMU3": 0}
