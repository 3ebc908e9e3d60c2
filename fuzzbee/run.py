"""``fuzzbee run``: the live service."""

from estimator.errors import InputError
from fuzzbee import outputs
from fuzzbee.options import command, examples, require_gain, require_positive
from fuzzbee.run_options import RunOptions
from fuzzbee.security import parse_system_ids
from fuzzbee.zenoh_options import opening

MAX_RATE_HZ = 1000.0

EPILOG = examples(
    "fuzzbee run sim:flight",
    "fuzzbee run udpin:127.0.0.1:14550 --rate 50",
    "fuzzbee run /dev/ttyUSB0:57600 --request-rate 50 --record flight.tlog",
    "fuzzbee run flight.tlog --speed 4",
    "fuzzbee run tcp:127.0.0.1:5760 -m client -e tcp/192.168.1.10:7447",
)


@command
def run(options: RunOptions) -> int:
    """Estimate attitudes live and publish them."""
    _require_numbers(options)
    if options.outputs.send_as is not None and options.outputs.send_attitude is None:
        raise InputError(f"--as {options.outputs.send_as}: needs --send-attitude URL")
    parse_system_ids(options.security.allow_system_ids)
    asked = (("--record", options.record), ("--rrd", options.outputs.rrd))
    inputs = (options.source, options.profile, options.security.signing_key_file)
    outputs.require_own_files(asked, (*inputs, options.zenoh.config_file))
    with opening(None if options.no_zenoh else options.zenoh) as session:
        from fuzzbee.serve import serve

        return serve(options, session)


def _require_numbers(options: RunOptions) -> None:
    require_positive("--rate", options.rate_hz)
    if options.rate_hz > MAX_RATE_HZ:
        raise InputError(f"--rate {options.rate_hz:g}: should be at most {MAX_RATE_HZ:g}")
    require_positive("--seconds", options.seconds)
    require_positive("--request-rate", options.request_rate_hz)
    require_positive("--speed", options.speed)
    require_gain(options.gain)
    if options.system_id is not None and not 1 <= options.system_id <= 255:
        raise InputError(f"--system-id {options.system_id}: should be 1 to 255")
