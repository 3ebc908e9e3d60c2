"""What the commands listen on: loopback only, unless an address is written."""

import pytest

from tests.fuzzbee.processes import UDP, default_session, free_port, is_loopback, listening, started
from tests.service.sessions import wait_for


def settled(process, condition):
    """The sockets once ``condition`` holds for them."""
    found = []

    def is_settled():
        assert process.poll() is None
        found[:] = listening(process.pid)
        return condition(found)

    wait_for(is_settled)
    return found


def test_run_listens_on_loopback_only():
    udp, tcp, metrics = free_port(UDP), free_port(), free_port()
    command = ("run", f"udpin:127.0.0.1:{udp}", "--json", "--profile", "paper")
    options = ("--ros", "--metrics", str(metrics), *default_session(tcp))
    with started(*command, *options) as process:
        found = settled(process, lambda seen: {udp, tcp, metrics} <= {port for _, port in seen})
        assert all(is_loopback(host) for host, _ in found), found


@pytest.mark.parametrize(("kind", "of"), [("udpin", [UDP]), ("tcpin", [])])
def test_sim_listens_where_it_is_reported_only(kind, of):
    port = free_port(*of)
    with started("sim", "--to", f"{kind}:127.0.0.1:{port}") as process:
        assert {*settled(process, bool)} == {("127.0.0.1", port)}


def test_watch_listens_on_loopback_only():
    with started("watch", "--json", *default_session()) as process:
        found = settled(process, lambda seen: len(seen) >= 2)
        assert all(is_loopback(host) for host, _ in found), found
