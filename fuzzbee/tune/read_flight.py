"""A log as a flight to tune on: what the service gives its estimator is written down."""

from pathlib import Path

import numpy as np

from drivers.logs.time_window import WHOLE_LOG, TimeWindow
from estimator.errors import InputError
from estimator.live.rows import Rows
from estimator.profile import Profile
from estimator.types import IDENTITY
from fuzzbee.attitudes import PLACE
from fuzzbee.replays.score import compare
from fuzzbee.replays.trace import How, replay_log
from tuning.calls import LoggedEstimator, split_calls
from tuning.flight import Flight, sure_flight

ROWS = ("time_us", "gyr_rad_s", "acc_m_s2", "mag_gauss", "has_mag")  # as columns of a trace
# What a flight may be measured against; the first that there is, if none is wanted.
REFERENCES = {
    "sim": "simulator's truth",
    "smooth": "attitude smoothed over the whole log",
    "autopilot": "autopilot's attitude",
}


def read_flight(
    path: Path,
    profile: Profile,
    reference: str | None = None,
    window: TimeWindow = WHOLE_LOG,
    *,
    may_smooth: bool = True,
) -> Flight:
    """The vehicle with most IMU samples in ``window``, with all that its estimator was given."""
    trace = replay_log(path, profile, How(window=window, new_estimator=LoggedEstimator))
    if len(trace) < 2:
        raise InputError(f"{path}: a single sample of an IMU")
    recorder = trace.vehicle.estimator
    assert isinstance(recorder, LoggedEstimator)
    if recorder.taken != len(trace):
        raise InputError(f"{path}: with the base profile the estimate is not finite")
    compare(trace, None if reference == "smooth" else reference)
    truth = np.array(trace["reference_q_ned_frd"])
    known = np.isfinite(truth[:, 0])
    reports, calls = split_calls(recorder.calls)
    found = Flight(
        path=path,
        sha256=trace.log.sha256(),
        message=trace.message,
        reference=trace.reference or "none",
        rows=Rows(*(np.array(trace[name]) for name in ROWS)),
        calls=calls,
        truth=np.where(known[:, None], truth, IDENTITY),
        known=known,
        headed=trace["heading_reference"] > PLACE["none"],
        reports=reports,
        calibration=profile.calibration,
        begin_s=1e-6 * float(trace["time_us"][0] - trace.zero_us),
        refused=trace.refused or None,
    )
    is_wanted = reference == "smooth"
    if may_smooth and (is_wanted or not (reference or found.reference == "sim")):
        found = sure_flight(found, profile, is_wanted=is_wanted)
    return found


def reference_text(flight: Flight) -> str:
    """What the cost of a log is measured against."""
    if flight.reference == "none":
        return "prediction of its own vectors, without a reference"
    name = REFERENCES[flight.reference]
    return name if flight.has_field else f"{name}, inclination only"
