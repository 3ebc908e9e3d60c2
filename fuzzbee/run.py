"""``fuzzbee run``: the live service."""

from typing import TYPE_CHECKING, Annotated

import typer

from estimator.errors import InputError
from fuzzbee import outputs, security, zenoh_options
from fuzzbee.options import Json, Seconds, Verbose, require_gain, require_positive
from fuzzbee.run_options import RunOptions
from fuzzbee.worker_options import require_workers

if TYPE_CHECKING:
    pass

MAX_RATE_HZ = 1000.0

EPILOG = """Examples:

  fuzzbee run sim:flight

  fuzzbee run udpin:127.0.0.1:14550 --rate 50

  fuzzbee run /dev/ttyUSB0:57600 --request-rate 50 --record flight.tlog

  fuzzbee run flight.tlog --speed 4

  fuzzbee run tcp:127.0.0.1:5760 -m client -e tcp/192.168.1.10:7447"""


def run(
    source: Annotated[
        str,
        typer.Argument(
            help="sim:, sim:flight, udpin:H:P, udpout:H:P, tcp:H:P, tcpin:H:P, DEVICE:BAUD or a log"
            " file."
        ),
    ] = "sim:",
    rate: Annotated[
        float, typer.Option("--rate", metavar="HZ", help="Attitudes a second.")
    ] = 100.0,
    seconds: Seconds = None,
    profile: Annotated[
        str | None,
        typer.Option(
            "--profile",
            metavar="NAME|FILE",
            help="paper, imu, adaptive or a TOML file. Default: imu, but for fuzzbee's own"
            " vehicle with the paper's signals: paper.",
            autocompletion=lambda: ["paper", "imu", "adaptive"],
        ),
    ] = None,
    gain: Annotated[
        float | None,
        typer.Option("--gain", metavar="K", help="A fixed gain instead of the fuzzy one."),
    ] = None,
    as_json: Json = False,
    record: Annotated[
        str | None,
        typer.Option(
            "--record",
            metavar="FILE|DIR",
            help="Record what arrives: FILE.tlog, or a folder for a file an hour.",
        ),
    ] = None,
    request_rate: Annotated[
        float | None,
        typer.Option("--request-rate", metavar="HZ", help="Ask the vehicle for this IMU rate."),
    ] = None,
    speed: Annotated[
        float, typer.Option("--speed", metavar="X", help="Play a log X times as fast.")
    ] = 1.0,
    system_id: Annotated[
        int | None, typer.Option("--system-id", metavar="ID", help="Only this vehicle.")
    ] = None,
    retune: Annotated[
        bool,
        typer.Option("--retune", help="Retune a few numbers whenever the sensors' noise changes."),
    ] = False,
    workers: Annotated[
        int,
        typer.Option("--workers", metavar="N", help="Share the vehicles out to N processes."),
    ] = 1,
    allow_system_ids: security.AllowSystemIds = None,
    signing_key_file: security.SigningKeyFile = None,
    no_zenoh: Annotated[bool, typer.Option("--no-zenoh", help="Publish nothing.")] = False,
    ros: outputs.Ros = False,
    ros_domain: outputs.RosDomain = 0,
    send_attitude: outputs.SendAttitude = None,
    metrics: outputs.Metrics = None,
    view: outputs.View = None,
    rrd: outputs.Rrd = None,
    listen: zenoh_options.Listen = None,
    connect: zenoh_options.Connect = None,
    mode: zenoh_options.Mode = "peer",
    config_file: zenoh_options.ConfigFile = None,
    settings: zenoh_options.Settings = None,
    multicast: zenoh_options.Multicast = False,
    prefix: zenoh_options.Prefix = "fuzzbee",
    second: Annotated[
        bool,
        typer.Option(
            "--second",
            help="Publish even if another service publishes the same vehicle.",
            rich_help_panel=zenoh_options.PANEL,
        ),
    ] = False,
    verbose: Verbose = False,
) -> int:
    """Estimate attitudes live and publish them on Zenoh."""
    require_positive("--rate", rate)
    if rate > MAX_RATE_HZ:
        raise InputError(f"--rate {rate:g}: should be at most {MAX_RATE_HZ:g}")
    for option, value in (
        ("--seconds", seconds),
        ("--request-rate", request_rate),
        ("--speed", speed),
    ):
        require_positive(option, value)
    require_gain(gain)
    if system_id is not None and not 1 <= system_id <= 255:
        raise InputError(f"--system-id {system_id}: should be 1 to 255")
    require_workers(workers)
    outputs.require_own_file(rrd, [source])
    zenoh = zenoh_options.zenoh_options(
        listen=listen,
        connect=connect,
        mode=mode,
        config_file=config_file,
        settings=settings,
        multicast=multicast,
        prefix=prefix,
    )
    options = RunOptions(
        source=source,
        rate_hz=rate,
        seconds=seconds,
        profile=profile,
        gain=gain,
        as_json=as_json,
        record=record,
        request_rate_hz=request_rate,
        speed=speed,
        system_id=system_id,
        retune=retune,
        zenoh=None if no_zenoh else zenoh,
        outputs=outputs.OutputOptions(
            ros=ros,
            ros_domain=ros_domain,
            send_attitude=send_attitude,
            metrics_port=metrics,
            view=view,
            rrd=rrd,
        ),
        security=security.SecurityOptions(
            security.parse_system_ids(allow_system_ids), signing_key_file
        ),
        second=second,
        workers=workers,
    )
    if workers > 1:
        from fuzzbee.serve_workers import serve_workers

        return serve_workers(options, verbose=verbose)
    from fuzzbee.serve import serve

    return serve(options, verbose=verbose)
