"""What ``run`` sends and shows beside its Zenoh keys: the options, and the sinks they open."""

from collections.abc import Iterable
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

from estimator.errors import InputError
from fuzzbee.options import panel
from fuzzbee.say import say

if TYPE_CHECKING:
    import zenoh

    from estimator.profile import Profile
    from fuzzbee.viewer.stream import ViewerOptions, ViewerStream
    from fuzzbee.viewer.viewer import ViewerSink
    from service.sinks.sink import Sink

MAX_PORT = 65535
WINDOW, WEB = "window", "web"

option = panel("Outputs")
_VIEW = "Show it in Rerun: a window, or a page for a browser (extra: viewer)."
_RRD = "Save what the viewer shows, for rerun FILE (extra: viewer)."
View = Annotated[str | None, option(_VIEW, metavar="window|web")]
Rrd = Annotated[str | None, option(_RRD, metavar="FILE")]
_ROS = "Publish IMU, tf and diagnostics for ROS 2 (rmw_zenoh), too."
_SEND_ATTITUDE = "Send ATTITUDE_QUATERNION there, as component 191 (not the autopilot)."
_METRICS = "Serve Prometheus metrics on 127.0.0.1 (extra: metrics)."


class OutputOptions(NamedTuple):
    """What was asked for."""

    ros: Annotated[bool, option(_ROS)] = False
    ros_domain: Annotated[
        int, option("The ROS 2 domain of --ros.", metavar="ID", envvar="ROS_DOMAIN_ID")
    ] = 0
    send_attitude: Annotated[str | None, option(_SEND_ATTITUDE, metavar="URL")] = None
    metrics: Annotated[int | None, option(_METRICS, metavar="PORT")] = None  # the port
    view: View = None
    rrd: Rrd = None

    @property
    def shows_peers(self) -> bool:
        """Whether attitudes by others are shown; if not, they need not be decoded."""
        return self.view is not None or self.rrd is not None

    @property
    def needs_records(self) -> bool:
        """Whether somebody takes every attitude apart, rather than a few a second or none."""
        return self.ros or self.send_attitude is not None or self.shows_peers


def open_outputs(
    sinks: "list[Sink]",
    options: OutputOptions,
    session: "zenoh.Session | None",
    prefix: str,
    profile: "Profile",
) -> None:
    """Open the sinks that were asked for, and add each to ``sinks`` once it is open.

    Raises:
        InputError: an address, port or file that cannot be used, or an extra that is missing.
    """
    if options.ros:
        sinks.append(_ros(options, session, prefix))
    if options.send_attitude is not None:
        sinks.append(_mavlink(options.send_attitude))
    if options.metrics is not None:
        sinks.append(_metrics(options.metrics))
    viewer = open_viewer(options.view, options.rrd, profile, live=True)
    if viewer is not None:
        sinks.append(viewer)


def open_viewer(
    view: str | None, rrd: str | None, profile: "Profile", *, live: bool = False
) -> "ViewerSink | None":
    """The viewer that was asked for, if any; says where its page is.

    Raises:
        InputError: the extra is missing, the viewer does not start, or the file cannot be written.
    """
    options = viewer_options(view, rrd)
    if options is None:
        return None
    from fuzzbee.viewer.viewer import ViewerSink

    sink = ViewerSink(options._replace(live=live), profile)
    tell_page(sink.stream)
    return sink


def viewer_options(view: str | None, rrd: str | None) -> "ViewerOptions | None":
    """The viewer that the options ask for; None if they ask for none.

    Raises:
        InputError: no such view, or the extra is missing.
    """
    if view is None and rrd is None:
        return None
    if view not in (None, WINDOW, WEB):
        raise InputError(f"--view {view}: should be {WINDOW} or {WEB}")
    if find_spec("rerun") is None:
        from fuzzbee.viewer.process import MISSING

        raise InputError(MISSING)
    from fuzzbee.viewer.stream import ViewerOptions

    return ViewerOptions(view, rrd)


def require_own_file(rrd: str | None, others: Iterable[str | Path]) -> None:
    """Refuse a viewer's file that is one of the ``others``.

    Raises:
        InputError: it would overwrite one of them.
    """
    if rrd is None or not Path(rrd).exists():
        return
    for other in others:
        if Path(other).exists() and Path(rrd).samefile(other):
            raise InputError(f"--rrd {rrd}: is also {other}")


def tell_page(stream: "ViewerStream") -> None:
    """Tell a person where a browser finds the page."""
    if stream.page is not None:
        say(f"the viewer is at {stream.page}")


def _ros(options: OutputOptions, session: "zenoh.Session | None", prefix: str) -> "Sink":
    from service.sinks.ros import MAX_DOMAIN, RosSink

    if session is None:
        raise InputError("--ros needs Zenoh: leave out --no-zenoh")
    if not 0 <= options.ros_domain <= MAX_DOMAIN:
        raise InputError(f"--ros-domain {options.ros_domain}: should be 0 to {MAX_DOMAIN}")
    return RosSink(session, prefix, options.ros_domain)


def _mavlink(address: str) -> "Sink":
    from drivers.endpoint import parse_endpoint
    from service.sinks.mavlink import MavlinkSink

    try:
        return MavlinkSink(parse_endpoint(address))
    except InputError as error:
        raise InputError(f"--send-attitude: {error}") from error


def _metrics(port: int) -> "Sink":
    from service.sinks.metrics import MetricsSink

    if not 1 <= port <= MAX_PORT:
        raise InputError(f"--metrics {port}: the port must be 1 to {MAX_PORT}")
    return MetricsSink(port)
