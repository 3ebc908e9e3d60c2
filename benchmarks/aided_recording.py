"""What the aiding knew at each sample of a replay, beside the truth."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.events import Event
from estimator.aiding.phase import Phase
from estimator.estimator import Estimator
from estimator.profile import Profile, load_profile
from estimator.reasons import Reason
from estimator.types import ImuSample, Quaternion
from fuzzbee.replays.comparison import compare
from fuzzbee.replays.trace import Replay
from service.pipeline import Pipeline

Floats = NDArray[np.float64]

WIDTHS = {
    "dt_s": 1,
    "aided": 1,
    "acc": 3,  # specific force free of the bias that the aiding knows, FRD
    "velocity": 3,  # the aiding's, NED
    "rate": 3,  # free of bias, that the filter was turned with, FRD
    "bias": 3,  # of the gyroscope, FRD
    "lag": 1,  # of the IMU's samples
    "follower": 4,  # q_ned_frd of the filter
    "q_g_frd": 4,  # of the gyro-propagated frame
    "force_g": 3,  # specific force over the last second, in that frame
    "force_ned": 3,  # what reported velocity makes of it
    "force_share": 1,
    "field_g": 3,  # the field free of hard iron
    "field_ned": 3,  # the place's
    "field_share": 1,
    "certain": 2,  # sigmas of inclination and heading by the covariance alone
    "error": 1,  # e as it is published
}


class AidedRecording(NamedTuple):
    """Rows are samples; ``columns`` as in ``WIDTHS``, angles in rad."""

    time_s: Floats
    columns: dict[str, Floats]
    sigma: Floats  # (N, 2) as published: inclination, heading
    truth: Floats  # (N, 4)
    known: NDArray[np.bool_]
    errors: Floats  # (N, 3) as published: total, heading, inclination


class RecordingEstimator(Estimator):
    """Keeps a row a sample; turned once without telling the gyroscope, if asked for."""

    def __init__(self, profile: Profile, turn_at_s: float | None, turn: Quaternion | None) -> None:
        super().__init__(profile)
        self.rows: list[Floats] = []
        self._first_us: int | None = None
        self._turn_at_s, self._turn = turn_at_s, turn

    def update(self, sample: ImuSample) -> Reason | None:
        """As the estimator does."""
        reason = super().update(sample)
        if reason is None:
            self.rows.append(self._row())
            self._first_us = sample.time_us if self._first_us is None else self._first_us
            since_s = 1e-6 * (sample.time_us - self._first_us)
            if self._turn is not None and since_s >= (self._turn_at_s or 0.0):
                self.turn(self._turn)
                self._turn = None
        return reason

    def _row(self) -> Floats:
        snapshot = self.snapshot
        core, estimate = snapshot.core, snapshot.core.aided.estimate
        witness = core.witness
        acc = np.array(core.sample.acc_m_s2) - estimate.acc_bias_m_s2
        parts: list[Any] = [
            core.sample.dt_s,
            snapshot.context.phase is Phase.AIDED,
            acc,
            estimate.velocity_ned_m_s,
            core.filter.rate_rad_s,
            estimate.gyr_bias_rad_s,
            estimate.imu_lag_s,
            core.filter.q_ned_frd,
            witness.q_g_frd,
            witness.force.g,
            witness.force.ned,
            witness.force.share,
            witness.field.g,
            witness.field.ned,
            witness.field.share,
            core.aided.sigma,
            witness.error,
        ]
        return np.concatenate([np.atleast_1d(np.array(part, dtype=float)) for part in parts])


class RecordingReplay(Replay):
    """A replay whose estimators are kept."""

    def __init__(self, turn_at_s: float | None, turn: Quaternion | None) -> None:
        super().__init__(load_profile("imu"))
        self.made: list[RecordingEstimator] = []
        self._turn_at_s, self._turn = turn_at_s, turn
        self._pipeline = Pipeline(load_profile("imu"), new_estimator=self._make)

    def _make(self, profile: Profile) -> Estimator:
        self.made.append(RecordingEstimator(profile, self._turn_at_s, self._turn))
        return self.made[-1]


def record_aided(
    events: Iterable[Event], *, turn_at_s: float | None = None, turn: Quaternion | None = None
) -> AidedRecording:
    """Replay the events with profile ``imu``; the vehicle with most samples counts."""
    replay = RecordingReplay(turn_at_s, turn)
    replay.run(events)
    trace = max(replay.traces.values(), key=lambda each: len(each.attitudes))
    rows = np.array(max(replay.made, key=lambda each: len(each.rows)).rows)
    compared = compare(Path("events"), trace, None)
    ends = np.cumsum(list(WIDTHS.values()))[:-1]
    parts = np.split(rows, ends, axis=1)
    columns = {
        name: part[:, 0] if WIDTHS[name] == 1 else part
        for name, part in zip(WIDTHS, parts, strict=True)
    }
    sigma = [
        trace.column(lambda a: a.sigma_inclination_rad),
        trace.column(lambda a: a.sigma_heading_rad),
    ]
    time_s = 1e-6 * (trace.times_us - trace.times_us[0])
    return AidedRecording(
        time_s, columns, np.stack(sigma, 1), compared.truth, compared.known, compared.errors_rad
    )
