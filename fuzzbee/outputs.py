"""What ``run`` sends and shows beside its own keys: options, and the sinks they open."""

from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from estimator.errors import InputError

if TYPE_CHECKING:
    import zenoh

    from service.sinks import Sink

PANEL = "Outputs"
MAX_PORT = 65535

Ros = Annotated[
    bool,
    typer.Option(
        "--ros", help="Publish sensor_msgs/Imu for ROS 2 (rmw_zenoh), too.", rich_help_panel=PANEL
    ),
]
RosDomain = Annotated[
    int,
    typer.Option(
        "--ros-domain",
        metavar="ID",
        envvar="ROS_DOMAIN_ID",
        help="The ROS 2 domain of --ros.",
        rich_help_panel=PANEL,
    ),
]
SendAttitude = Annotated[
    str | None,
    typer.Option(
        "--send-attitude",
        metavar="URL",
        help="Send ATTITUDE_QUATERNION there, as component 191 (not the autopilot).",
        rich_help_panel=PANEL,
    ),
]
Metrics = Annotated[
    int | None,
    typer.Option(
        "--metrics",
        metavar="PORT",
        help="Serve Prometheus metrics on 127.0.0.1 (extra: metrics).",
        rich_help_panel=PANEL,
    ),
]


class OutputOptions(NamedTuple):
    """What was asked for."""

    ros: bool = False
    ros_domain: int = 0
    send_attitude: str | None = None
    metrics_port: int | None = None


def open_outputs(
    options: OutputOptions, session: "zenoh.Session | None", prefix: str
) -> "list[Sink]":
    """The sinks, open.

    Raises:
        InputError: an address, port or file that cannot be used, or an extra that is missing.
    """
    sinks: list[Sink] = []
    if options.ros:
        sinks.append(_ros(options, session, prefix))
    if options.send_attitude is not None:
        sinks.append(_mavlink(options.send_attitude))
    if options.metrics_port is not None:
        sinks.append(_metrics(options.metrics_port))
    return sinks


def _ros(options: OutputOptions, session: "zenoh.Session | None", prefix: str) -> "Sink":
    from service.ros_sink import MAX_DOMAIN, RosSink

    if session is None:
        raise InputError("--ros needs Zenoh: leave out --no-zenoh")
    if not 0 <= options.ros_domain <= MAX_DOMAIN:
        raise InputError(f"--ros-domain {options.ros_domain}: should be 0 to {MAX_DOMAIN}")
    return RosSink(session, prefix, options.ros_domain)


def _mavlink(address: str) -> "Sink":
    from drivers.endpoint import parse_endpoint
    from service.mavlink_sink import MavlinkSink

    try:
        return MavlinkSink(parse_endpoint(address))
    except InputError as error:
        raise InputError(f"--send-attitude: {error}") from error


def _metrics(port: int) -> "Sink":
    from service.metrics_sink import MetricsSink

    if not 1 <= port <= MAX_PORT:
        raise InputError(f"--metrics {port}: the port must be 1 to {MAX_PORT}")
    return MetricsSink(port)
