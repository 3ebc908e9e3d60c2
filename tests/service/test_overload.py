"""Overload: what is left out, and that it ends."""

import math
from statistics import median
from types import SimpleNamespace

import pytest

from drivers.events import Imu, Shed
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.framing import FrameReader
from drivers.mavlink.link import FrameQueue
from drivers.simulation.autopilot import VehicleOptions
from drivers.simulation.fleet import Fleet
from estimator.profile import load_profile
from service.pipeline import Pipeline
from service.runner import WINDOW_S, WINDOWS_TO_BEGIN, WINDOWS_TO_END, Overload, Runner
from service.vehicle_status import Load
from tests.service.flight_rig import ONE, START_US, attitudes, fed, imu_events, statuses, texts
from tests.service.records import Collector


@pytest.mark.parametrize(
    ("is_full", "windows"),
    [
        (lambda k: 10 <= k < 20, [9 + WINDOWS_TO_BEGIN, 19 + WINDOWS_TO_END]),
        (lambda k: k % WINDOWS_TO_BEGIN == 0, []),  # short stalls
        (lambda k: k % WINDOWS_TO_END, [WINDOWS_TO_BEGIN]),  # a window without now and then
    ],
)
def test_an_overload_begins_and_ends_with_what_is_left_out(is_full, windows):
    overload, count, changes = Overload(), 0, []
    for k in range(40):
        count += 5 if is_full(k) else 0
        if overload.observe(count, k * WINDOW_S):
            changes.append(k)
            assert overload.is_on == (len(changes) % 2 == 1)
    assert changes == windows


@pytest.mark.parametrize("busy", [Load(is_shedding=True), Load(has_just_woken=True)])
def test_while_samples_are_left_out_and_after_a_stop_attitudes_are_of_new_ones(busy):
    events = imu_events(20)
    pipeline = fed(events[:10])

    def shown(after_us, load=busy):
        return len(attitudes(pipeline.tick(events[9].arrival_us + after_us, load)))

    assert [shown(0), shown(20_000), shown(40_000, Load())] == [1, 0, 1]
    pipeline.handle(events[10])
    assert shown(60_000) == 1
    # a silent vehicle is shown, now and then
    assert 3 <= sum(map(shown, range(80_000, 1_080_000, 20_000))) <= 4


@pytest.mark.parametrize("is_left_out", [True, False])
def test_whose_samples_are_left_out_is_not_silent(is_left_out):
    """Its last attitude is not sent again; a silent vehicle is degraded."""
    events, shedding = imu_events(20), Load(is_shedding=True)
    pipeline = fed(events)
    begin_us = events[-1].arrival_us
    states = [each.state for each in attitudes(pipeline.tick(begin_us, shedding))]
    for now_us in range(begin_us + 520_000, begin_us + 4_000_000, 20_000):
        if is_left_out:
            pipeline.handle(Shed(ONE, now_us, "RAW_IMU", 1))
        states += [each.state for each in attitudes(pipeline.tick(now_us, shedding))]
    assert set(states[1:]) == (set() if is_left_out else {"degraded"})
    assert pipeline.vehicle(ONE).state == ("running" if is_left_out else "degraded")
    late_us = begin_us + 5_000_000
    pipeline.handle(Shed(ONE, late_us, "RAW_IMU", 1))
    pipeline.tick(late_us, shedding)
    assert pipeline.vehicle(ONE).state == "lost"


def test_after_a_stop_of_ours_nobody_is_reported_to_be_silent():
    events = imu_events(10)
    pipeline = fed(events)
    later_us = events[-1].arrival_us + 9_000_000
    pipeline.tick(events[-1].arrival_us)
    assert texts(pipeline.tick(later_us, Load(has_just_woken=True))) == []
    assert pipeline.vehicle(ONE).state == "running"
    assert any("lost" in text for text in texts(pipeline.tick(later_us + 20_000, Load())))


def test_samples_are_counted_that_were_left_out_before_the_first_was_taken():
    pipeline = fed(Shed(ONE, 0, "RAW_IMU", samples) for samples in (3, 4))
    assert pipeline.vehicle(ONE).imu.shed == 7
    pipeline.handle(Shed(ONE, 0, "SCALED_IMU2", 9))  # of the same instants
    assert pipeline.vehicle(ONE).imu.shed == 9
    fed(imu_events(3), pipeline)
    assert pipeline.vehicle(ONE).imu.message == "RAW_IMU"
    pipeline.handle(Shed(ONE, 0, "SCALED_IMU2", 9))
    pipeline.handle(Shed(ONE, 0, "RAW_IMU", 1))
    assert pipeline.vehicle(ONE).imu.shed == 8


def unix_us(now_s):
    return START_US + round(1e6 * now_s)


