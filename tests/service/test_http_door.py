"""The budget of the page's and the metrics' server, over real sockets."""

import http.client
import resource
import socket
import time
from contextlib import ExitStack, closing, suppress
from itertools import repeat
from types import SimpleNamespace

import pytest

from service import http_door
from service.http_door import Answer, HttpDoor, most_connections
from tests.service.sessions import wait_for

HELLO = b"GET /hello HTTP/1.1\r\nHost: localhost\r\n\r\n"


@pytest.fixture
def door():
    with closing(HttpDoor("test", ("127.0.0.1", 0), respond)) as made:
        yield made


def respond(target, headers):
    return Answer("text/plain", b"hello") if target == "/hello" else None


def connected(door):
    return socket.create_connection(door.server_address, 60.0)


def status(door, method="GET", host="localhost"):
    with closing(http.client.HTTPConnection(*door.server_address, timeout=60)) as connection:
        connection.request(method, "/hello", headers={"Host": host})
        answer = connection.getresponse()
        return answer.status, answer.read()


def descriptors(monkeypatch, limit):
    monkeypatch.setattr(resource, "getrlimit", lambda _: (limit, limit))


@pytest.mark.parametrize(
    ("limit", "most"), [(4, 1), (64, 8), (1024, 40), (resource.RLIM_INFINITY, 40)]
)
def test_a_door_leaves_descriptors_to_links_and_records(limit, most, monkeypatch):
    descriptors(monkeypatch, limit)
    assert most_connections() == most


def test_a_header_that_never_ends_is_cut_off_though_bytes_go_on_coming(door, monkeypatch):
    monkeypatch.setattr(http_door, "REQUEST_S", 1.0)
    with connected(door) as slow:
        slow.sendall(b"GET /hello HTTP/1.1\r\nX: ")
        slow.settimeout(0.2)

        def is_cut_off():
            with suppress(OSError):
                slow.sendall(b"x")
            try:
                assert slow.recv(100) == b""
            except OSError as error:
                return isinstance(error, ConnectionError)
            return True

        wait_for(is_cut_off)  # each byte is in time


def test_the_silent_take_no_more_than_their_places_and_keep_nobody_waiting(monkeypatch):
    descriptors(monkeypatch, 64)
    monkeypatch.setattr(http_door, "REQUEST_S", 600.0)  # nothing else closes a connection
    monkeypatch.setattr(http_door._Handler, "timeout", 600.0)
    with closing(HttpDoor("test", ("127.0.0.1", 0), respond)) as door, ExitStack() as stack:
        for _ in range(7):
            stack.enter_context(connected(door))
        assert status(door) == (200, b"hello")
        silent = [stack.enter_context(connected(door)) for _ in range(62)]
        assert silent[-1].recv(1) == b""  # no place
        stack.close()  # the places are given back

        def is_served():
            with suppress(ConnectionError, http.client.BadStatusLine):
                assert status(door) == (200, b"hello")
                return True
            return False

        wait_for(is_served)


@pytest.mark.parametrize("method", ["GET", "HEAD"])
@pytest.mark.parametrize(
    ("host", "expected"), [("localhost", 200), ("[::1]:80", 200), ("127.0.0.1.evil.example", 403)]
)
def test_a_foreign_name_is_refused(door, method, host, expected):
    got, content = status(door, method, host)
    assert got == expected
    assert (content == b"") == (method == "HEAD")


def test_who_leaves_is_no_error(door, capfd):
    connected(door).close()
    with connected(door) as leaving:
        leaving.sendall(HELLO)
    assert status(door) == (200, b"hello")
    assert capfd.readouterr().err == ""


def test_a_stream_outlasts_the_deadline_of_a_request(monkeypatch):
    def stream(_target, _headers):
        return Answer("text/plain", events=repeat(b"event"), period_s=0.05)

    with closing(HttpDoor("test", ("127.0.0.1", 0), stream)) as door, connected(door) as client:
        client.sendall(HELLO)
        while b"event" not in client.recv(1000):
            pass
        later = SimpleNamespace(monotonic=lambda: time.monotonic() + 3600.0, sleep=time.sleep)
        monkeypatch.setattr(http_door, "time", later)
        for _ in range(30):  # over 1.5 s; who is late is looked for twice a second
            assert client.recv(5)
