"""A Zenoh session from a few options.

By default a session is a peer that both listens on and connects to one
well-known loopback address. The first session gets the address; the others
connect to it, or to a router already there. Each session also listens on a
free loopback port: peers do not relay for each other, so a third one must be
able to reach the second directly (they learn of each other by gossip). When
the first one ends, the address is free for the next one that starts; those that
remain connect to it as soon as it is there.
"""

import json
import re
from collections.abc import Callable, Sequence
from concurrent.futures import Future, wait
from pathlib import Path
from typing import Any, NamedTuple

import zenoh

from drivers.resources import Closing, run_in_thread
from estimator.errors import InputError, file_text
from service.signals import await_result

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
FREE_ENDPOINT = "tcp/127.0.0.1:0"
WITH_PORT = ("tcp", "udp", "tls", "quic", "ws")
# A host, or an IPv6 address in brackets, and a port; zenoh's own settings may follow.
PLACE = re.compile(r"([^/:\s\[\]?#]+|\[[0-9a-fA-F:.%]+\]):[0-9]{1,5}([?#].*)?")
RETRY = {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2}
CLIENT_TIMEOUT_MS = 2000  # then the command ends: a client is useless without its router
# Batches of 64 kB that may wait for the network; 16 is the most that Zenoh allows. It drops records
# that find all of them full for 1 ms. With its usual 2 that sometimes happened to part of a tick of
# 200 vehicles (140 kB).
TX_BATCHES = 16
MOST_BRACKETS = 4096  # it ends between 16,000 and 50,000 that are one within the other
OPENER_THREAD, CLOSER_THREAD = "zenoh opener", "zenoh closer"
# The library waits for a peer that accepts and never answers, some 8 s. Nobody else has to.
CLOSE_S = 0.6


class ZenohOptions(NamedTuple):
    """What a person may choose; empty means the default session."""

    listen: Sequence[str] = ()
    connect: Sequence[str] = ()
    mode: str = "peer"
    config_file: str | None = None
    settings: Sequence[str] = ()  # KEY:JSON5
    multicast: bool = False
    prefix: str = "fuzzbee"


class OpeningSession(Closing):
    """A session that is opened while something else is done: it looks for others for half a second.

    In a thread of its own: while the library waits for a silent peer, it lets no signal through.
    ``notify`` is given a line for a person if the session lacks something.

    Raises:
        InputError: a prefix, address or setting that cannot be used.
    """

    def __init__(self, options: ZenohOptions, notify: Callable[[str], None]) -> None:
        self._notify = notify
        self._where = ", ".join([*options.listen, *options.connect]) or DEFAULT_ENDPOINT
        self._options = options
        self._config = _config(options)
        self._opened = run_in_thread(self._any_session, OPENER_THREAD)

    def session(self) -> zenoh.Session:
        """The session, once it is open.

        Raises:
            InputError: a listening address that was asked for and is taken, or a client's
                router that is not there.
        """
        try:
            return await_result(self._opened)
        except zenoh.ZError as error:
            raise InputError(f"zenoh: {self._where}: {_one_line(error)}") from None

    def close(self) -> None:
        """Close the session as soon as it is open; does not wait for that."""

        def close_opened(opened: Future[zenoh.Session]) -> None:
            if opened.exception() is None:
                close_session(opened.result())

        self._opened.add_done_callback(close_opened)

    def _any_session(self) -> zenoh.Session:
        """With shared memory, or without where the system gives none: /dev/shm read-only or full.

        Our records are small; nothing of theirs goes through it.
        """
        try:
            return zenoh.open(self._config)
        except zenoh.ZError as error:
            if "shm" not in str(error):
                raise
            self._notify(f"zenoh: no shared memory, going on without: {_one_line(error)}")
        settings = (*self._options.settings, "transport/shared_memory/enabled:false")
        return zenoh.open(_config(self._options._replace(settings=settings)))


def close_session(session: zenoh.Session) -> None:
    """Close a session, or leave it to a thread that hangs; a closed one stays closed."""

    def close() -> None:
        if not session.is_closed():
            session.close()  # type: ignore[no-untyped-call] # the library's stub lacks the None

    wait([run_in_thread(close, CLOSER_THREAD)], CLOSE_S)


class Topic:
    """One key, its publisher, and the last record; what the network cannot take is dropped."""

    def __init__(self, session: zenoh.Session, key: str, encoding: str | None = None) -> None:
        self.key, self.last = key, b""
        drop = zenoh.CongestionControl.DROP
        self._publisher = session.declare_publisher(key, encoding=encoding, congestion_control=drop)

    def put(self, record: bytes, attachment: bytes | None = None) -> None:
        """Publish one."""
        self.last = record
        self._publisher.put(record, attachment=attachment)

    def withdraw(self) -> None:
        """Take the key back."""
        self._publisher.undeclare()  # type: ignore[no-untyped-call]


