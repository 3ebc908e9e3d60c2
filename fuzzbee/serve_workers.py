"""``fuzzbee run --workers N``: the live service with its vehicles shared out to N processes."""

import time
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from estimator.errors import InputError
from fuzzbee import outputs, security
from fuzzbee.live_source import default_profile, open_link, open_recorder, require_fitting
from fuzzbee.run_options import RunOptions
from fuzzbee.say import say
from fuzzbee.serve import (
    FAILED,
    OK,
    closed_if_unused,
    open_view,
    open_zenoh,
    prefix_of,
    report,
    vehicle_summary,
    zenoh_sinks,
)
from fuzzbee.worker_options import require_shareable

if TYPE_CHECKING:
    from estimator.profile import Profile
    from service.workers.crew import Crew
    from service.workers.foreman import Foreman
    from service.workers.handout import Handout


def serve_workers(options: RunOptions, *, verbose: bool) -> int:
    """Open everything, loop until the end, close everything, and report the result.

    Returns 1 if no vehicle was heard in the time given, or if workers die again and again, else 0.

    Raises:
        InputError: a source, profile, file or address that cannot be used.
    """
    from drivers.endpoint import parse_endpoint
    from drivers.source import require_openable
    from estimator.profile import load_profile
    from service.sinks.outbox import Outbox
    from service.workers.crew import CrewError
    from service.workers.foreman import Foreman

    endpoint = parse_endpoint(options.source)
    require_shareable(options, endpoint)
    require_openable(endpoint)
    profile = load_profile(options.profile or default_profile(endpoint))
    key = security.read_key(options.security)
    require_fitting(options, endpoint)
    outputs.viewer_options(options.outputs.view, options.outputs.rrd)
    conflicts: list[InputError] = []
    with ExitStack() as stack:
        handout = _handout(options)
        # before anything else: it loads and compiles while the rest is opened
        crew = stack.enter_context(_crew(options, profile, handout))
        session = open_zenoh(options.zenoh, stack)
        recorder = None if options.record is None else open_recorder(options.record, stack)
        with closed_if_unused() as sinks:
            as_records = options.outputs.needs_records
            sinks.extend(
                zenoh_sinks(
                    session,
                    options,
                    profile,
                    crew.requests,
                    conflicts,
                    takes_encoded=not as_records,
                )
            )
            outputs.open_outputs(sinks, options.outputs, session, prefix_of(options), profile)
            try:
                crew.begin()
            except CrewError as error:
                return _fail(error)
            sinks.append(open_view(options, verbose=verbose))
            source = open_link(endpoint, options, key, recorder, stack, handout)
            outbox = stack.enter_context(Outbox(sinks))
            sinks.clear()
        foreman = Foreman(source, crew, handout, outbox, shows=not as_records)
        seconds, failure = _run(foreman, options.seconds, conflicts)
    if outbox.stuck:
        say(f"not closed in time: {', '.join(outbox.stuck)}")
    result = summary(options, crew, seconds)
    report(result, as_json=options.as_json)
    if isinstance(failure, CrewError):
        return _fail(failure)
    for problem in (failure, *conflicts):
        if problem is not None:
            raise problem
    heard = result["vehicles"] or result["departed"]["vehicles"] or result["refused"]
    heard_nobody = not heard and not foreman.was_stopped
    return FAILED if heard_nobody and options.seconds is not None else OK


def _run(
    foreman: "Foreman", seconds: float | None, conflicts: list[InputError]
) -> tuple[float, Exception | None]:
    """Loop until the end; returns how long, and what went wrong."""
    from service.signals import stop_on_signals
    from service.steady import steady

    started_s = time.monotonic()
    failure: Exception | None = None
    with steady(), stop_on_signals(foreman.stop):
        try:
            foreman.run(seconds, lambda: bool(conflicts))
        except Exception as error:  # noqa: BLE001 - raised again when all is said
            failure = error
    return time.monotonic() - started_s, failure


def _handout(options: RunOptions) -> "Handout":
    from drivers.mavlink.decoder import MavlinkDecoder
    from service.workers.handout import Handout

    return Handout(options.workers, MavlinkDecoder(references=options.outputs.shows_peers).wanted)


def _crew(options: RunOptions, profile: "Profile", handout: "Handout") -> "Crew":
    from service.workers.crew import Crew
    from service.workers.job import Job

    job = Job(
        profile=profile,
        gain=options.gain,
        rate_hz=options.rate_hz,
        system_id=options.system_id,
        fits_built_in=options.profile is None,
        request_rate_hz=options.request_rate_hz,
        references=options.outputs.shows_peers,
        as_records=options.outputs.needs_records,
        begin_s=time.monotonic(),
        inherited={},
    )
    return Crew(options.workers, job, handout, with_raw=options.profile is None)


def _fail(error: Exception) -> int:
    say(str(error))
    return FAILED


def summary(options: RunOptions, crew: "Crew", seconds: float) -> dict[str, Any]:
    """The result of a run, as --json prints it."""
    from service.records import vehicle_name

    status = crew.status
    tally = status.tally
    gone, gone_samples, gone_attitudes = tally.departures
    return {
        "source": options.source,
        "profile": options.profile or "imu",
        "rate_hz": options.rate_hz,
        "seconds": round(seconds, 3),
        "workers": options.workers,
        "restarts": status.restarts,
        "ticks": tally.ticks,
        "overruns": tally.overruns,
        "dropped": tally.dropped,
        "lost": crew.status.lost,
        "malformed": status.malformed,
        "refused": dict(sorted(status.refused.items())),
        "departed": {"vehicles": gone, "samples": gone_samples, "attitudes": gone_attitudes},
        "vehicles": {
            vehicle_name(vehicle): vehicle_summary(counts)
            for vehicle, counts in sorted(tally.vehicles.items())
        },
    }
