"""Source addresses: one grammar, and one table for the parser and for the help text.

pymavlink's spelling (``udpin:host:port``, ``device,baud``) and MAVSDK's
(``udpin://host:port``, ``serial:///dev/ttyUSB0:57600``) mean the same here.
"""

import re
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Literal, NamedTuple

from estimator.errors import InputError

Kind = Literal["sim", "udpin", "udpout", "tcp", "tcpin", "serial", "log"]

LOOPBACK = "127.0.0.1"  # 0.0.0.0, all interfaces, must be asked for


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A parsed address. ``host`` and ``port`` belong to sockets, ``path`` to devices and logs.

    Of ``sim`` the path is the motion, empty for the usual one.
    """

    kind: Kind
    host: str = ""
    port: int = 0
    path: str = ""
    baud: int = 0

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        texts = {"sim": f"sim:{self.path}", "serial": f"{self.path}:{self.baud}", "log": self.path}
        return texts.get(self.kind, f"{self.kind}:{host}:{self.port}")


class Form(NamedTuple):
    """One row of the table: a kind, what it is called, an example and what it does."""

    kind: Kind
    names: tuple[str, ...]
    example: str
    meaning: str


FORMS: tuple[Form, ...] = (
    Form("sim", ("sim",), "sim:", "the built-in simulated vehicle; sim:flight has it fly"),
    Form(
        "udpin",
        ("udpin", "udp"),
        "udpin:127.0.0.1:14550",
        "listen for UDP here (without a host: on this computer only)",
    ),
    Form("udpout", ("udpout",), "udpout:192.168.1.7:14550", "send UDP there first, and listen"),
    Form("tcp", ("tcp", "tcpout"), "tcp:127.0.0.1:5760", "connect by TCP"),
    Form("tcpin", ("tcpin",), "tcpin:127.0.0.1:5760", "accept TCP connections here"),
    Form("serial", ("serial",), "/dev/ttyUSB0:57600", "a serial device and its baud rate"),
    Form("log", (), "flight.tlog", "a log file"),
)

_NAMES: dict[str, Form] = {name: form for form in FORMS for name in form.names}
_LISTENING = ("udpin", "tcpin")
_DEVICE = re.compile(r"(?P<path>.+?)[:,](?P<baud>[0-9]{1,9})$")
TABLES = (".csv", ".tsv", ".txt")  # what logs that are tables are called
_WINDOWS_PORT = re.compile(r"COM\d+$", re.IGNORECASE)


def endpoint_help(kinds: tuple[Kind, ...] | None = None) -> str:
    """The table as text, one address form a line; ``kinds`` chooses the rows."""
    rows = [form for form in FORMS if kinds is None or form.kind in kinds]
    width = max(len(form.example) for form in rows)
    return "\n".join(f"{form.example:<{width}}  {form.meaning}" for form in rows)


def columns_beside(table: Path) -> Path:
    """Where a person may describe a table's columns."""
    return table.with_suffix(".toml")


def is_bag_folder(path: Path) -> bool:
    """Whether it is the folder of a ROS 2 bag, which is a log."""
    return (path / "metadata.yaml").is_file()


def parse_endpoint(text: str) -> Endpoint:
    """What ``text`` names.

    Raises:
        InputError: no form fits, a part is missing or out of range, or there is no such file.
    """
    address = text.strip()
    if not address:
        raise InputError(f"the source is empty: {_choices()}")
    name, colon, rest = address.partition(":")
    form = _NAMES.get(name.lower()) if colon else None
    if form is None:
        return _device_or_log(address)
    rest = rest.removeprefix("//")
    if form.kind == "sim":
        return Endpoint("sim", path=rest)
    if form.kind == "serial":
        return _serial(rest, text)
    return _socket(form, rest, text)


def _socket(form: Form, rest: str, text: str) -> Endpoint:
    host, separator, port_text = rest.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not separator and not rest.isdigit():
        raise InputError(f"{text!r} has no port: write it like {form.example}")
    if not re.fullmatch("[0-9]{1,9}", port_text) or not 0 < int(port_text) < 65536:
        raise InputError(
            f"{text!r}: the port must be 1 to 65535, not {port_text!r}, as in {form.example}"
        )
    if not host and form.kind not in _LISTENING:
        raise InputError(f"{text!r} has no host: write it like {form.example}")
    if any(c in host for c in "/ @?#") or host.count(":") == 1:
        raise InputError(f"{text!r}: {host!r} is no host name: write it like {form.example}")
    return Endpoint(form.kind, host=host or LOOPBACK, port=int(port_text))


def _serial(rest: str, text: str) -> Endpoint:
    device = _DEVICE.fullmatch(rest)
    if device is None or int(device["baud"]) == 0:
        path = re.sub("[:,][^/:,]*$", "", rest) or "/dev/ttyUSB0"
        raise InputError(f"{text!r} has no baud rate: write it like {path}:57600")
    return Endpoint("serial", path=device["path"], baud=int(device["baud"]))


def _device_or_log(address: str) -> Endpoint:
    device = _DEVICE.fullmatch(address)
    if _is_device(address) or (device is not None and _is_device(device["path"])):
        return _serial(address, address)
    path = Path(address)
    try:
        if path.is_file() or is_bag_folder(path):
            return Endpoint("log", path=address)
        is_folder, is_there = path.is_dir(), path.exists()
    except (OSError, ValueError) as error:  # a name too long, a null byte
        raise InputError(f"{address[:80]!r} is no source: {_choices()}") from error
    if is_folder:
        raise InputError(f"{address!r} is a folder: name a log file in it")
    if is_there:
        raise InputError(f"{address!r} is no file but a pipe or a socket: {_choices()}")
    raise InputError(_unknown(address))


def _is_device(path: str) -> bool:
    if path.startswith("/dev/") or _WINDOWS_PORT.fullmatch(path):
        return True
    try:
        return Path(path).is_char_device()
    except (OSError, ValueError):
        return False


def _unknown(address: str) -> str:
    name, colon, rest = address.partition(":")
    if address.isdecimal() or (rest.isdecimal() and re.fullmatch(r"[\d.]+|localhost", name)):
        port, host = (rest, name) if colon else (address, LOOPBACK)
        choice = f"'udpin:{host}:{port}', 'udpout:{host}:{port}' or 'tcp:{host}:{port}'"
        return f"unknown source {address!r}: did you mean {choice}?"
    near = get_close_matches(name.lower(), _NAMES, n=1)
    if near and not rest and near[0] != "sim" and name.lower() in _NAMES:
        return f"unknown source {address!r}: write it like {_NAMES[near[0]].example}"
    if near and (colon or name.lower() in _NAMES):
        return f"unknown source {address!r}: did you mean '{near[0]}:{rest}'?"
    if colon and "/" not in name and "\\" not in name and len(name) > 1:
        return f"unknown kind of source {name!r} in {address!r}: {_choices()}"
    return f"no such file: {address!r} (other sources: {_choices('log')})"


def _choices(without: str = "") -> str:
    return "choose " + ", ".join(form.example for form in FORMS if form.kind != without)
