"""What is left out when there is more to do than can be done, and that it ends."""

import itertools
import socket
import threading
import time

import pytest

from drivers.busy import WINDOW_S, BusyShare
from drivers.endpoint import parse_endpoint
from drivers.events import Heartbeat, Imu, Shed, VehicleId
from drivers.mavlink.link import MavlinkLink
from drivers.mavlink.transports.open import open_transport
from drivers.simulation.autopilot import VehicleOptions
from drivers.simulation.fleet import Fleet, run_vehicles
from estimator.profile import load_profile
from service.newest import newest_events
from service.overload import LONGEST_PATIENCE_S, STRIDES, Overload
from service.pipeline import Pipeline
from service.records import AttitudeRecord, Message, Published, StatusRecord
from service.runner import Runner
from service.sinks.outbox import Outbox
from tests.service.sinks.test_sink import Collector
from tests.service.streams import ONE, imu_events


class Clock:
    def __init__(self):
        self.s = 100.0

    def __call__(self):
        return self.s


def test_waiting_is_rest_and_all_else_is_work():
    clock = Clock()
    busy = BusyShare(clock)
    for _ in range(10):
        clock.s += 0.02
        busy.rest()
        clock.s += 0.01
        busy.work()
    assert busy.windows == 1  # after 0.25 s
    assert busy.share == pytest.approx(2.0 / 3.0, abs=0.02)
    clock.s += WINDOW_S
    busy.go_on()
    assert busy.windows == 2
    assert busy.share == pytest.approx(1.0, abs=0.05)


def settled_level(load, overload, start_s=0.0, seconds=60.0):
    """The levels, where the work of a window is ``load`` over the stride, and 1 at most."""
    levels = []
    for k in range(int(seconds / WINDOW_S)):
        busy = min(1.0, load / STRIDES[overload.level])
        overload.observe(busy, start_s + k * WINDOW_S)
        levels.append(overload.level)
    return levels


@pytest.mark.parametrize("load", [0.3, 0.85, 1.5, 2.5, 5.0, 20.0])
def test_as_much_is_left_out_as_must_be(load):
    levels = settled_level(load, Overload())
    at_the_end = levels[len(levels) // 2 :]
    # enough is left out nearly all the time: tries with less are rare
    carried = [load / STRIDES[level] < 0.9 for level in at_the_end]
    assert sum(carried) >= 0.85 * len(carried)
    # and no more than one step beyond what must be
    needed = next(i for i, stride in enumerate(STRIDES) if load / stride < 0.9)
    assert max(at_the_end) <= needed + 1
    assert levels[int(3.0 / WINDOW_S)] >= needed  # after three seconds


def test_one_full_window_is_no_overload():
    overload = Overload()
    assert not overload.observe(1.0, 0.0)
    assert not overload.observe(0.5, 0.25)
    assert not overload.observe(1.0, 0.5)
    assert overload.shedding.is_none


def test_it_ends_when_the_load_ends():
    overload = Overload()
    settled_level(20.0, overload, seconds=20.0)
    assert overload.level >= 7
    levels = settled_level(0.1, overload, 20.0, 3.0)
    assert levels.index(0) * WINDOW_S <= 2.5
    assert set(levels[levels.index(0) :]) == {0}


def test_a_level_too_low_is_tried_ever_more_rarely():
    overload, levels = Overload(), []
    for k in range(480):  # what the second level does would fit into the first, but does not
        overload.observe(1.0 if overload.level == 0 else 0.3, k * WINDOW_S)
        levels.append(overload.level)
    tries = [k * WINDOW_S for k in range(1, len(levels)) if levels[k] < levels[k - 1]]
    assert max(b - a for a, b in itertools.pairwise(tries)) >= LONGEST_PATIENCE_S


def test_of_each_stream_the_newest_event_stays():
    events = imu_events(20)
    other = VehicleId(2, 1)
    heartbeats = [Heartbeat(ONE, events[0].arrival_us, 3, 2)] * 2
    theirs = imu_events(3, vehicle=other)
    kept = newest_events([heartbeats[0], *theirs, *events, heartbeats[1]])
    assert [type(each) for each in kept] == [Heartbeat, Imu, Imu, Heartbeat, Shed, Shed]
    assert kept[1] == theirs[-1]
    assert kept[2] == events[-1]
    assert {(each.vehicle, each.samples) for each in kept[4:]} == {(ONE, 19), (other, 2)}


class SlowPipeline(Pipeline):
    """A computer on which a sample takes 3 ms."""

    def handle(self, event):
        if isinstance(event, Imu):
            time.sleep(0.003)
        return super().handle(event)


def test_a_computer_that_is_too_slow_keeps_its_ticks_and_says_so():
    """Twenty vehicles at 50 Hz need 3 s a second of it; then they are gone."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    sink, rate_hz, load_s = Collector(), 50.0, 5.0
    transport = open_transport(parse_endpoint(f"udpout:127.0.0.1:{port}"))
    fleet = Fleet(VehicleOptions(rate_hz=50.0), 20)
    with (
        MavlinkLink(parse_endpoint(f"udpin:127.0.0.1:{port}")) as link,
        Outbox([sink]) as outbox,
    ):
        pipeline = SlowPipeline(load_profile("paper"))
        runner = Runner(link, pipeline, outbox, rate_hz=rate_hz, overload=Overload())
        transport.open()
        vehicles = threading.Thread(
            target=run_vehicles, args=(fleet, transport, lambda: False, load_s)
        )
        vehicles.start()
        runner.run(load_s + 6.0)
        vehicles.join()
    records = [each for each in sink.got if isinstance(each, Published)]
    attitudes = [each.record for each in records if isinstance(each.record, AttitudeRecord)]
    statuses = [each.record for each in records if isinstance(each.record, StatusRecord)]
    texts = [each.text for each in sink.got if isinstance(each, Message)]
    assert any(text.startswith("overloaded") for text in texts)
    assert any(text.startswith("no longer overloaded") for text in texts)
    assert any(status.overloaded and status.published_hz < rate_hz for status in statuses)
    assert not statuses[-1].overloaded
    assert statuses[-1].published_hz == rate_hz
    # nothing vanished: what the vehicles sent was taken or is counted
    sent = 20 * 50 * load_s
    counted = sum(vehicle.samples + vehicle.shed for vehicle in pipeline.vehicles)
    assert counted + link.dropped == pytest.approx(sent, rel=0.03)
    assert min(vehicle.shed for vehicle in pipeline.vehicles) > 50
    # after a second to notice it, attitudes are of fresh samples again; 11 s of a backlog otherwise
    begin_us = min(attitude.time_unix_us for attitude in attitudes)
    later = [a for a in attitudes if 2.5e6 < a.time_unix_us - begin_us < load_s * 1e6]
    ages_ms = sorted(a.age_ms for a in later)
    assert ages_ms[len(ages_ms) // 2] < 400.0
