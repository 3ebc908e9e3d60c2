"""The page's server: the page, what it shows as server-sent events, and records as JSON.

https://html.spec.whatwg.org/multipage/server-sent-events.html
"""

import ipaddress
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib.resources import files
from typing import Any
from urllib.parse import parse_qs, urlsplit

import msgspec

from estimator.errors import InputError
from fuzzbee import verdict
from fuzzbee.latest import Latest, Row
from fuzzbee.notify import notify
from service.http_door import Answer, HttpDoor
from service.records import Output

HOST = "127.0.0.1"
MOST_PORT = 65535
ONE_HZ, ALL_HZ = 20.0, 4.0  # events a second: of one vehicle, and of a table
HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline';"
    " script-src 'unsafe-inline'; connect-src 'self'; img-src data:; frame-ancestors 'none'",
}


def parse_address(text: str) -> tuple[str, int]:
    """``PORT`` on loopback, or ``HOST:PORT`` with an address of this computer."""
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]") or HOST
    try:
        ipaddress.ip_address(host)
        number = int(port) if port.isdecimal() else 0
    except ValueError:
        number = 0
    if not 1 <= number <= MOST_PORT:
        raise InputError(f"--web {text}: should be PORT (1 to {MOST_PORT}) or ADDRESS:PORT")
    return host, number


class WebPage:
    """The page of a table model; a sink of the service, and beside watch's display. Close it."""

    name = "web"

    def __init__(
        self,
        address: tuple[str, int],
        title: str,
        model: Latest | None = None,
        now_s: Callable[[], float] = time.monotonic,  # of the model
    ) -> None:
        self.model = model or Latest()
        self.title = title
        self.now_s = now_s
        try:
            self._door = HttpDoor(self.name, address, self._respond, HEADERS)
        except OSError as error:
            raise InputError("--web {}:{}: {}".format(*address, error.strerror or error)) from error
        self.port = self._door.server_port  # the one in use
        self.is_loopback = self._door.is_loopback

    def handle(self, outputs: Sequence[Output]) -> None:
        """Remember the latest records."""
        self.model.take(outputs, self.now_s())

    def close(self) -> None:
        """End the server and what it sends."""
        self._door.close()

    def _respond(self, target: str, _headers: Mapping[str, str]) -> Answer | None:
        """The page, its events, the vehicles' names, or the latest record, as on Zenoh."""
        url = urlsplit(target)
        rows = {row.name: row for row in self.model.rows()}
        found: Any = None
        match url.path.split("/")[1:]:
            case [""]:
                page = files("fuzzbee.web").joinpath("page.html").read_bytes()
                return Answer("text/html; charset=utf-8", page)
            case ["events"]:
                vehicle = parse_qs(url.query).get("vehicle", [None])[0]
                period_s = 1.0 / (ALL_HZ if vehicle is None else ONE_HZ)
                events = iter(partial(self.event, vehicle), None)
                return Answer("text/event-stream", b"", events, period_s)
            case ["vehicles"]:
                found = list(rows)
            case ["vehicles", name, ("attitude" | "status") as kind] if name in rows:
                found = getattr(rows[name], kind)
        return None if found is None else Answer("application/json", msgspec.json.encode(found))

    def event(self, vehicle: str | None) -> bytes:
        """What is sent: all vehicles, or one of them, with the server's time (ms)."""
        rows = [row for row in self.model.rows(self.now_s()) if vehicle in (None, row.name)]
        content: dict[str, Any] = {
            "title": self.title,
            "sent_ms": round(1e3 * time.monotonic()),
            "vehicles": [shown(row) for row in rows],
        }
        return b"data: " + msgspec.json.encode(content) + b"\n\n"


def open_page(text: str, title: str, model: Latest | None = None) -> WebPage:
    """The page at an address as it was typed; prints where it is."""
    address = parse_address(text)
    page = WebPage(address, title, model)
    elsewhere = "" if page.is_loopback else ", for all who reach this address"
    host = HOST if ipaddress.ip_address(address[0]).is_unspecified else address[0]
    notify(f"the page is at http://{f'[{host}]' if ':' in host else host}:{page.port}/{elsewhere}")
    return page


def shown(row: Row) -> dict[str, Any]:
    """What the page is sent of a vehicle; degrees, and the IMU sample's age.

    ``autopilot`` is how far off its roll, pitch and heading are, if they differ.
    """
    attitude, judged, status = row.valid_attitude, verdict.row_verdict(row), row.status
    theirs = verdict.differing(status)
    return {
        "name": row.name,
        "state": row.state_text,
        "flight": row.flight_words,
        "word": judged.word,
        "level": int(judged.overall),
        "reasons": [(int(each.level), each.text) for each in judged.caveats],
        "plates": [(int(each.level), each.sentence or each.text) for each in judged.caveats],
        "age_ms": None if row.age_ms is None else round(row.age_ms),
        "imu": (status and status.imu_message) or "",
        "rate_hz": status and round(status.imu_rate_hz, 1),
        "autopilot": theirs and (theirs.roll_deg, theirs.pitch_deg, theirs.heading_deg),
        "compass": verdict.compass_off_deg(status),
        "warnings": [f"warning: {verdict.warning_texts(x, status)[1]}" for x in status.warnings]
        if status
        else [],
        "imus": [
            f"{name}: {each.inclination_deg:.1f}°, {each.rate_deg_s:.1f}°/s"
            for name, each in (verdict.other_imus(status) if status else {}).items()
        ],
        "attitude": attitude
        and {
            "euler_deg": [round(angle, 2) for angle in attitude.euler_deg],
            "sigma_deg": [round(sigma, 2) for sigma in msgspec.structs.astuple(attitude.sigma_deg)],
            "levels": [int(judged.horizon), int(judged.heading)],
            "horizon": judged.horizon_text,
            "heading": verdict.heading_text(attitude),
            "north": judged.heading_text,
            "has_north": attitude.heading_reference != "none",
        },
    }
