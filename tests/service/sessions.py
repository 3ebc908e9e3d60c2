"""Zenoh sessions on free loopback ports; the other end uses plain Zenoh, none of our code."""

import json
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import zenoh

from drivers.simulation.simulated_vehicle import SimulatedVehicle
from drivers.simulation.source import SimSource
from service.parameters import ParameterRequests
from service.pipeline import Pipeline
from service.runner import Runner
from service.sinks.sink import Outbox
from service.sinks.zenoh import ZenohSink
from service.zenoh_session import OpeningSession, ZenohOptions
from tests.fuzzbee.processes import listen_setting
from tests.service.flight_rig import PAPER


def open_session(endpoint, **changes):
    """The default session on a port of the test's own; the caller closes it."""
    options = ZenohOptions(connect=(endpoint,), settings=(listen_setting(endpoint),))
    return OpeningSession(options._replace(**changes), print).session()


def wait_for(condition, timeout_s=60.0):
    end_s = time.monotonic() + timeout_s
    while not condition() and time.monotonic() < end_s:
        time.sleep(0.02)
    assert condition()


def configuration(**sections):
    """One that looks for nobody."""
    return json.dumps({"scouting": {"multicast": {"enabled": False}}, **sections})


def opened(config, patience_s=60.0):
    """A session of a service that may still be starting."""
    end_s = time.monotonic() + patience_s
    while True:
        try:
            return zenoh.open(config)
        except zenoh.ZError:
            if time.monotonic() > end_s:
                raise
            time.sleep(0.1)


def plain_client(endpoint, patience_s=0.0):
    text = configuration(mode="client", connect={"endpoints": [endpoint]})
    return opened(zenoh.Config.from_json5(text), patience_s)


def plain_listener(endpoint):
    return zenoh.open(zenoh.Config.from_json5(configuration(listen={"endpoints": [endpoint]})))


ROUTER = """
import sys, zenoh
with zenoh.open(zenoh.Config.from_json5(sys.argv[1])):
    print("ready", flush=True)
    sys.stdin.read()
"""


@contextmanager
def router(endpoint):
    """A process of its own, which may be killed."""
    text, piped = configuration(mode="router", listen={"endpoints": [endpoint]}), subprocess.PIPE
    command = [sys.executable, "-c", ROUTER, text]
    with subprocess.Popen(command, stdin=piped, stdout=piped, text=True) as process:
        try:
            assert process.stdout.readline() == "ready\n"
            yield process
        finally:
            process.kill()


def heard(session, key):
    """The records under a key, as they come."""
    records = []
    session.declare_subscriber(key, lambda each: records.append(json.loads(bytes(each.payload))))
    return records


def assert_without_gaps(records):
    sequence = [record["sequence"] for record in records]
    assert sequence == list(range(sequence[0], sequence[0] + len(sequence))), sequence


def get(session, selector, payload=None):
    """(key, value) of each reply; (None, error) of an error reply."""
    out = []
    for reply in session.get(selector, payload=payload, timeout=60.0):
        if reply.ok is not None:
            out.append((str(reply.ok.key_expr), json.loads(reply.ok.payload.to_bytes())))
        else:
            out.append((None, json.loads(reply.err.payload.to_bytes())))
    return out


def tokens(session, key):
    """The keys that are alive."""
    return [str(reply.ok.key_expr) for reply in session.liveliness().get(key)]


@contextmanager
def service(endpoint):
    """The whole service on the built-in vehicle, in a thread of its own."""
    requests = ParameterRequests()
    sink = ZenohSink(open_session(endpoint), "test", PAPER, requests)
    with SimSource(SimulatedVehicle(seed=0)) as source, Outbox([sink]) as outbox:
        runner = Runner(source, Pipeline(PAPER), outbox, rate_hz=100.0, requests=requests)
        thread = threading.Thread(target=runner.run)
        thread.start()
        try:
            yield outbox
        finally:
            runner.stop()
            thread.join()
    assert outbox.stuck == outbox.unreported == []
