"""What the commands listen on: loopback only, unless an address is written."""

import socket

import psutil
import pytest

from tests.fuzzbee.processes import default_session, free_port, started
from tests.service.sinks.test_zenoh import wait_for


def listening(pid):
    """What others could reach: TCP that listens, UDP that is bound and not connected."""
    return [
        (each.laddr.ip, each.laddr.port)
        for each in psutil.Process(pid).net_connections("inet")
        if each.status == psutil.CONN_LISTEN or (each.type == socket.SOCK_DGRAM and not each.raddr)
    ]


def settled(process, condition):
    """The sockets once ``condition`` holds for them."""
    found = []

    def is_settled():
        assert process.poll() is None
        found[:] = listening(process.pid)
        return condition(found)

    wait_for(is_settled)
    return found


def is_loopback(host):
    return host.startswith("127.") or host in ("::1", "::ffff:127.0.0.1")


def test_run_listens_on_loopback_only():
    udp, tcp, metrics = free_port(socket.SOCK_DGRAM), free_port(), free_port()
    command = ("run", f"udpin:127.0.0.1:{udp}", "--json", "--profile", "paper")
    options = ("--ros", "--metrics", str(metrics), *default_session(tcp))
    with started(*command, *options) as process:
        found = settled(process, lambda seen: {udp, tcp, metrics} <= {port for _, port in seen})
        assert all(is_loopback(host) for host, _ in found), found


@pytest.mark.parametrize("kind", ["udpin", "tcpin"])
def test_sim_listens_where_it_is_reported_only(kind):
    port = free_port(socket.SOCK_DGRAM if kind == "udpin" else socket.SOCK_STREAM)
    with started("sim", "--to", f"{kind}:127.0.0.1:{port}") as process:
        assert {*settled(process, bool)} == {("127.0.0.1", port)}


def test_watch_listens_on_loopback_only():
    with started("watch", "--json", *default_session(free_port())) as process:
        found = settled(process, lambda seen: len(seen) >= 2)
        assert all(is_loopback(host) for host, _ in found), found
