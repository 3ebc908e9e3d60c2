"""A router that comes and goes, and a subscriber that blocks: real processes and sessions."""

import json
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from itertools import pairwise

import zenoh

from tests.fuzzbee.processes import free_port, started
from tests.service.sinks.test_zenoh import plain_client, wait_for

ROUTER = """
import json, sys, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", json.dumps([sys.argv[1]]))
config.insert_json5("scouting/multicast/enabled", "false")
with zenoh.open(config):
    print("ready", flush=True)
    sys.stdin.read()
"""


@contextmanager
def router(endpoint):
    with subprocess.Popen(
        [sys.executable, "-c", ROUTER, endpoint],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout.readline() == "ready\n"
            yield process
        finally:
            process.kill()


def attitudes(session):
    seen = []
    session.declare_subscriber(
        "fuzzbee/1/attitude", lambda sample: seen.append(json.loads(sample.payload.to_string()))
    )
    return seen


def test_a_router_that_returns_gets_attitudes_again_and_the_loop_never_stopped():
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    client = ("-m", "client", "-e", endpoint)
    with router(endpoint) as first, started("run", "sim:", "--json", "--rate", "50", *client):
        with plain_client(endpoint) as session:
            seen = attitudes(session)
            wait_for(lambda: len(seen) > 20, 60.0)
        first.kill()
        first.wait()
        gone_s = time.monotonic()
        while True:
            try:
                with router(endpoint), plain_client(endpoint) as session:
                    again = attitudes(session)
                    wait_for(lambda seen=again: len(seen) > 20, 60.0)
                break
            except zenoh.ZError:  # the port is not free again yet
                assert time.monotonic() - gone_s < 120.0
    assert again[0]["sequence"] > seen[-1]["sequence"]
    assert again[-1]["state"] == "running"
    steps = [b["sequence"] - a["sequence"] for a, b in pairwise(again)]
    assert set(steps) == {1}


def test_a_subscriber_that_blocks_costs_the_others_nothing():
    endpoint, release = f"tcp/127.0.0.1:{free_port()}", threading.Event()
    with (
        started("run", "sim:", "--json", "--rate", "200", "-l", endpoint, "-e", endpoint),
        plain_client(endpoint, 60.0) as blocked,
        plain_client(endpoint) as session,
    ):
        stuck = []
        blocked.declare_subscriber(
            "fuzzbee/1/attitude", lambda sample: (stuck.append(sample), release.wait())
        )
        try:
            seen = attitudes(session)
            wait_for(lambda: len(seen) > 1500, 60.0)
        finally:
            release.set()
    assert stuck
    missing = sum(b["sequence"] - a["sequence"] - 1 for a, b in pairwise(seen))
    assert missing < 0.01 * len(seen)
    assert seen[-1]["state"] == "running"
