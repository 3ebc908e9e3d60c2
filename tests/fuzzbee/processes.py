"""Real processes of the command, on ports of their own."""

import json
import os
import socket
import subprocess
import sys
from contextlib import contextmanager

import psutil

FUZZBEE = (sys.executable, "-m", "fuzzbee")
UDP = socket.SOCK_DGRAM


def free_port(kind=socket.SOCK_STREAM):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def free_endpoint():
    """Where nobody listens, for Zenoh."""
    return f"tcp/127.0.0.1:{free_port()}"


def listen_setting(endpoint):
    """As the default session listens, in place of its own port."""
    return f"listen/endpoints:{json.dumps([endpoint, 'tcp/127.0.0.1:0'])}"


def default_session(port=None):
    """Options that make the default session on another port than the default one."""
    endpoint = f"tcp/127.0.0.1:{port}" if port else free_endpoint()
    return ["-e", endpoint, "--cfg", listen_setting(endpoint)]


def begun(*command, **options):
    """A process whose output is read as text, or as ``options`` have it."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([*map(str, command)], **{**pipes, **options})


@contextmanager
def started(*arguments, **environment):
    """A running command; killed if it is still there at the end."""
    settings = {**os.environ, "PYTHONUNBUFFERED": "1", **environment}
    process = begun(*FUZZBEE, *arguments, env=settings)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def shell(line, *arguments, status=0, **environment):
    """What bash makes, with this status, of a line in which ``"$@"`` is fuzzbee with arguments."""
    done = subprocess.run(
        ["bash", "-c", f"set -o pipefail; {line}", "-", *FUZZBEE, *map(str, arguments)],
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1", **environment},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == status, (done.returncode, done.stderr)
    return done


def descendants(process):
    return [child.pid for child in psutil.Process(process).children(recursive=True)]


def is_alive(process):
    """Whether there is such a process that is no zombie."""
    try:
        return psutil.Process(process).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def cpu_s(process):
    """Processor time of a process, 0 once it has ended."""
    try:
        used = psutil.Process(process).cpu_times()
    except psutil.NoSuchProcess:
        return 0.0
    return used.user + used.system


def listening(process):
    """What others could reach: TCP that listens, UDP that is bound and not connected."""
    return [
        (each.laddr.ip, each.laddr.port)
        for each in psutil.Process(process).net_connections("inet")
        if each.status == psutil.CONN_LISTEN or (each.type == UDP and not each.raddr)
    ]


def is_loopback(host):
    return host.startswith("127.") or host in ("::1", "::ffff:127.0.0.1")
