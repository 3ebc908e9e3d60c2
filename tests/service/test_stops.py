"""A stop takes effect at any moment: also while a peer keeps the start waiting."""

import json
import signal
import socket
import time

import pytest

from tests.fuzzbee.processes import started


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("verb", ["run", "watch"])
def test_while_the_session_waits_for_a_silent_peer(verb, number):
    """It accepts TCP and never says a word."""
    with socket.create_server(("127.0.0.1", 0)) as peer:
        options = ["-e", f"tcp/127.0.0.1:{peer.getsockname()[1]}", "-m", "client"]
        options += [
            "--cfg",
            "connect/timeout_ms:30000",
            "--cfg",
            "transport/unicast/open_timeout:30000",
        ]
        with started(verb, *options) as process:
            peer.settimeout(60.0)
            connection, _ = peer.accept()
            with connection:
                time.sleep(0.3)
                begun_s = time.monotonic()
                process.send_signal(number)
                assert process.wait(60) == 0
                assert time.monotonic() - begun_s < 2.0


@pytest.mark.parametrize("verb", ["run", "watch"])
def test_while_a_session_of_peers_tries_a_silent_one(verb):
    """It is open, and its library waits for the peer when it is closed."""
    with socket.create_server(("127.0.0.1", 0)) as peer:
        options = ["-e", f"tcp/127.0.0.1:{peer.getsockname()[1]}", "-l", "tcp/127.0.0.1:0"]
        with started(verb, *options) as process:
            peer.settimeout(60.0)
            connection, _ = peer.accept()
            with connection:
                time.sleep(4.0)
                begun_s = time.monotonic()
                process.send_signal(signal.SIGTERM)
                assert process.wait(60) == 0
                assert time.monotonic() - begun_s < 4.0  # of 8


def test_a_closed_terminal_leaves_a_summary():
    with started("run", "--no-zenoh", "--json", "-v") as process:
        process.stderr.readline()
        time.sleep(0.5)
        process.send_signal(signal.SIGHUP)
        out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert json.loads(out)["ticks"] > 10
