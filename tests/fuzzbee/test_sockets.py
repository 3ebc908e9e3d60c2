"""What the commands listen on: loopback only, unless an address is written."""

import os
import socket
import time
from pathlib import Path

import pytest

from tests.fuzzbee.processes import default_session, free_port, started

TABLES = ("tcp", "tcp6", "udp", "udp6")
LISTEN, CONNECTED = "0A", "01"

pytestmark = pytest.mark.skipif(
    not Path("/proc/net/tcp").exists(), reason="needs Linux's lists of sockets"
)


def inodes(pid):
    """The sockets of a process, by their numbers in the lists below /proc/net."""
    found = set()
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        try:
            target = str(entry.readlink())
        except OSError:
            continue
        if target.startswith("socket:["):
            found.add(target[8:-1])
    return found


def sockets(pid):
    """(protocol, local address, port, state) of all internet sockets of a process."""
    own, found = inodes(pid), []
    for table in TABLES:
        path = Path(f"/proc/{pid}/net/{table}")
        if not path.exists():
            continue
        for line in path.read_text().splitlines()[1:]:
            fields = line.split()
            if fields[9] in own:
                host, port = fields[1].split(":")
                found.append((table, address(host), int(port, 16), fields[3]))
    return found


def address(text):
    """An address as the lists have it: words of 32 bits in the machine's order."""
    raw = b"".join(bytes.fromhex(text[i : i + 8])[::-1] for i in range(0, len(text), 8))
    return socket.inet_ntop(socket.AF_INET if len(raw) == 4 else socket.AF_INET6, raw)


def listening(pid):
    """What others could reach: TCP that listens, UDP that is bound and not connected."""
    return [
        (table, host, port)
        for table, host, port, state in sockets(pid)
        if (table.startswith("tcp") and state == LISTEN)
        or (table.startswith("udp") and state != CONNECTED)
    ]


def settled(process, condition):
    """The sockets once ``condition`` holds for them."""
    end_s = time.monotonic() + 60.0
    while time.monotonic() < end_s and process.poll() is None:
        found = listening(process.pid)
        if condition(found):
            return found
        time.sleep(0.05)
    raise AssertionError(f"{process.poll()} {listening(process.pid)}")


def is_loopback(host):
    return host.startswith("127.") or host in ("::1", "::ffff:127.0.0.1")


def test_the_lists_are_read_as_they_should_be():
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen()
        port = server.getsockname()[1]
        assert ("tcp", "127.0.0.1", port) in listening(os.getpid())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as everywhere:
        everywhere.bind(("0.0.0.0", 0))  # the test itself must be able to fail
        hosts = {host for _, host, _ in listening(os.getpid())}
        assert not all(map(is_loopback, hosts))


def test_run_listens_on_loopback_only():
    udp, tcp, metrics = free_port(socket.SOCK_DGRAM), free_port(), free_port()
    command = ("run", f"udpin:127.0.0.1:{udp}", "--json", "--profile", "paper")
    options = ("--ros", "--metrics", str(metrics), *default_session(tcp))
    with started(*command, *options) as process:
        found = settled(process, lambda seen: {udp, tcp, metrics} <= {port for *_, port in seen})
        assert all(is_loopback(host) for _, host, _ in found), found


@pytest.mark.parametrize("kind", ["udpin", "tcpin"])
def test_sim_listens_where_it_is_reported_only(kind):
    port = free_port(socket.SOCK_DGRAM if kind == "udpin" else socket.SOCK_STREAM)
    with started("sim", "--to", f"{kind}:127.0.0.1:{port}") as process:
        found = settled(process, bool)
        assert {(host, number) for _, host, number in found} == {("127.0.0.1", port)}


def test_watch_listens_on_loopback_only():
    port = free_port()
    with started("watch", "--json", *default_session(port)) as process:
        found = settled(process, lambda seen: len(seen) >= 2)
        assert all(is_loopback(host) for _, host, _ in found), found
