"""``fuzzbee run --workers N``: the live service with its vehicles shared out to N processes."""

import time
from contextlib import ExitStack

from drivers.mavlink.decoder import MavlinkDecoder
from estimator.errors import InputError
from estimator.profile import Profile
from fuzzbee import outputs
from fuzzbee.live_source import open_link, open_recorder
from fuzzbee.recordings import Recordings
from fuzzbee.run_options import RunOptions
from fuzzbee.say import say
from fuzzbee.serving import (
    FAILED,
    Prepared,
    closed_if_unused,
    conclude,
    open_view,
    open_zenoh_sink,
    prepare,
    run_loop,
    summary,
)
from fuzzbee.zenoh_options import opened, opening
from service.sinks.outbox import Outbox
from service.workers.crew import Crew, CrewError
from service.workers.foreman import Foreman
from service.workers.handout import Handout
from service.workers.job import Job


def serve_workers(options: RunOptions) -> int:
    """Open everything, loop until the end, close everything, and report the result.

    Returns 1 if no vehicle was heard in the time given, or if workers die again and again, else 0.

    Raises:
        InputError: a source, profile, file or address that cannot be used.
    """
    try:
        return _serve(options, prepare(options))
    except CrewError as error:
        say(str(error))
        return FAILED


def _serve(options: RunOptions, prepared: Prepared) -> int:
    profile = prepared.profile
    conflicts: list[InputError] = []
    recordings = Recordings()
    as_records = options.outputs.needs_records
    with ExitStack() as stack:
        wanted = MavlinkDecoder(references=options.outputs.shows_peers).wanted
        handout = Handout(options.workers, wanted)
        # before anything else: it loads and compiles while the rest is opened
        crew = stack.enter_context(_crew(options, profile, handout))
        awaited = stack.enter_context(opening(None if options.no_zenoh else options.zenoh))
        session = None if awaited is None else opened(awaited, stack)
        recorder = open_recorder(options.record, stack)
        with closed_if_unused() as sinks:
            open_zenoh_sink(
                sinks,
                session,
                options,
                profile,
                crew.requests,
                conflicts,
                takes_encoded=not as_records,
            )
            outputs.open_outputs(sinks, options.outputs, session, options.zenoh.prefix, profile)
            crew.begin()
            sinks.append(open_view(options))
            source = open_link(prepared.endpoint, options, prepared.key, recorder, stack, handout)
            outbox = stack.enter_context(Outbox(sinks))
            recordings.add([recorder, *sinks])
            crew.status.recording = lambda: recordings.word
            sinks.clear()
        foreman = Foreman(source, crew, handout, outbox, shows=not as_records)
        seconds, failure = run_loop(foreman, options.seconds, conflicts)
    status = crew.status
    tally = crew.tally
    result = summary(
        options,
        prepared.profile_name,
        seconds,
        tally._replace(vehicles=dict(sorted(tally.vehicles.items()))),
        lost=status.lost,
        malformed=status.malformed,
        refused=status.refused + tally.refused,
        recording=recordings.word,
        workers={"workers": options.workers, "restarts": status.restarts},
    )
    problems = [failure, *conflicts]
    return conclude(options, result, outbox, problems, was_stopped=foreman.was_stopped)


def _crew(options: RunOptions, profile: Profile, handout: Handout) -> Crew:
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
    return Crew(options.workers, job, handout)
