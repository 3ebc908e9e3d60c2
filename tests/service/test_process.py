"""The loop and its end: a stop takes effect at any moment; memory is looked after."""

import gc
import os
import signal
import socket
import sys
import threading
import time
from itertools import accumulate, chain, repeat

import pytest

from drivers.player import Player
from drivers.simulation.simulated_vehicle import SimulatedVehicle
from drivers.simulation.source import SimSource
from estimator.compilation.compiled import is_compiled_code
from service.parameters import ParameterRequests
from service.pipeline import Pipeline
from service.process import MANY_OBJECTS, SWITCH_INTERVAL_S, gc_settings
from service.runner import Runner
from service.signals import stop_on_signals
from service.sinks.sink import Outbox
from tests.fuzzbee.processes import started
from tests.programs import run_python
from tests.service.flight_rig import ONE, PAPER, attitudes, imu_events
from tests.service.records import Collector

NEVER_MS = 600_000  # ten times what a test waits
PATIENT = ("--cfg", f"transport/unicast/open_timeout:{NEVER_MS}")
CLIENT = ("-m", "client", "--cfg", f"connect/timeout_ms:{NEVER_MS}")
OF_PEERS = ("-l", "tcp/127.0.0.1:0")


@pytest.mark.parametrize(
    ("verb", "number", "options", "after_s"),
    [
        ("run", signal.SIGTERM, CLIENT, 0.3),
        ("watch", signal.SIGHUP, CLIENT, 0.3),
        # a session of peers is open, and its library waits for the peer when it is closed
        ("run", signal.SIGTERM, OF_PEERS, 4.0),
        ("watch", signal.SIGTERM, OF_PEERS, 4.0),
    ],
)
def test_while_the_session_waits_for_a_silent_peer(verb, number, options, after_s):
    """It accepts TCP and never sends anything."""
    with socket.create_server(("127.0.0.1", 0)) as peer:
        endpoint = f"tcp/127.0.0.1:{peer.getsockname()[1]}"
        with started(verb, "-e", endpoint, *options, *PATIENT) as process:
            peer.settimeout(60.0)
            connection, _ = peer.accept()
            with connection:
                time.sleep(after_s)
                process.send_signal(number)
                assert process.wait(60) == 0


LOST = """
import os, signal, sys
from concurrent.futures import Future
from service.signals import await_result, stop_on_signals, terminate_like_interrupt

class Last:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGTERM)
        sum(range(1000))  # here the handler runs

with terminate_like_interrupt():
    last = Last()
    del last
    with stop_on_signals(lambda: print("stopped")):
        pass
    try:
        await_result(Future())
    except KeyboardInterrupt:
        print("interrupted")
with stop_on_signals(lambda: print("stopped again")):
    pass
"""


def test_an_interrupt_that_falls_into_a_destructor_is_raised_again():
    """As into a callback of the compiler's, where one in a hundred starts under load lost it."""
    done = run_python("-c", LOST, timeout_s=60, check=False)
    assert "Exception ignored" in done.stderr
    assert done.stdout.split("\n") == ["stopped", "interrupted", ""], done.stderr


def test_the_process_is_as_before_afterwards():
    interval_s, frozen = sys.getswitchinterval(), gc.get_freeze_count()
    thresholds = gc.get_threshold()
    with gc_settings():
        assert abs(sys.getswitchinterval() - SWITCH_INTERVAL_S) < 1e-6
        assert gc.get_freeze_count() > 1000
        assert gc.get_threshold() == (MANY_OBJECTS, *thresholds[1:])
    assert gc.get_threshold() == thresholds
    assert sys.getswitchinterval() == interval_s
    assert gc.get_freeze_count() == frozen


def test_what_newcomers_bring_is_left_alone_too_once_a_second():
    with gc_settings() as add:
        add(0, 10.0)
        before = gc.get_freeze_count()
        brought = [[] for _ in range(1000)]
        add(1, 10.5)
        assert gc.get_freeze_count() <= before  # what is frozen may be freed meanwhile
        add(1, 11.0)
        assert gc.get_freeze_count() >= before + len(brought)
        before = gc.get_freeze_count()
        brought += [[] for _ in range(1000)]
        add(1, 12.0)
        assert gc.get_freeze_count() <= before


LOADED = """
from service.process import load_kernels
load_kernels()
is_code, kb = False, 0
for line in open("/proc/self/smaps"):
    if "-" in line.split()[0]:
        is_code = " r-xp " in line and "libllvmlite" in line
    elif is_code and line.startswith("Rss:"):
        kb += int(line.split()[1])
print(kb)
"""


@pytest.mark.skipif(sys.platform != "linux" or not is_compiled_code(), reason="nothing to free")
def test_the_compilers_code_takes_no_memory_once_kernels_are_loaded():
    done = run_python("-c", LOADED, timeout_s=600)
    assert int(done.stdout) < 8_000  # kB; 22,000 and more while they are loaded


@pytest.mark.parametrize(("late_s", "overruns"), [(0.0, 0), (0.004, 0), (0.032, 3), (3.0, 300)])
def test_late_ticks_are_counted(late_s, overruns):
    """The clock of the schedule leaps once, at the third look."""
    steps_s = chain([10.0, 1e-4, late_s], repeat(1e-4))
    runner = Runner(Player([], 1.0), Pipeline(PAPER), Outbox([]), rate_hz=100.0,
                    monotonic_s=accumulate(steps_s).__next__)  # fmt: skip
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
    before = [*map(signal.getsignal, (signal.SIGTERM, signal.SIGINT))]
    with SimSource(SimulatedVehicle(seed=0)) as source, Outbox([]) as outbox:
        runner = Runner(source, Pipeline(PAPER), outbox, rate_hz=1.0)
        timer = threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGTERM))
        with stop_on_signals(runner.stop):
            timer.start()
            runner.run(120.0)
        timer.join()
    assert runner.was_stopped
    assert [*map(signal.getsignal, (signal.SIGTERM, signal.SIGINT))] == before


def test_who_asks_for_a_profile_once_the_loop_has_ended_is_refused_at_once():
    requests = ParameterRequests()
    with Outbox([]) as outbox:
        Runner(Player([], 1.0), Pipeline(PAPER), outbox, rate_hz=50.0, requests=requests).run(0.0)
    with pytest.raises(TimeoutError, match="ending"):
        requests.ask(ONE, {})
