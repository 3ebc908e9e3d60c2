"""The service killed without a word, and a link that is cut, with real processes."""

import signal
import socket
import time
from itertools import pairwise

import pytest

from drivers.events import Imu, Malformed
from drivers.logs.tlog import Tlog
from tests.fuzzbee.processes import free_port, started
from tests.fuzzbee.services import recorded


def test_a_recording_killed_in_the_middle_reads_to_its_last_whole_frame(tmp_path):
    port, log = free_port(socket.SOCK_DGRAM), tmp_path / "flight.tlog"
    command = ("run", f"udpin:127.0.0.1:{port}", "--no-zenoh", "--json", "--profile", "paper")
    with (
        started("sim", "--to", f"udpout:127.0.0.1:{port}", "--rate", "200"),
        started(*command, "--record", str(log)) as service,
    ):
        end_s = time.monotonic() + 60.0
        while not (log.exists() and log.stat().st_size > 200_000):
            assert service.poll() is None
            assert time.monotonic() < end_s
            time.sleep(0.01)
        service.send_signal(signal.SIGKILL)
        service.wait()
    events = list(Tlog(log))
    samples = [event for event in events if isinstance(event, Imu)]
    assert not [event for event in events if isinstance(event, Malformed)]
    assert len(samples) > 500
    # stamp, frame, stamp, frame, and nothing behind the last one
    assert sum(8 + len(frame) for _, frame in recorded(log)) == log.stat().st_size
    periods_us = {b.boot_us - a.boot_us for a, b in pairwise(samples)}
    assert periods_us == {5_000}


pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL")
