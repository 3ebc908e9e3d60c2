"""What ``run`` sends and shows beside its Zenoh keys: the table of sinks, options included."""

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from drivers.endpoint import TABLES, columns_beside, parse_endpoint
from estimator.errors import InputError
from fuzzbee import options as opt

if TYPE_CHECKING:
    import zenoh

    from drivers.events import VehicleId
    from fuzzbee.viewer.viewer import ViewerSink
    from service.sinks.sink import Sink

WEB = "Serve a light page for browsers, on 127.0.0.1 unless an address is given."
VIEW = opt.showing(
    "Show it in Rerun: a window, or a page for a browser (extra: viewer).", metavar="window|web"
)
RRD = opt.recording("Save what the viewer shows, for rerun FILE (extra: viewer).", metavar="FILE")


class SinkEntry(NamedTuple):
    """A sink's options, as :func:`setting` makes them, and what opens it if the first is given.

    What opens it takes the options of ``run`` and the session, if any; None: another sink does its
    work.
    """

    options: dict[str, tuple[Any, Any]]  # "send_attitude" is --send-attitude
    open: "Callable[[Any, zenoh.Session | None], Sink | None]"


def setting(
    kind: Any, text: str, *names: str, default: Any = None, panel: str = "Publish", **more: Any
) -> tuple[Any, Any]:
    """An option of a sink: its type, and its help and default; ``more`` goes to typer."""
    info = opt.option(text, *names, default=default, rich_help_panel=panel, **more)
    return (kind if default is not None else kind | None), info


def _ros(options: Any, session: "zenoh.Session | None") -> "Sink":
    from service.sinks.ros import MAX_DOMAIN, RosSink

    domain = options.outputs.ros_domain
    if session is None:
        raise InputError("--ros needs Zenoh: leave out --no-zenoh")
    if not 0 <= domain <= MAX_DOMAIN:
        raise InputError(f"--ros-domain {domain}: should be 0 to {MAX_DOMAIN}")
    return RosSink(session, options.zenoh.prefix, domain)


def _mavlink(options: Any, _session: Any, name: str = "send_attitude") -> "Sink | None":
    """Sends attitudes or announcements; both to the same place: there is one such component."""
    from service.sinks.mavlink import MavlinkSink

    asked, attitudes = options.outputs, name == "send_attitude"
    is_same = asked.announce == asked.send_attitude
    if is_same and not attitudes:
        return None
    given = asked.send_as if attitudes else None
    other = None if given is None else parse_address_of(given)
    announces = is_same or not attitudes
    try:
        endpoint = parse_endpoint(getattr(asked, name))
        return MavlinkSink(endpoint, attitudes=attitudes, announces=announces, appears_as=other)
    except InputError as error:
        raise InputError(f"{opt.flag_of(name)}: {error}") from error


def parse_address_of(text: str) -> "VehicleId":
    """A vehicle's address, as ``--as`` has it."""
    from drivers.events import VehicleId

    numbers = [int(part) if part.isdecimal() else 0 for part in text.split(":")]
    if len(numbers) != 2 or not all(1 <= number <= 255 for number in numbers):
        raise InputError(f"--as {text}: should be SYSTEM:COMPONENT, each 1 to 255, as 200:1")
    return VehicleId(*numbers)


def _metrics(options: Any, _session: Any) -> "Sink":
    opt.require_extra("prometheus_client", "--metrics", "metrics")
    from fuzzbee.metrics import MetricsSink

    return MetricsSink(options.outputs.metrics)


def _together(options: Any, session: "zenoh.Session | None") -> "Sink":
    from service.sinks.zenoh import TogetherSink

    if session is None:
        raise InputError("--together needs Zenoh: leave out --no-zenoh")
    return TogetherSink(session, options.zenoh.prefix, 1.0 / options.rate_hz)


def _web(options: Any, _session: Any) -> "Sink":
    from fuzzbee.web.server import open_page

    return open_page(options.outputs.web, "fuzzbee")