class SlowPipeline(Pipeline):
    """A computer on which a sample takes ``cost_s``; it is stopped for a while at ``stop_at_s``."""

    def __init__(self, clock, cost_s=0.0, stop_at_s=math.inf, stop_s=0.0):
        super().__init__(load_profile("paper"), rate_hz=50.0)
        self._clock, self._cost_s = clock, cost_s
        self._stop_at_s, self._stop_s = stop_at_s, stop_s

    def handle(self, event, now_us=None):
        if isinstance(event, Imu):
            self._clock.now_s += self._cost_s
        if self._clock.now_s >= self._stop_at_s:
            self._clock.now_s += self._stop_s
            self._stop_at_s = math.inf
        return super().handle(event, now_us)


class GivenLink(FrameQueue):
    """A link's queue and decoder on what vehicles send until ``end_s``, a sample a datagram."""

    lost = 0

    def __init__(self, clock, vehicles, end_s, room):
        super().__init__(room)
        self._clock, self._end_s = clock, end_s
        self._fleet = Fleet(VehicleOptions(rate_hz=50.0), vehicles)
        self._reader, self._decoder = FrameReader(), MavlinkDecoder()
        self._sent_s, self.sent = 0.0, 0

    def drain(self, timeout_s):
        self._receive()
        end_s = self._clock.now_s + max(timeout_s, 1e-6)
        while not len(self) and self._clock.now_s < end_s:
            self._clock.now_s = min(end_s, self._clock.now_s + 1e-3)
            self._receive()
        events = [e for us, frame in self.take(16) for e in self._decoder.events(frame, us)]
        return events + self.take_shed(unix_us(self._clock.now_s))

    def _receive(self):
        """All that was sent until now, each millisecond's with its own time of arrival."""
        now_s = self._clock.now_s
        while self._sent_s + 1e-3 <= min(now_s, self._end_s):
            self._sent_s += 1e-3
            self._fleet.send_due(1e6 * self._sent_s, unix_us(self._sent_s), self._arrive)

    def _arrive(self, data):
        self.sent += 1
        self.add(unix_us(self._sent_s), self._reader.feed(data))


class Kept(Collector):
    """An outbox that keeps all at once."""

    dropped = 0
    put = Collector.handle


def run_given(vehicles, load_s, seconds, room=4096, **slowness):
    """Runs a service on vehicles that send for ``load_s``; pipeline, link and outputs."""
    clock, kept = SimpleNamespace(now_s=0.0), Kept()
    link, pipeline = GivenLink(clock, vehicles, load_s, room), SlowPipeline(clock, **slowness)
    times = {"now_us": lambda: unix_us(clock.now_s), "monotonic_s": lambda: clock.now_s}
    Runner(link, pipeline, kept, rate_hz=50.0, **times).run(seconds)
    return pipeline, link, kept.got


def test_a_computer_that_is_too_slow_keeps_its_ticks_and_reports_it():
    """Twenty vehicles at 50 Hz need 3 s a second of it; then they are gone."""
    load_s, rate_hz = 4.0, 50.0
    pipeline, link, got = run_given(20, load_s, 12.0, room=256, cost_s=0.003)
    seen, reported = attitudes(got), statuses(got)
    assert any(text.startswith("overloaded") for text in texts(got))
    assert any(text.startswith("no longer overloaded") for text in texts(got))
    assert any(status.overloaded and status.published_hz < rate_hz for status in reported)
    assert not reported[-1].overloaded
    assert reported[-1].published_hz == rate_hz
    # nothing vanished: what the vehicles sent was taken or is counted
    assert link.sent > 0.99 * 20 * 50 * load_s
    counted = sum(each.imu.samples + each.imu.shed for each in pipeline.vehicles)
    refused = sum(sum(each.rejected.values()) for each in pipeline.vehicles)
    assert counted + refused + link.dropped == pytest.approx(link.sent, rel=0.01)
    # every vehicle has its turn: of a third of the samples
    taken = [vehicle.imu.samples for vehicle in pipeline.vehicles]
    assert min(taken) > 0.25 * max(taken)
    # attitudes are of fresh samples all the time; without leaving any out they would be 8 s old
    end_us = min(attitude.time_unix_us for attitude in seen) + load_s * 1e6
    assert median(a.age_ms for a in seen if a.time_unix_us < end_us) < 150.0


def test_what_piled_up_in_a_stop_is_taken():
    """Stopped for 1.5 s at 1 s, as by a suspended computer: nothing that came is left out."""
    pipeline, link, got = run_given(1, 60.0, 4.0, stop_at_s=1.0, stop_s=1.5)
    later = [a for a in attitudes(got) if a.time_unix_us > START_US + 2_600_000]
    assert len({a.time_boot_us for a in later}) == len(later) > 10
    assert max(a.age_ms for a in later) < 100.0
    assert median(a.age_ms for a in later) < 2.0  # each leaves with its sample
    assert {a.state for a in later} == {"running"}
    (vehicle,) = pipeline.vehicles
    assert vehicle.imu.shed == link.shed == 0
    assert vehicle.imu.samples == pytest.approx(50 * 4.0, rel=0.05)
