"""One worker: the loop, decoder and estimators of its share of the vehicles, in a process.

It has no socket to the world: frames come from the service, what it makes goes back there. It ends
when the service closes the connection or dies, and with nothing else but SIGKILL.
"""

import os
import pickle
import signal
import socket
import time
from collections import Counter

from estimator.errors import InputError
from estimator.estimator import Estimator
from service.overload import Overload
from service.parameters import replace_or_refuse
from service.pipeline import Pipeline
from service.runner import Runner
from service.signals import ending_signals
from service.workers.connection import Connection, Kind, Message
from service.workers.handed_frames import HandedFrames
from service.workers.job import Job, ProfileAnswer, ProfileRequest, Tally
from service.workers.report import Report

FLUSH_S = 0.5  # for what is still to be handed back at the end
OK, FAILED = 0, 1


def ignore_signals() -> None:
    """Leave the end to the service: a terminal and a supervisor signal all of its processes."""
    for number in ending_signals():
        signal.signal(number, signal.SIG_IGN)


def work(end: socket.socket, number: int) -> int:
    """Work until the service ends; returns the exit status."""
    connection = Connection(end)
    try:
        job = _job(connection)
        if job is not None:
            _serve(connection, job, f"worker {number + 1}")
    except BaseException as error:  # noqa: BLE001 - told by the service, in a line
        text = f"{type(error).__name__}: {error}"
        connection.put(Kind.FAILURE, text.encode())
        connection.flush_all(FLUSH_S)
        return FAILED
    connection.flush_all(FLUSH_S)
    return OK


def _job(connection: Connection) -> Job | None:
    """The first message; None if the service ends before it."""
    while not connection.is_ended:
        connection.wait(1.0)
        message = connection.receive_one()
        if message is not None:
            assert message.kind is Kind.JOB
            job: Job = pickle.loads(message.body)  # noqa: S301 - of the service itself
            return job
    return None


def _serve(connection: Connection, job: Job, name: str) -> None:
    """The loop of a service, on handed frames."""
    pipeline = _pipeline(job)
    source = HandedFrames(
        connection, lambda message: _on_message(message, pipeline, connection), job
    )
    report = Report(connection, name, lambda: _tally(runner, pipeline), as_records=job.as_records)
    runner = Runner(
        source,
        pipeline,
        report,
        rate_hz=job.rate_hz,
        is_finished=source.is_finished,
        overload=Overload(),
    )
    _await_tick(job)
    runner.run()
    report.put_tally()


def _pipeline(job: Job) -> Pipeline:
    pipeline = Pipeline(
        job.profile,
        system_id=job.system_id,
        new_estimator=lambda profile: Estimator(profile, job.gain),
        fits_built_in=job.fits_built_in,
    )
    for vehicle, (profile, counts) in job.inherited.items():
        pipeline.inherit(vehicle, profile, counts)
    return pipeline


def _tally(runner: Runner, pipeline: Pipeline) -> Tally:
    counts = {vehicle.address: vehicle.counts for vehicle in pipeline.vehicles}
    departed = pipeline.departures.counts
    refused = Counter[str](pipeline.refused_frames)
    return Tally(runner.ticks, runner.overruns, runner.dropped, departed, counts, refused)


def _await_tick(job: Job) -> None:
    """Sleep until a tick of the common schedule."""
    period_s = 1.0 / job.rate_hz
    time.sleep((job.begin_s - time.monotonic()) % period_s)


def _on_message(message: Message, pipeline: Pipeline, connection: Connection) -> None:
    if message.kind is not Kind.PROFILE:
        return
    number, vehicle, partial = ProfileRequest(*pickle.loads(message.body))  # noqa: S301
    try:
        profile = replace_or_refuse(pipeline.replace_profile, vehicle, partial)
        answer = ProfileAnswer(number, profile)
    except InputError as error:
        answer = ProfileAnswer(number, None, str(error))
    connection.put(Kind.PROFILE, pickle.dumps(answer))


def exit_status(end: socket.socket, number: int) -> None:
    """Work in a forked process, which has nothing else to do, and end it."""
    status = FAILED
    try:
        status = work(end, number)
    finally:
        os._exit(status)
