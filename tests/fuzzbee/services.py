"""Services as real processes, with vehicles on real UDP and subscribers on real Zenoh sessions."""

import json
import signal
import socket
import threading
import time
from collections import defaultdict
from contextlib import contextmanager

import pytest

from drivers.simulation.autopilot import VehicleOptions
from drivers.simulation.fleet import Fleet
from tests.fuzzbee.processes import UDP, descendants, is_alive, started
from tests.service.sessions import wait_for

RATE_HZ = 50.0
SLOW_HZ = 20.0  # a short stall of a busy computer leaves no sample out


@contextmanager
def repeated(step, period_s):
    """``step()`` again and again in a thread of its own."""
    ended = threading.Event()

    def run():
        while not ended.wait(period_s):
            step()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@contextmanager
def flight(vehicles, *ports, rate_hz=RATE_HZ):
    """The same datagrams to each port, in real time; yields how many datagrams have been sent."""
    fleet, sent = Fleet(VehicleOptions(rate_hz=rate_hz), vehicles), []
    begin_s = time.monotonic()
    with socket.socket(socket.AF_INET, UDP) as sender:

        def send(data):
            sent.append(data)
            for port in ports:
                sender.sendto(data, ("127.0.0.1", port))

        def fly():
            fleet.send_due(1e6 * (time.monotonic() - begin_s), time.time_ns() // 1000, send)

        with repeated(fly, 0.002):
            yield sent


@contextmanager
def service(port, *options):
    """A running service that is listening; all its processes are gone at the end."""
    settings = ("--json", "--rate", "50", "--profile", "paper")
    with started("run", f"udpin:127.0.0.1:{port}", *settings, *options) as process:
        await_line(process, "listening")
        family = descendants(process.pid)
        try:
            yield process
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
            wait_for(lambda: not any(map(is_alive, family)), 10.0)


def only(endpoint):
    """The options of a session that has this address and looks for no other."""
    return "-l", endpoint, "-e", endpoint


def await_line(process, words):
    output = ""
    for line in process.stderr:
        output += line
        if words in line:
            return output
    pytest.fail(f"{words!r} was never printed, but: {output}")


def keep_reading(process):
    """Standard error, so that nobody waits for it to be read."""
    lines = []
    threading.Thread(target=lambda: lines.extend(process.stderr), daemon=True).start()
    return lines


def end(process, lines):
    process.send_signal(signal.SIGINT)
    out = process.stdout.read()
    assert process.wait(10) == 0
    assert not [line for line in lines if "Traceback" in line]
    return json.loads(out)


class Subscriber:
    """Attitudes and the last status of each vehicle."""

    def __init__(self, session):
        self.attitudes, self.statuses = defaultdict(list), {}
        for kind in ("attitude", "status"):
            session.declare_subscriber(f"fuzzbee/*/{kind}", self.take)

    def take(self, sample):
        _, name, kind = str(sample.key_expr).split("/")
        record = json.loads(sample.payload.to_string())
        if kind == "attitude":
            self.attitudes[name].append((time.time(), record))
        else:
            self.statuses[name] = record

    def wait_for_attitudes(self, count):
        """Of each of four vehicles more than so many."""
        wait_for(lambda: all(len(self.attitudes[name]) > count for name in "1234"), 30.0)
