"""A stop takes effect at any moment: also while a peer keeps the start waiting.

The library waits for that peer much longer than a test waits for the end of the process.
"""

import json
import signal
import socket
import time

import pytest

from tests.fuzzbee.processes import started
from tests.programs import run_python

NEVER_MS = 600_000  # ten times what a test waits
PATIENT = ["--cfg", f"transport/unicast/open_timeout:{NEVER_MS}"]


@pytest.mark.parametrize(("verb", "number"), [("run", signal.SIGTERM), ("watch", signal.SIGHUP)])
def test_while_the_session_waits_for_a_silent_peer(verb, number):
    """It accepts TCP and never sends anything."""
    with socket.create_server(("127.0.0.1", 0)) as peer:
        options = ["-e", f"tcp/127.0.0.1:{peer.getsockname()[1]}", "-m", "client"]
        options += ["--cfg", f"connect/timeout_ms:{NEVER_MS}", *PATIENT]
        with started(verb, *options) as process:
            peer.settimeout(60.0)
            connection, _ = peer.accept()
            with connection:
                time.sleep(0.3)
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


@pytest.mark.parametrize("verb", ["run", "watch"])
def test_while_a_session_of_peers_tries_a_silent_one(verb):
    """It is open, and its library waits for the peer when it is closed."""
    with socket.create_server(("127.0.0.1", 0)) as peer:
        options = ["-e", f"tcp/127.0.0.1:{peer.getsockname()[1]}", "-l", "tcp/127.0.0.1:0"]
        options += PATIENT
        with started(verb, *options) as process:
            peer.settimeout(60.0)
            connection, _ = peer.accept()
            with connection:
                time.sleep(4.0)
                process.send_signal(signal.SIGTERM)
                assert process.wait(60) == 0


def test_a_closed_terminal_leaves_a_summary():
    with started("run", "--no-zenoh", "--json", "-v") as process:
        process.stderr.readline()
        time.sleep(0.5)
        process.send_signal(signal.SIGHUP)
        out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert json.loads(out)["ticks"] > 0
