"""A log as a flight to tune on: what the service tells its estimator is written down."""

from pathlib import Path

import numpy as np

from drivers.logs.missing_imu import advice
from drivers.logs.open import open_log
from drivers.logs.time_window import WHOLE_LOG, TimeWindow
from estimator.errors import InputError
from estimator.live.rows import Rows
from estimator.profile import Profile
from estimator.types import ImuSample
from fuzzbee.replays.comparison import compare
from fuzzbee.replays.trace import Replay
from tuning.flight import Flight
from tuning.logged_calls import Call, LoggedEstimator
from tuning.smoothed import sure_flight


class RecordingEstimator(LoggedEstimator):
    """An estimator that remembers what it is told between the samples that it takes."""

    def __init__(self, profile: Profile) -> None:
        super().__init__(profile)
        self.samples = 0
        self.calls: dict[int, tuple[Call, ...]] = {}
        self.restarts: list[int] = [0]

    def note_sample(self, _sample: ImuSample, calls: tuple[Call, ...]) -> None:
        """See :class:`LoggedEstimator`."""
        if calls:
            self.calls[self.samples] = calls
        self.samples += 1

    def note_restart(self) -> None:
        """See :class:`LoggedEstimator`."""
        self.restarts.append(self.samples)


# What a flight may be measured against; the first that there is, if none is wanted.
REFERENCES = ("sim", "smooth", "autopilot")


def read_flight(
    path: Path,
    profile: Profile,
    reference: str | None = None,
    window: TimeWindow = WHOLE_LOG,
) -> Flight:
    """The vehicle with most IMU samples in ``window``, with all that its estimator was told.

    Raises:
        InputError: the log cannot be read, has no IMU data, or the profile's estimate is no number;
            the wanted reference is not there, or not sure of itself.
    """
    replay = Replay(profile, new_estimator=RecordingEstimator, window=window)
    with open_log(path) as log:
        sha256 = log.sha256()
        replay.run(log)
    trace = replay.longest(2)
    if trace is None:
        why = replay.why_empty or advice(log) or "no usable IMU data in this log"
        raise InputError(f"{path}: {why}")
    recorder = replay.estimator(trace.address)
    assert isinstance(recorder, RecordingEstimator)
    if recorder.samples != len(trace.attitudes):
        raise InputError(f"{path}: with the base profile the estimate is not finite")
    compared = compare(path, trace, None if reference == "smooth" else reference)
    restart = np.zeros(recorder.samples, dtype=bool)
    restart[[k for k in recorder.restarts if k < len(restart)]] = True
    samples = trace.samples
    gyr, acc, mag = map(samples.column, ("gyr_rad_s", "acc_m_s2", "mag_gauss"))
    found = Flight(
        name=path.name,
        sha256=sha256,
        message=max(trace.imu_messages, key=lambda name: trace.imu_messages[name]),
        reference=compared.source or "none",
        rows=Rows(samples.times_us, gyr, acc, mag, samples.column("has_mag") > 0.0),
        calls=recorder.calls,
        restart=restart,
        truth=compared.truth,
        known=compared.known,
        headed=trace.attitudes.norths() != "none",
    )
    if reference != "smooth" and (reference or found.reference == "sim"):
        return found
    return sure_flight(found, profile, is_wanted=reference == "smooth")