def _config(options: ZenohOptions) -> zenoh.Config:
    """The library's own; it would look for ever for what can be no address."""
    try:
        zenoh.KeyExpr(options.prefix)
    except zenoh.ZError as error:
        raise InputError(f"--prefix {options.prefix!r}: {_one_line(error)}") from None
    if "*" in options.prefix:
        raise InputError(f"--prefix {options.prefix!r}: wildcards cannot be published on")
    if options.mode not in ("peer", "client"):
        raise InputError(f"--mode {options.mode!r}: should be peer or client")
    for name, endpoints in (("--listen", options.listen), ("--connect", options.connect)):
        for endpoint in endpoints:
            protocol, _, address = endpoint.partition("/")
            place = PLACE if protocol in WITH_PORT else re.compile(".+")
            if not protocol or not place.fullmatch(address):
                raise InputError(f"{name} {endpoint!r}: should be like {DEFAULT_ENDPOINT}")
    config = _base(options)
    chosen = [(key, json.dumps(v), f"{key} {v!r}") for key, v in _chosen(options).items()]
    for setting in options.settings:
        key, colon, value = setting.partition(":")
        if not colon:
            raise InputError(f"--cfg {setting!r}: should be KEY:JSON5")
        _require_flat(value, f"--cfg {key}")
        chosen.append((key, value, f"--cfg {setting!r}"))
    for key, json5, what in chosen:
        try:
            config.insert_json5(key, json5)
        except zenoh.ZError as error:
            raise InputError(f"zenoh: {what}: {_one_line(error)}") from None
    return config


def _require_flat(json5: str, what: str) -> None:
    """Refuse what the library's parser would end the program over, nested too deep for its stack.

    Raises:
        InputError: it is.
    """
    if json5.count("[") + json5.count("{") > MOST_BRACKETS:
        raise InputError(f"zenoh: {what}: more than {MOST_BRACKETS} lists and objects")


def _base(options: ZenohOptions) -> zenoh.Config:
    if options.config_file is None:
        return zenoh.Config()
    what = f"zenoh configuration {options.config_file}"
    try:
        _require_flat(file_text(Path(options.config_file), what), what)
        return zenoh.Config.from_file(options.config_file)
    except FileNotFoundError:
        raise InputError(f"{what}: no such file") from None
    except zenoh.ZError as error:
        raise InputError(f"{what}: {_one_line(error)}") from None


def _chosen(options: ZenohOptions) -> dict[str, Any]:
    """The library's settings by key: those given, and ours if there is no file."""
    default, client = options.config_file is None, options.mode == "client"
    chosen: dict[str, Any] = {}
    if default:
        chosen["transport/link/tx/queue/size/data"] = TX_BATCHES
    if default or client:
        chosen["mode"] = options.mode
    if default or options.multicast:
        chosen["scouting/multicast/enabled"] = options.multicast
    if options.listen:
        chosen |= {"listen/endpoints": options.listen, "listen/exit_on_failure": True}
    elif default:
        chosen["listen/endpoints"] = () if client else (DEFAULT_ENDPOINT, FREE_ENDPOINT)
        # no second try: a session that still tries to listen cannot be closed (1.10.2)
        chosen |= {"listen/exit_on_failure": False, "listen/timeout_ms": 0}
    if default or options.connect:
        chosen["connect/endpoints"] = options.connect or (DEFAULT_ENDPOINT,)
        chosen["connect/exit_on_failure"] = client
        chosen["connect/timeout_ms"] = CLIENT_TIMEOUT_MS if client else -1
        chosen["connect/retry"] = RETRY
    return chosen


def _one_line(error: Exception) -> str:
    """Zenoh's message on one line, without the places in its own source code."""
    text = " ".join(str(error).split())
    quoted = re.search(r'Message { msg: "(.*?)(?: at /|", location)', text)
    if quoted:  # the JSON5 parser's message, in debugging form
        text = quoted[1].replace("\\n", " ").replace('\\"', '"')
    elif text.startswith('Str("'):
        text = text.removeprefix('Str("').split('")', 1)[0]
    text = re.sub(r"any of \[Single\((.*?)\)\]\.? *Timeout!", r"\1: nobody answers", text)
    text = text.split(" at /", 1)[0].strip(" :")
    return re.sub(r"\s+", " ", text)
