"""Vehicles that come and go: what is remembered of them stays bounded, from frames to sinks."""

import msgspec
import pytest

from drivers.events import Forgotten, Heartbeat, Imu, VehicleId
from drivers.mavlink.decoder import SILENT_US, MavlinkDecoder
from drivers.mavlink.encoder import FrameEncoder, command_ack, raw_imu
from drivers.mavlink.framing import Frame, FrameReader
from drivers.mavlink.gate import MOST_SENDERS as MOST_GATED
from drivers.mavlink.gate import TAKE_OVER_US, FrameGate, Policy
from service.parameters import MOST_PROFILES
from service.pipeline import FORGOTTEN_LOOKS, Pipeline
from service.records import Evicted, Replaced
from tests.drivers.mavlink.messages import only
from tests.service.flight_rig import ONE, PAPER, START_US, fed, imu_events, texts

SECOND_US = 1_000_000
READER = FrameReader()


def addresses(count):
    """Different ones, none of them ``ONE``."""
    return [VehicleId(2 + n % 250, 1 + n // 250) for n in range(count)]


def sent(vehicle, message) -> Frame:
    (frame,) = READER.feed(FrameEncoder(vehicle).frame(message, 0))
    return frame


def imu_frame(vehicle, boot_us) -> Frame:
    return sent(vehicle, raw_imu(boot_us, (0.0, 0.0, -9.8), (0.0, 0.0, 0.0), (0.2, 0.0, 0.4)))


def evicted(outputs):
    return [each.vehicle for each in only(Evicted, outputs)]


def day(vehicles):
    """Frames and arrivals: ``ONE`` flies all the time, each other for one sample, 50 a second."""
    for number, vehicle in enumerate(vehicles):
        arrival_us = START_US + 20_000 * number
        yield imu_frame(ONE, SECOND_US + 20_000 * number), arrival_us
        yield imu_frame(vehicle, SECOND_US), arrival_us


def test_thousands_of_ids_in_a_row_each_find_a_place(monkeypatch):
    monkeypatch.setattr("drivers.mavlink.decoder.MOST_SENDERS", 512)
    decoder, pipeline = MavlinkDecoder(), Pipeline(PAPER)
    met, gone, most = set(), [], 0
    for frame, arrival_us in day(addresses(1200)):
        events = decoder.events(frame, arrival_us)
        fed(events, pipeline)
        met |= {event.vehicle for event in only(Imu, events)}
        gone += [event.vehicle for event in only(Forgotten, events)]
        most = max(most, len(pipeline.vehicles))
    assert len(met) == 1201
    assert most == 512
    assert ONE not in gone
    assert gone == addresses(1200)[: len(gone)]  # who left first goes first
    assert pipeline.vehicle(ONE).imu.samples == 1200
    assert pipeline.evicted["vehicles"] == len(gone) == 1201 - 512
    outputs = pipeline.tick(arrival_us)
    assert evicted(outputs) == gone
    assert len([text for text in texts(outputs) if "gone" in text]) < 15  # not a line for each
    assert evicted(pipeline.tick(arrival_us + SECOND_US)) == []  # reported once


def test_a_flood_of_addresses_takes_no_place_of_a_vehicle_that_is_silent(monkeypatch):
    monkeypatch.setattr("drivers.mavlink.decoder.MOST_SENDERS", 512)
    decoder = MavlinkDecoder()
    others = addresses(5000)
    for vehicle in (ONE, *others[:9]):
        decoder.events(imu_frame(vehicle, SECOND_US), START_US)
    gone, arrival_us = [], START_US
    for number, vehicle in enumerate(others[10:]):
        arrival_us = START_US + SILENT_US + 10_000 * number
        frame = sent(vehicle, command_ack(ONE, 1, 0))
        gone += only(Forgotten, decoder.events(frame, arrival_us))
    assert len(gone) > 1000
    assert not {each.vehicle for each in gone} & {ONE, *others[:9]}
    events = decoder.events(imu_frame(ONE, 2 * SECOND_US), arrival_us)
    assert [type(each) for each in events][-1] is Imu  # its clock went on


def test_a_vehicle_is_forgotten_after_an_hour_and_its_parameters_are_not():
    events = imu_events(100)
    pipeline = fed(events)
    changed = pipeline.replace_profile(ONE, {"filter": {"gamma": 0.5}})
    times_us = [events[-1].arrival_us + k * SECOND_US for k in range(1, FORGOTTEN_LOOKS + 7)]
    looks = [pipeline.tick(now_us) for now_us in times_us]
    assert [evicted(outputs) for outputs in looks if evicted(outputs)] == [[ONE]]
    assert not any(map(evicted, looks[: FORGOTTEN_LOOKS - 2]))
    assert looks[-2:] == [[], []]
    assert pipeline.vehicles == ()
    assert list(pipeline.evicted.values()) == [1, 100, 0, 0, 4]
    pipeline.handle(msgspec.structs.replace(events[0], arrival_us=times_us[-1]))
    assert pipeline.vehicle(ONE).profile == changed
    assert only(Replaced, pipeline.tick(times_us[-1])) == [Replaced(ONE, changed)]


def test_heartbeats_alone_keep_a_vehicle():
    pipeline, outputs = Pipeline(PAPER), []
    for second in range(FORGOTTEN_LOOKS + 10):
        now_us = START_US + second * SECOND_US
        pipeline.handle(Heartbeat(ONE, now_us, 3, 2))
        outputs += pipeline.tick(now_us)
    assert evicted(outputs) == []


@pytest.mark.parametrize("step_s", [3700, -3700, 86_400])
def test_a_set_clock_is_no_silence(step_s):
    pipeline = fed(imu_events(100))
    now_us = START_US + SECOND_US
    outputs = pipeline.tick(now_us) + pipeline.tick(now_us + step_s * SECOND_US)
    assert evicted(outputs) == []


def test_what_a_sender_was_is_forgotten_by_the_gate():
    gate = FrameGate(Policy())
    for number, vehicle in enumerate(addresses(10_000)):
        arrival_us = START_US + 2_000 * number
        assert gate.lets_in(imu_frame(vehicle, 0), "a", arrival_us)
    assert len(gate._addresses) <= MOST_GATED
    assert not gate.lets_in(imu_frame(vehicle, 1), "b", arrival_us + TAKE_OVER_US // 2)


def test_of_too_many_profiles_the_one_that_was_kept_first_goes():
    pipeline = Pipeline(PAPER)
    left = addresses(MOST_PROFILES + 1)
    for address in left:
        pipeline.handle(Heartbeat(address, START_US, 3, 2))
        pipeline.replace_profile(address, {"filter": {"gamma": 0.5}})
        pipeline.handle(Forgotten(address, START_US))
    pipeline.tick(START_US)
    for address in left[:2]:
        pipeline.handle(Heartbeat(address, START_US, 3, 2))
    assert [each.profile.filter.gamma == 0.5 for each in pipeline.vehicles] == [False, True]
