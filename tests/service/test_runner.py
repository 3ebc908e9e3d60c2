"""The loop: its schedule, its end, and what it refuses afterwards."""

import os
import signal
import threading

import pytest

from drivers.player import Player
from drivers.simulation.simulated_vehicle import SimulatedVehicle
from drivers.simulation.source import SimSource
from service.parameters import ParameterRequests
from service.pipeline import Pipeline
from service.runner import Runner
from service.signals import stop_on_signals
from service.sinks.sink import Outbox
from tests.service.flight_rig import ONE, PAPER, attitudes, imu_events
from tests.service.records import Collector


class LateClock:
    """A clock of the schedule that leaps by ``late_s`` once, at the third look."""

    def __init__(self, late_s):
        self.now_s, self.late_s, self.looks = 10.0, late_s, 0

    def __call__(self):
        self.looks += 1
        self.now_s += 1e-4 + (self.late_s if self.looks == 3 else 0.0)
        return self.now_s


@pytest.mark.parametrize(("late_s", "overruns"), [(0.0, 0), (0.004, 0), (0.032, 3), (3.0, 300)])
def test_late_ticks_are_counted(late_s, overruns):
    runner = Runner(Player([], 1.0), Pipeline(PAPER), Outbox([]), rate_hz=100.0,
                    monotonic_s=LateClock(late_s))  # fmt: skip
    runner.run(3.1)
    assert runner.overruns == overruns


def test_the_end_of_a_log_ends_the_loop():
    events, sink, pipeline = imu_events(50), Collector(), Pipeline(PAPER)
    player = Player(events, 20.0)
    timing = {"now_us": player.now_us, "is_finished": player.is_finished}
    with Outbox([sink]) as outbox:
        Runner(player, pipeline, outbox, rate_hz=200.0, **timing).run()
    assert pipeline.vehicle(ONE).imu.samples == 50
    assert attitudes(sink.got)[-1].state == "running"
    # the grid follows the arrivals: its last point is less than a period before the last sample
    assert attitudes(sink.got)[-1].time_unix_us > events[-1].arrival_us - 1e6 / 200.0


def test_a_signal_ends_the_loop_and_handlers_are_put_back():
    before = signal.getsignal(signal.SIGTERM)
    with SimSource(SimulatedVehicle(seed=0)) as source, Outbox([]) as outbox:
        runner = Runner(source, Pipeline(PAPER), outbox, rate_hz=1.0)
        timer = threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGTERM))
        with stop_on_signals(runner.stop):
            timer.start()
            runner.run(120.0)
        timer.join()
    assert runner.was_stopped
    assert signal.getsignal(signal.SIGTERM) is before


def test_who_asks_for_a_profile_once_the_loop_has_ended_is_refused_at_once():
    requests = ParameterRequests()
    with Outbox([]) as outbox:
        Runner(Player([], 1.0), Pipeline(PAPER), outbox, rate_hz=50.0, requests=requests).run(0.0)
    with pytest.raises(TimeoutError, match="ending"):
        requests.ask(ONE, {})
