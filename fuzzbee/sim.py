"""``fuzzbee sim``: the simulated vehicle as a MAVLink process."""

import json
import threading
import time
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import typer

from drivers.endpoint import FORMS, Endpoint, Kind, endpoint_help, parse_endpoint
from estimator.errors import InputError
from fuzzbee import options as opt
from fuzzbee.notify import notify
from service.signals import stop_on_signals

if TYPE_CHECKING:
    from drivers.mavlink.connection import Connection
    from drivers.simulation.autopilot import VehicleOptions
    from drivers.simulation.fleet import Fleet

LINK_KINDS: tuple[Kind, ...] = ("udpout", "udpin", "tcp", "tcpin")
LINK_NAMES = frozenset(name for form in FORMS if form.kind in LINK_KINDS for name in form.names)
EXAMPLE = "--to udpout:127.0.0.1:14550"
MOTIONS = ("paper", "rest", "turn", "flight", "bench")
_MOTION = (
    "the paper's, none or a level turn, on the paper's signals; a copter's flight;"
    " or its IMU turned by hand"
)
_KEY = "sign with the key (32 bytes, 64 hex digits) or pass phrase in this file"
_ERRORS = "constant errors of the sensors, for calibrate; vehicle i has SEED + i - 1"
# One paragraph for each form. The help text is wrapped anew, so columns would not stay aligned.
_LINK_HELP = "\n\n".join(" ".join(row.split()) for row in endpoint_help(LINK_KINDS).splitlines())

_notify = partial(notify, who="fuzzbee sim: ")
link, vehicle = (partial(opt.option, rich_help_panel=panel) for panel in ("Link", "Vehicle"))


class SimOptions(NamedTuple):
    """The options of the verb; the help has them by panels."""

    to: str | None = link(_LINK_HELP, metavar="URL")
    url: str | None = typer.Argument(None, help="The same as --to.", hidden=True)
    drop: float = link("probability that a frame is lost", default=0.0, metavar="P")
    signing_key_file: Path | None = link(_KEY)
    insecure_key_file: bool = link(opt.INSECURE, default=False)
    vehicles: int = vehicle("system ids 1 to N on one link", default=1, metavar="N")
    rate_hz: float = vehicle("samples a second", "--rate", default=100.0, metavar="HZ")
    seconds: float | None = vehicle("end after N seconds instead of on Ctrl-C", metavar="N")
    motion: str = vehicle(_MOTION, default="paper", metavar="|".join(MOTIONS), words=MOTIONS)
    seed: int = vehicle("of the noise; vehicle i has seed + i - 1", default=0, metavar="N")
    noise: float = vehicle("factor on the motion's noise", default=1.0, metavar="X")
    bias: float = vehicle("factor on the motion's bias", default=1.0, metavar="X")
    magnet: str | None = vehicle("a magnet passes between these times (s)", metavar="T0:T1")
    calm: bool = vehicle("a flight without its magnet and its silence", default=False)
    errors_seed: int | None = vehicle(_ERRORS, "--imu-errors", metavar="SEED")
    as_json: bool = opt.JSON


@opt.command(
    "fuzzbee sim --to udpout:127.0.0.1:14550 --motion flight",
    "fuzzbee sim --to tcpin:127.0.0.1:5760 --vehicles 3 --rate 50 --motion turn",
)
def sim(options: SimOptions) -> int:
    """Run simulated vehicles that speak MAVLink.

    They send HEARTBEAT, RAW_IMU, SIM_STATE (the truth), ATTITUDE and ATTITUDE_QUATERNION (the
    truth, too), in flight GLOBAL_POSITION_INT, and answer SET_MESSAGE_INTERVAL and parameter
    requests. AUTOPILOT_VERSION shows fuzzbee run whose they are: it takes the profile that fits.
    """
    stop = threading.Event()
    with stop_on_signals(stop.set):
        from drivers.mavlink.connection import Connection
        from drivers.simulation.fleet import Fleet, run_vehicles

        endpoint = _link(options.to or options.url)
        seconds, vehicles = options.seconds, options.vehicles
        opt.require_positive(options, "seconds")
        fleet = Fleet(_vehicle_options(options), vehicles)
        connection = Connection(endpoint, report=_notify)
        connection.open()
        count = f"{vehicles} vehicle{'s' * (vehicles > 1)}"
        _notify(f"{count} at {options.rate_hz:g} Hz, {connection.address}")
        errors = {} if options.errors_seed is None else _imu_errors(options.errors_seed)
        for name, value in errors.items():
            _notify(f"{name}: {value}")
        begun_s = time.monotonic()
        run_vehicles(fleet, connection, stop.is_set, seconds, _notify)
        if options.as_json:
            _print_json(connection, options, fleet, time.monotonic() - begun_s, errors)
        if seconds is not None and not connection.was_up and not stop.is_set():
            _notify(f"{endpoint}: nobody was connected in {seconds:g} s")
            return 1
        return 0


def _vehicle_options(options: SimOptions) -> "VehicleOptions":
    from drivers.simulation.autopilot import VehicleOptions
    from fuzzbee.security import key_of

    magnet: tuple[float, float] | None = None
    if options.magnet is not None:
        begin, _, end = options.magnet.partition(":")
        try:
            magnet = float(begin), float(end)
        except ValueError as error:
            wrong = f"--magnet takes two times like 5:8 (s), not {options.magnet!r}"
            raise InputError(wrong) from error
    key = key_of(options.signing_key_file, is_insecure=options.insecure_key_file)
    names = {each.name for each in fields(VehicleOptions)}
    same = {name: value for name, value in options._asdict().items() if name in names}
    return VehicleOptions(**{**same, "magnet": magnet, "signing_key": key})


def _print_json(
    link: "Connection", options: SimOptions, fleet: "Fleet", seconds: float, errors: dict[str, Any]
) -> None:
    result = {
        "to": str(link.endpoint),
        **{name: getattr(options, name) for name in ("vehicles", "rate_hz", "motion", "seed")},
        "seconds": round(seconds, 3),
        "bytes_sent": fleet.bytes_sent,
        "link_errors": link.breaks,
    }
    print(json.dumps(result | {"imu_errors": errors} if errors else result), flush=True)


def _imu_errors(seed: int) -> dict[str, Any]:
    """The truth of ``--imu-errors`` of vehicle 1: the profile's [calibration] that undoes it."""
    import numpy as np

    from drivers.simulation.simulated_vehicle import imu_errors

    names = ("gyr_bias_rad_s", "acc_bias_m_s2", "mag_offset_gauss")
    errors: dict[str, Any] = {}
    for name, (matrix, bias) in zip(names, imu_errors(seed), strict=True):
        errors[name] = bias.round(5).tolist()
        errors[f"{name[:3]}_matrix"] = np.linalg.inv(matrix).round(5).tolist()
    return errors


def _link(text: str | None) -> Endpoint:
    if text is None:
        raise InputError(f"a link to send on is needed, as in {EXAMPLE}")
    name, colon, _ = text.partition(":")
    if not colon or name.strip().lower() not in LINK_NAMES:
        kinds = ", ".join(LINK_KINDS)
        raise InputError(f"--to {text}: the vehicle speaks over {kinds}, as in {EXAMPLE}")
    return parse_endpoint(text)