_ROS = "Publish IMU, tf and diagnostics for ROS 2 (rmw_zenoh), too."
_DOMAIN = "The ROS 2 domain of --ros."
_SEND = "Send ATTITUDE_QUATERNION there, as component 191 (not the autopilot)."
_AS = "With --send-attitude: as a vehicle of its own, for QGroundControl and others."
_ANNOUNCE = "Send a STATUSTEXT there while the autopilot's attitude differs, as component 191."
_METRICS = "Serve Prometheus metrics on 127.0.0.1 (extra: metrics)."
_TOGETHER = "Publish all attitudes of a tick in one put, too, at PREFIX/attitudes."
SINKS: list[SinkEntry] = [
    SinkEntry(
        {
            "ros": setting(bool, _ROS, default=False),
            "ros_domain": setting(int, _DOMAIN, default=0, metavar="ID", envvar="ROS_DOMAIN_ID"),
        },
        _ros,
    ),
    SinkEntry(
        {
            "send_attitude": setting(str, _SEND, metavar="URL"),
            "send_as": setting(str, _AS, "--as", metavar="SYSTEM:COMPONENT"),
        },
        _mavlink,
    ),
    SinkEntry(
        {"announce": setting(str, _ANNOUNCE, metavar="URL")}, partial(_mavlink, name="announce")
    ),
    SinkEntry({"metrics": setting(int, _METRICS, metavar="PORT", min=1, max=65535)}, _metrics),
    SinkEntry({"web": setting(str, WEB, panel="Show", metavar="[ADDRESS:]PORT")}, _web),
    SinkEntry({"together": setting(bool, _TOGETHER, default=False)}, _together),
]


def open_outputs(options: Any, session: "zenoh.Session | None") -> "Iterator[Sink]":
    """Open the sinks that were asked for, one after the other."""
    for entry in SINKS:
        asked = opt.asked_for(options.outputs, next(iter(entry.options)))
        if asked and (sink := entry.open(options, session)) is not None:
            yield sink
    viewer = open_viewer(options.outputs.view, options.outputs.rrd, live=True)
    if viewer is not None:
        yield viewer


def require_viewer(view: str | None, rrd: str | None) -> bool:
    """Refuse a viewer that there is not; whether the options ask for one."""
    if view is None and rrd is None:
        return False
    if view not in (None, "window", "web"):
        raise InputError(f"--view {view}: should be window or web")
    opt.require_extra("rerun", "the viewer", "viewer")
    return True


def open_viewer(view: str | None, rrd: str | None, *, live: bool = False) -> "ViewerSink | None":
    """The viewer that was asked for, if any."""
    if not require_viewer(view, rrd):
        return None
    from fuzzbee.viewer.viewer import ViewerSink

    return ViewerSink(view, rrd, live=live)


def require_own_files(
    outputs: Iterable[tuple[str, object]], inputs: Iterable[str | Path | None]
) -> None:
    """Refuse a file to be written, by its option if given, that is an input or another output.

    A link leads to the same file, by whatever name; a bag is a folder, and what a table's columns
    are stands beside it.
    """
    read = [Path(each) for each in inputs if each is not None]
    read += [columns_beside(each) for each in read if each.suffix.lower() in TABLES]
    written: list[Path] = []
    for option_name, file in outputs:
        if file is None:
            continue
        path = Path(str(file))
        folder = Path(os.path.realpath(path)).parent
        if not folder.is_dir():
            raise InputError(f"{option_name} {path}: there is no such folder")
        for other in (*read, *written):
            if _are_same(path, other):
                raise InputError(f"{option_name} {path}: is also {other}")
        for other in read:
            if folder.is_relative_to(os.path.realpath(other)):
                raise InputError(f"{option_name} {path}: is within {other}")
        written.append(path)


def _are_same(one: Path, other: Path) -> bool:
    with suppress(OSError):  # one of them is not there yet
        if one.samefile(other):
            return one.is_file()  # a device takes anything
    return os.path.realpath(one) == os.path.realpath(other)
