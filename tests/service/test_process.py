"""What holds for a process: a stop takes effect at any moment, and its memory is looked after.

A stop does so also while a peer keeps the start waiting. The library waits for that peer much
longer than a test waits for the end of the process.
"""

import gc
import json
import signal
import socket
import sys
import time

import pytest

from estimator.compilation.compiled import is_compiled_code
from service.process import MANY_OBJECTS, SWITCH_INTERVAL_S, gc_settings
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
