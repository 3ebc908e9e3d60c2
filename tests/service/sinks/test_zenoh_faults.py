"""A router that comes and goes, and a subscriber that blocks: real processes and sessions."""

import threading
import time
from itertools import pairwise

import zenoh

from tests.fuzzbee.processes import started
from tests.service.sessions import heard, plain_client, router, wait_for

KEY = "fuzzbee/1/attitude"


def test_a_router_that_returns_gets_attitudes_again_and_the_loop_never_stopped(endpoint):
    client = ("-m", "client", "-e", endpoint)
    with router(endpoint) as first, started("run", "sim:", "--json", "--rate", "50", *client):
        with plain_client(endpoint) as session:
            seen = heard(session, KEY)
            wait_for(lambda: len(seen) > 20)
        first.kill()
        first.wait()
        gone_s = time.monotonic()
        while True:
            try:
                with router(endpoint), plain_client(endpoint) as session:
                    again = heard(session, KEY)
                    wait_for(lambda seen=again: len(seen) > 20)
                break
            except zenoh.ZError:  # the port is not free again yet
                assert time.monotonic() - gone_s < 120.0
    assert again[0]["sequence"] > seen[-1]["sequence"]
    assert again[-1]["state"] == "running"
    steps = [b["sequence"] - a["sequence"] for a, b in pairwise(again)]
    assert set(steps) == {1}


def test_a_subscriber_that_blocks_costs_the_others_nothing(endpoint):
    release, stuck = threading.Event(), []
    with (
        started("run", "sim:", "--json", "--rate", "200", "-l", endpoint, "-e", endpoint),
        plain_client(endpoint, 60.0) as blocked,
        plain_client(endpoint) as session,
    ):
        blocked.declare_subscriber(KEY, lambda sample: (stuck.append(sample), release.wait()))
        try:
            seen = heard(session, KEY)
            wait_for(lambda: len(seen) > 1500)
        finally:
            release.set()
    assert stuck
    missing = sum(b["sequence"] - a["sequence"] - 1 for a, b in pairwise(seen))
    assert missing < 0.01 * len(seen)
    assert seen[-1]["state"] == "running"
