"""A small HTTP server beside the service, with a budget of its own.

It answers ``GET`` and ``HEAD``, one request a connection. Links and records need descriptors too:
a door takes at most an eighth of those that the process may open.
"""

import ipaddress
import resource
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from math import inf, isinf
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from drivers.resources import run_in_thread

MOST_CONNECTIONS = 40  # each has a thread and a descriptor
SHARE = 8  # of the process's descriptors, a door has one in so many
STREAM_PART = 0.8  # of the connections; the others are kept for short answers
REQUEST_S = 5.0  # from the connection to the end of its answer
PAUSE_S = 0.1  # before the next try where the process has no descriptor left


class Answer(NamedTuple):
    """What is sent: all of ``content``, or ``events`` with ``period_s`` between them."""

    kind: str
    content: bytes = b""
    events: Iterator[bytes] | None = None
    period_s: float = 0.0


# The answer to a path with its query and the request's headers; None where there is nothing.
Responder = Callable[[str, Mapping[str, str]], Answer | None]


def most_connections() -> int:
    """How many connections a door holds under this process's limit of descriptors."""
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if limit == resource.RLIM_INFINITY:
        return MOST_CONNECTIONS
    return max(1, min(MOST_CONNECTIONS, limit // SHARE))


class HttpDoor(ThreadingHTTPServer):
    """Serves ``respond`` from threads of its own until it is closed.

    On loopback it refuses a ``Host`` that is not loopback: another name may point here.

    Raises:
        OSError, OverflowError: the address cannot be listened on.
    """

    def __init__(
        self,
        name: str,
        address: tuple[str, int],
        respond: Responder,
        headers: Mapping[str, str] | None = None,
    ) -> None:
        if ":" in address[0]:
            self.address_family = socket.AF_INET6
        self.respond, self.headers = respond, headers or {}
        self.is_loopback = ipaddress.ip_address(address[0]).is_loopback
        self.closing = threading.Event()
        self.most = most_connections()
        self._lock = threading.Lock()
        self._until_s: dict[socket.socket, float] = {}  # by open connection; infinite for a stream
        super().__init__(address, _Handler)
        self._served = run_in_thread(self.serve_forever, name)

    def close(self) -> None:
        """End the server and what it sends."""
        self.closing.set()
        self.shutdown()
        self.server_close()
        self._served.result()

    def get_request(self) -> tuple[socket.socket, Any]:
        """The next connection; pauses where there is no descriptor for it."""
        try:
            return super().get_request()
        except OSError:
            time.sleep(PAUSE_S)
            raise

    def verify_request(self, request: Any, client_address: Any) -> bool:  # noqa: ARG002
        """Whether there is a slot for one more."""
        with self._lock:
            if len(self._until_s) >= self.most:
                return False
            self._until_s[request] = time.monotonic() + REQUEST_S
            return True

    def begin_stream(self, request: socket.socket) -> bool:
        """Whether there is room for a stream, which lasts: each write has the handler's timeout."""
        with self._lock:
            streams = sum(map(isinf, self._until_s.values()))
            if streams >= max(1, int(STREAM_PART * self.most)):
                return False
            self._until_s[request] = inf
            return True

    def service_actions(self) -> None:
        """End the requests that took too long; the server calls this twice a second."""
        now_s = time.monotonic()
        with self._lock:
            for request, until_s in self._until_s.items():
                if until_s < now_s:
                    with suppress(OSError):
                        request.shutdown(socket.SHUT_RDWR)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection and free its slot."""
        super().shutdown_request(request)
        with self._lock:
            self._until_s.pop(request, None)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that went away is no error."""


class _Handler(BaseHTTPRequestHandler):
    server: HttpDoor
    timeout = REQUEST_S
    server_version = "fuzzbee"
    sys_version = ""

    def do_GET(self) -> None:
        """The answer to the path."""
        if self.server.is_loopback and not self._is_asked_for_loopback():
            self.send_error(HTTPStatus.FORBIDDEN)
            return
        answer = self.server.respond(self.path, self.headers)  # type: ignore[arg-type]
        if answer is None:
            self.send_error(HTTPStatus.NOT_FOUND)
        elif answer.events is None or self.command == "HEAD":
            self._send(answer)
        elif not self.server.begin_stream(self.connection):
            self.send_error(HTTPStatus.SERVICE_UNAVAILABLE)
        else:
            self._send(answer)
            with suppress(OSError):  # the client went away, or does not read
                for event in answer.events:
                    self.wfile.write(event)
                    if self.server.closing.wait(answer.period_s):
                        break

    do_HEAD = do_GET  # noqa: N815 - as it is named there; only the headers are sent

    def _is_asked_for_loopback(self) -> bool:
        name = urlsplit(f"//{self.headers.get('Host', '')}").hostname or ""
        with suppress(ValueError):
            return ipaddress.ip_address(name).is_loopback
        return name == "localhost"

    def _send(self, answer: Answer) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", answer.kind)
        if answer.content:
            self.send_header("Content-Length", str(len(answer.content)))
        for name, value in self.server.headers.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(answer.content)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - as it is named there
        """Requests are not logged."""
