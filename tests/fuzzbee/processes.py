"""Real processes of the command, on ports of their own."""

import json
import os
import socket
import subprocess
import sys
from contextlib import contextmanager

import psutil


def free_port(kind=socket.SOCK_STREAM):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def default_session(port):
    """Options that make the default session on another port than the default one."""
    endpoint = f"tcp/127.0.0.1:{port}"
    listen = json.dumps([endpoint, "tcp/127.0.0.1:0"])
    return ["-e", endpoint, "--cfg", f"listen/endpoints:{listen}"]


@contextmanager
def started(*arguments, **environment):
    """A running command; killed if it is still there at the end."""
    process = subprocess.Popen(
        [sys.executable, "-m", "fuzzbee", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1", **environment},
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def cpu_s(process):
    """Processor time of a process, 0 once it has ended."""
    try:
        used = psutil.Process(process).cpu_times()
    except psutil.NoSuchProcess:
        return 0.0
    return used.user + used.system
