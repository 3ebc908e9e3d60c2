"""The live service: everything opened, one loop, everything closed."""

from contextlib import ExitStack
from typing import TYPE_CHECKING

from drivers.aside import aside
from drivers.simulation.source import SimSource
from estimator.errors import InputError
from estimator.estimator import Estimator
from estimator.profile import Profile
from fuzzbee.live_source import make_runner, open_recorded
from fuzzbee.recordings import Recordings
from fuzzbee.run_options import RunOptions
from fuzzbee.say import say
from fuzzbee.serving import (
    conclude,
    open_sinks,
    prepare,
    run_loop,
    summary,
)
from fuzzbee.truth_score import ScoredPipeline
from fuzzbee.zenoh_options import opened
from service.parameters import ParameterRequests
from service.process import load_kernels
from service.sinks.recording import RecordingSink
from service.sinks.sink import Outbox
from service.zenoh_session import OpeningSession

if TYPE_CHECKING:
    from fuzzbee.retuning import Retuning

LONG_WAIT_S = 1.0


def serve(options: RunOptions, opening: OpeningSession | None) -> int:
    """Open everything, loop until the end, close everything, and report the result.

    Returns 1 if no vehicle was heard in the time given, else 0.

    Raises:
        InputError: a source, profile, file or address that cannot be used.
    """
    prepared = prepare(options)
    profile = prepared.profile
    requests = ParameterRequests()
    conflicts: list[InputError] = []
    recordings = Recordings()
    with ExitStack() as stack:
        # first, and once: what comes meanwhile is recorded
        source, recorder = open_recorded(prepared.endpoint, options, prepared.key, stack)
        session = None if opening is None else opened(opening, stack)
        retuning = _open_retuning(options, requests, stack)
        pipeline = _pipeline(profile, options, retuning)
        if options.truth or prepared.endpoint.kind == "sim":
            pipeline.scores = {}
        sinks = open_sinks(options, session, profile, requests, conflicts, pipeline.scores)
        if recorder is not None and retuning is not None:
            sinks.append(RecordingSink(recorder))
        outbox = stack.enter_context(Outbox(sinks))
        recordings.add([recorder, *sinks])
        # in a thread: the compiler's callbacks swallow what a signal raises in them
        aside(load_kernels, "kernels").result()
        runner = make_runner(
            source,
            pipeline,
            outbox,
            requests,
            options.rate_hz,
            recording=lambda: recordings.word,
            seconds=options.seconds,
        )
        end_s = None if isinstance(source, SimSource) else options.seconds
        seconds, failure = run_loop(runner, end_s, conflicts)
    name, recorded = prepared.profile_name, recordings.word
    result = summary(options, name, seconds, runner, pipeline, recorded)
    if isinstance(source, SimSource) and source.waited_s >= LONG_WAIT_S and not options.as_json:
        say(f"the vehicle waited {source.waited_s:.0f} s for this computer, which was too busy")
    if pipeline.scores is not None:
        result["truth"] = {name: score.result() for name, score in pipeline.scores.items()}
        for name, score in pipeline.scores.items():
            if score.verdict() and not options.as_json:
                say(f"vehicle {name} {score.verdict()}")
    problems = [failure, *conflicts]
    return conclude(options, result, outbox, problems, was_stopped=runner.was_stopped)


def _open_retuning(
    options: RunOptions, requests: ParameterRequests, stack: ExitStack
) -> "Retuning | None":
    """The process that retunes, if it is asked for."""
    if not options.retune:
        return None
    from fuzzbee.retuning import Retuning  # which loads what searches

    return stack.enter_context(Retuning(requests, options.gain))


def _pipeline(profile: Profile, options: RunOptions, retuning: "Retuning | None") -> ScoredPipeline:
    """The pipeline, whose estimators speak with the process that retunes."""
    pipeline = ScoredPipeline(
        profile,
        system_id=options.system_id,
        new_estimator=lambda chosen: (
            Estimator(chosen, options.gain) if retuning is None else retuning.estimator(chosen)
        ),
        fits_built_in=options.profile is None,
        rate_hz=options.rate_hz,
    )
    if retuning is not None:
        retuning.watch(pipeline)
    return pipeline
