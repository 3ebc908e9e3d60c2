"""Whatever befalls a running service's processes, disk and subscribers, in whatever order.

The slow sister of ``tests/service/test_link_states.py``: real processes, sockets and sessions.
They take some 40 s each, so that they run only if ``PROCESS_STATES`` in the environment gives a
number.
"""

import json
import os
import resource
import signal
import socket
import tempfile
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import psutil
import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule

from drivers.events import VehicleId
from drivers.mavlink.encoder import FrameEncoder, raw_imu
from drivers.simulation.simulated_vehicle import SimulatedVehicle
from tests.fuzzbee.processes import free_port, started
from tests.fuzzbee.services import (
    Subscriber,
    await_line,
    descendants,
    is_alive,
    keep_reading,
    only,
    wait_for,
)
from tests.service.sinks.test_zenoh import plain_client

NUMBER = int(os.environ.get("PROCESS_STATES", "0"))
pytestmark = [
    pytest.mark.skipif(not NUMBER, reason="PROCESS_STATES is not set"),
    pytest.mark.skipif(not hasattr(resource, "prlimit"), reason="needs Linux"),
]
RATE_HZ = 50.0
VEHICLES = 3
NO_LIMIT = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
MOST_GROWN_MB = 60.0


class Service(RuleBasedStateMachine):
    """Vehicles on UDP, a service that records, and a subscriber."""

    @initialize()
    def begin(self):
        self.stack = ExitStack()
        self.folder = Path(self.stack.enter_context(tempfile.TemporaryDirectory()))
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.port = free_port(socket.SOCK_DGRAM)
        self.wire = self.stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        self.noise = self.stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        self.process = self.stack.enter_context(
            started(
                *("run", f"udpin:127.0.0.1:{self.port}", "--json", "--rate", "20"),
                *("--record", str(self.folder / "recorded"), *only(self.endpoint)),
            )
        )
        await_line(self.process, "listening")
        self.lines = keep_reading(self.process)
        self.vehicles = [
            (SimulatedVehicle(seed=k, rate_hz=RATE_HZ), FrameEncoder(VehicleId(k + 1, 1)))
            for k in range(VEHICLES)
        ]
        self.sent = [0] * VEHICLES
        self.again = [0] * VEHICLES
        self.old = []
        self.was_full = False
        self.gone = []  # what earlier subscribers have seen
        self.subscriber = None
        self.grew_from_mb = None
        self.a_subscriber_comes()
        self.fly(50)

    def fly(self, samples):
        """So many of each vehicle, in real time."""
        for _ in range(samples):
            for number, (samples_of, encoder) in enumerate(self.vehicles):
                sample = next(samples_of)
                message = raw_imu(
                    sample.time_us, sample.acc_m_s2, sample.gyr_rad_s, sample.mag_gauss
                )
                frame = encoder.frame(message, time.time_ns() // 1000)
                self.send(frame)
                self.sent[number] += 1
                self.old = [*self.old[-60:], (number, frame)]
            time.sleep(1.0 / RATE_HZ)

    def send(self, data):
        self.wire.sendto(data, ("127.0.0.1", self.port))

    @rule(samples=st.integers(10, 50))
    def samples_come(self, samples):
        self.fly(samples)
        self.goes_on()

    @rule(data=st.binary(min_size=1, max_size=600), times=st.integers(1, 50))
    def garbage_comes(self, data, times):
        for _ in range(times):
            self.noise.sendto(data, ("127.0.0.1", self.port))

    @rule(which=st.integers(0, 60))
    def a_frame_comes_again(self, which):
        number, frame = self.old[which % len(self.old)]
        self.send(frame)
        self.again[number] += 1

    @rule(seconds=st.floats(0.1, 6.0))
    def nothing_comes(self, seconds):
        time.sleep(seconds)

    @rule(seconds=st.floats(0.1, 3.0))
    def the_service_is_stopped(self, seconds):
        self.process.send_signal(signal.SIGSTOP)
        try:
            self.fly(round(seconds * RATE_HZ))
        finally:
            self.process.send_signal(signal.SIGCONT)
        self.goes_on()

    @precondition(lambda self: not self.was_full)
    @rule()
    def the_disk_is_full(self):
        """No file may grow any more."""
        size = max((f.stat().st_size for f in self.folder.rglob("*.tlog")), default=0)
        resource.prlimit(self.process.pid, resource.RLIMIT_FSIZE, (size + 10, NO_LIMIT[1]))
        self.was_full = True
        self.fly(30)
        self.goes_on()

    @precondition(lambda self: self.was_full)
    @rule()
    def there_is_room_again(self):
        resource.prlimit(self.process.pid, resource.RLIMIT_FSIZE, NO_LIMIT)

    @rule()
    def the_subscriber_goes_and_another_comes(self):
        self.gone.append(self.subscriber.attitudes)
        self.session.close()
        self.fly(10)
        self.a_subscriber_comes()
        self.goes_on()

    def a_subscriber_comes(self):
        self.session = ExitStack()
        self.subscriber = Subscriber(self.session.enter_context(plain_client(self.endpoint)))

    def goes_on(self):
        """The service is there, and each vehicle's attitudes come, fresh ones."""
        assert self.process.poll() is None, "".join(self.lines)[-2000:]
        begun_us = time.time_ns() // 1000
        end_s = time.monotonic() + 30.0
        names = [str(k + 1) for k in range(VEHICLES)]

        def is_fresh(name):
            seen = self.subscriber.attitudes.get(name)
            return bool(seen) and seen[-1][1]["time_unix_us"] > begun_us

        while not all(map(is_fresh, names)):
            assert time.monotonic() < end_s, [n for n in names if not is_fresh(n)]
            self.fly(5)
        mb = psutil.Process(self.process.pid).memory_info().rss / 1e6
        self.grew_from_mb = self.grew_from_mb or mb
        assert mb - self.grew_from_mb < MOST_GROWN_MB

    def teardown(self):
        if not hasattr(self, "stack"):
            return
        with self.stack:
            self.process.send_signal(signal.SIGCONT)
            with suppress(OSError):
                resource.prlimit(self.process.pid, resource.RLIMIT_FSIZE, NO_LIMIT)
            family = descendants(self.process.pid)
            time.sleep(1.0)
            self.process.send_signal(signal.SIGINT)
            output = self.process.stdout.read()
            status = self.process.wait(20)
            self.session.close()
            wait_for(lambda: not any(map(is_alive, family)), 10.0)
            reported = "".join(self.lines)
            assert "Traceback" not in reported, reported[-2000:]
            self.adds_up(json.loads(output), status)

    def adds_up(self, result, status):
        is_whole = result["recording"] == "whole"
        assert status == (0 if is_whole else 1)
        is_shed = any(vehicle["shed"] for vehicle in result["vehicles"].values())
        assert is_whole or self.was_full or is_shed
        assert is_whole or "record" in "".join(self.lines)
        lost = result["lost"] + result["dropped"]
        for k in range(VEHICLES):
            reported = result["vehicles"][str(k + 1)]
            handled = reported["samples"] + reported["shed"] + sum(reported["rejected"].values())
            held = 1  # a sample of another time, until the next one confirms it
            assert self.sent[k] - lost - held <= handled <= self.sent[k] + self.again[k]
            for seen in (*self.gone, self.subscriber.attitudes):
                numbers = [record["sequence"] for _, record in seen.get(str(k + 1), ())]
                assert numbers == sorted(set(numbers))
                assert not numbers or numbers[-1] < reported["attitudes"]
                assert reported["samples"] > 0


Service.TestCase.settings = settings(
    max_examples=max(1, NUMBER),
    stateful_step_count=15,
    phases=(Phase.generate,),
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
test_processes = pytest.mark.timeout(0)(Service.TestCase)
