import os
import signal
import threading

import pytest

from drivers.player import Player
from drivers.simulation.simulated_vehicle import SimulatedVehicle
from drivers.simulation.source import SimSource
from estimator.profile import load_profile
from service.parameters import ParameterRequests
from service.pipeline import Pipeline
from service.records import AttitudeRecord, Published
from service.runner import Runner
from service.signals import stop_on_signals
from service.sinks.outbox import Outbox
from tests.service.sinks.test_sink import Collector
from tests.service.streams import ONE, imu_events

PAPER = load_profile("paper")


def attitudes(sink):
    return [o.record for o in sink.got if isinstance(o, Published)
            and isinstance(o.record, AttitudeRecord)]  # fmt: skip


def test_ticks_keep_their_number_whatever_each_one_costs():
    sink = Collector()
    with SimSource(SimulatedVehicle(seed=0)) as source, Outbox([sink]) as outbox:
        runner = Runner(source, Pipeline(PAPER), outbox, rate_hz=100.0)
        runner.run(1.5)
    # each tick is due at its own time, so none is lost but at the very end
    assert 148 <= runner.ticks <= 151
    assert [a.sequence for a in attitudes(sink)] == list(range(len(attitudes(sink))))
    assert len(attitudes(sink)) >= 140  # the first ticks may precede the first sample


@pytest.mark.parametrize("late_s", [0.0, 0.004, 0.03, 3.0])
def test_late_ticks_are_counted_and_the_schedule_is_kept(late_s):
    runner = Runner(Player([], 1.0), Pipeline(PAPER), Outbox([]), rate_hz=100.0)
    due = runner._next_due_s(10.0, 10.0 + late_s)
    steps = (due - 10.0) / 0.01
    assert steps == pytest.approx(round(steps), abs=1e-6)  # on the grid of the schedule
    assert runner.overruns == {0.0: 0, 0.004: 0, 0.03: 1, 3.0: 300}[late_s]
    assert due == pytest.approx(13.01 if late_s == 3.0 else 10.01)


def test_the_end_of_a_log_ends_the_loop():
    events = imu_events(50)
    player = Player(events, 20.0)
    sink, pipeline = Collector(), Pipeline(PAPER)
    with Outbox([sink]) as outbox:
        Runner(
            player,
            pipeline,
            outbox,
            rate_hz=200.0,
            now_us=player.now_us,
            is_finished=player.is_finished,
        ).run()
    assert pipeline.vehicle(ONE).samples == 50
    assert attitudes(sink)[-1].state == "running"
    assert attitudes(sink)[-1].time_unix_us >= events[-1].arrival_us


def test_a_signal_ends_the_loop_and_handlers_are_put_back():
    before = signal.getsignal(signal.SIGTERM)
    with SimSource(SimulatedVehicle(seed=0)) as source, Outbox([]) as outbox:
        runner = Runner(source, Pipeline(PAPER), outbox, rate_hz=1.0)
        timer = threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGTERM))
        with stop_on_signals(runner.stop):
            timer.start()
            runner.run(30.0)
        timer.join()
    assert runner.ticks < 5
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_profile_asked_for_on_another_thread_is_replaced_by_the_loop():
    requests = ParameterRequests()
    pipeline = Pipeline(PAPER)
    answers = []
    with SimSource(SimulatedVehicle(seed=0)) as source, Outbox([]) as outbox:
        runner = Runner(source, pipeline, outbox, rate_hz=50.0, requests=requests)

        def ask():
            while pipeline.vehicle(ONE) is None:
                pass
            answers.append(requests.ask(ONE, {"filter": {"gamma": 0.125}}))
            runner.stop()

        thread = threading.Thread(target=ask)
        thread.start()
        runner.run(10.0)
        thread.join()
    assert answers[0].filter.gamma == 0.125
    assert pipeline.vehicle(ONE).profile.filter.gamma == 0.125
    with pytest.raises(TimeoutError, match="ending"):
        requests.ask(ONE, {})
