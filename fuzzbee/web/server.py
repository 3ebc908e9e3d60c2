"""The page's server: the page, what it shows as server-sent events, and records as JSON.

https://html.spec.whatwg.org/multipage/server-sent-events.html
"""

import ipaddress
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any, NamedTuple
from urllib.parse import parse_qs, urlsplit

import msgspec

from estimator.errors import InputError
from fuzzbee.say import say
from fuzzbee.table_model import TableModel
from fuzzbee.web.shown import shown
from service.records import Output

HOST = "127.0.0.1"
MOST_PORT = 65535
ONE_HZ, ALL_HZ = 20.0, 4.0  # events a second: of one vehicle, and of a table
MOST_PAGES = 32  # open at once: each has a thread
PATIENCE_S = 5.0  # for a browser that does not read
HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline';"
    " script-src 'unsafe-inline'; connect-src 'self'; img-src data:; frame-ancestors 'none'",
}


class Address(NamedTuple):
    """Where the page is served."""

    host: str
    port: int

    @property
    def is_loopback(self) -> bool:
        """Whether only this computer reaches it."""
        return ipaddress.ip_address(self.host).is_loopback

    @property
    def url(self) -> str:
        """For a browser on this computer."""
        host = HOST if ipaddress.ip_address(self.host).is_unspecified else self.host
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/"


def parse_address(text: str) -> Address:
    """``PORT`` on loopback, or ``HOST:PORT`` with an address of this computer.

    Raises:
        InputError: something else.
    """
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]") or HOST
    try:
        ipaddress.ip_address(host)
        number = int(port) if port.isdecimal() else 0
    except ValueError:
        number = 0
    if not 1 <= number <= MOST_PORT:
        raise InputError(f"--web {text}: should be PORT (1 to {MOST_PORT}) or ADDRESS:PORT")
    return Address(host, number)


class WebPage:
    """Serves the page of a table model; a sink of the service, and beside watch's display.

    ``now_s`` is the clock of the table model. Close it.

    Raises:
        InputError: the address cannot be listened on.
    """

    name = "web"

    def __init__(
        self,
        address: Address,
        title: str,
        model: TableModel | None = None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.model = model or TableModel()
        self.title = title
        self.now_s = now_s
        try:
            self._server = _Server(address, self)
        except OSError as error:
            reason = error.strerror or str(error)
            raise InputError(f"--web {address.host}:{address.port}: {reason}") from error
        self.address = Address(address.host, self._server.server_address[1])
        self._thread = threading.Thread(target=self._server.serve_forever, name="web", daemon=True)
        self._thread.start()

    def handle(self, outputs: Sequence[Output]) -> None:
        """Remember the latest records."""
        self.model.take(outputs, self.now_s())

    def close(self) -> None:
        """End the server and what it sends."""
        self._server.closing.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def event(self, vehicle: str | None) -> bytes:
        """What is sent: all vehicles, or one of them, with the server's time (ms)."""
        now_s = self.now_s()
        rows = [row for row in self.model.rows() if vehicle in (None, row.name)]
        content: dict[str, Any] = {
            "title": self.title,
            "sent_ms": round(1e3 * time.monotonic()),
            "vehicles": [shown(row, now_s) for row in rows],
        }
        return b"data: " + msgspec.json.encode(content) + b"\n\n"

    def record(self, path: str) -> bytes | None:
        """JSON for ``/vehicles`` (their names) or ``/vehicles/NAME/attitude|status``.

        A record is the latest, as on Zenoh; None where there is none.
        """
        rows = {row.name: row for row in self.model.rows()}
        match path.split("/")[1:]:
            case ["vehicles"]:
                return msgspec.json.encode(list(rows))
            case ["vehicles", name, ("attitude" | "status") as kind] if name in rows:
                record = getattr(rows[name], kind)
                return None if record is None else msgspec.json.encode(record)
        return None


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def __init__(self, address: Address, page: WebPage) -> None:
        if ":" in address.host:
            import socket

            self.address_family = socket.AF_INET6
        self.page = page
        self.is_loopback = address.is_loopback
        self.closing = threading.Event()
        self.places = threading.BoundedSemaphore(MOST_PAGES)
        super().__init__((address.host, address.port), _Handler)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that went away is no error."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = PATIENCE_S
    server_version = "fuzzbee"
    sys_version = ""

    def do_HEAD(self) -> None:
        """The headers of what a GET would bring."""
        self.do_GET()

    def do_GET(self) -> None:
        """The page, its events, or a record."""
        if self.server.is_loopback and not self._is_asked_for_loopback():
            # a page of somebody's, whose name has been pointed here
            self.send_error(HTTPStatus.FORBIDDEN)
            return
        url = urlsplit(self.path)
        match url.path:
            case "/":
                page = files("fuzzbee.web").joinpath("page.html").read_bytes()
                self._answer("text/html; charset=utf-8", page)
            case "/events" if self.command == "GET":
                self._stream(parse_qs(url.query).get("vehicle", [None])[0])
            case "/events":
                self._answer("text/event-stream")
            case path:
                record = self.server.page.record(path)
                if record is None:
                    self.send_error(HTTPStatus.NOT_FOUND)
                else:
                    self._answer("application/json", record)

    def _is_asked_for_loopback(self) -> bool:
        name = urlsplit(f"//{self.headers.get('Host', '')}").hostname or ""
        with suppress(ValueError):
            return ipaddress.ip_address(name).is_loopback
        return name == "localhost"

    def _answer(self, kind: str, content: bytes = b"") -> None:
        """Send headers, and the content unless they alone were asked for."""
        self.send_response(HTTPStatus.OK)
        length = {"Content-Length": str(len(content))} if content else {}
        for name, value in {"Content-Type": kind, **length, **HEADERS}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(content)

    def _stream(self, vehicle: str | None) -> None:
        if not self.server.places.acquire(blocking=False):
            self.send_error(HTTPStatus.SERVICE_UNAVAILABLE)
            return
        try:
            self._answer("text/event-stream")
            period_s = 1.0 / (ALL_HZ if vehicle is None else ONE_HZ)
            while True:
                self.wfile.write(self.server.page.event(vehicle))
                if self.server.closing.wait(period_s):
                    break
        except OSError:  # the browser went away
            pass
        finally:
            self.server.places.release()

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - as it is named there
        """Nobody is told who looks."""


def open_page(text: str, title: str, model: TableModel | None = None) -> WebPage:
    """The page at an address as it was typed; says where it is.

    Raises:
        InputError: no such address, or it is taken.
    """
    page = WebPage(parse_address(text), title, model)
    elsewhere = "" if page.address.is_loopback else ", for all who reach this address"
    say(f"the page is at {page.address.url}{elsewhere}")
    return page
