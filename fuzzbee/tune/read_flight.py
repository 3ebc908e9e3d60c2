"""A log as a flight to tune on: what the service tells its estimator is written down."""

from operator import methodcaller
from pathlib import Path

import numpy as np

from drivers.logs.missing_imu import advice
from drivers.logs.open import open_log
from estimator.errors import InputError
from estimator.estimator import Estimator
from estimator.profile import Profile
from estimator.reasons import Reason
from estimator.types import ImuSample, RateSample, VelocitySample
from fuzzbee.replays.comparison import compare
from fuzzbee.replays.trace import Replay, VehicleTrace
from tuning.flight import Call, Flight


class RecordingEstimator(Estimator):
    """An estimator that remembers what it is told, and the samples that it took."""

    def __init__(self, profile: Profile) -> None:
        super().__init__(profile)
        self.samples: list[ImuSample] = []
        self.calls: list[tuple[Call, ...]] = []
        self.restarts: list[int] = [0]
        self._calls: list[Call] = []

    def update(self, sample: ImuSample) -> Reason | None:
        """See :class:`Estimator`."""
        reason = super().update(sample)
        if reason is None:
            self.calls.append((*self._calls, methodcaller("update", sample)))
            self.samples.append(sample)
            self._calls.clear()
        return reason

    def update_velocity(self, report: VelocitySample) -> Reason | None:
        """See :class:`Estimator`."""
        self._calls.append(methodcaller("update_velocity", report))
        return super().update_velocity(report)

    def update_rate(self, rate: RateSample) -> Reason | None:
        """See :class:`Estimator`."""
        self._calls.append(methodcaller("update_rate", rate))
        return super().update_rate(rate)

    def restart(self) -> None:
        """See :class:`Estimator`."""
        self._calls.append(methodcaller("restart"))
        self.restarts.append(len(self.samples))
        super().restart()

    def set_position(
        self, latitude_deg: float, longitude_deg: float, altitude_m: float, unix_us: int
    ) -> None:
        """See :class:`Estimator`."""
        place = (latitude_deg, longitude_deg, altitude_m, unix_us)
        self._calls.append(methodcaller("set_position", *place))
        super().set_position(*place)

    def set_field_calibrated(self, calibrated: bool) -> None:
        """See :class:`Estimator`."""
        self._calls.append(methodcaller("set_field_calibrated", calibrated))
        super().set_field_calibrated(calibrated)

    def change_imu(self) -> None:
        """See :class:`Estimator`."""
        self._calls.append(methodcaller("change_imu"))
        super().change_imu()


def read_flight(path: Path, profile: Profile) -> Flight:
    """The vehicle with most IMU samples, as the estimator of ``profile`` was told of it.

    Raises:
        InputError: the log cannot be read, has no IMU data, or the profile's estimate is no number.
    """
    replay = Replay(profile, new_estimator=RecordingEstimator)
    with open_log(path) as log:
        sha256 = log.sha256()
        replay.run(log)
    sending = [trace for trace in replay.traces.values() if len(trace.attitudes) > 1]
    if not sending:
        raise InputError(f"{path}: {advice(log) or 'no usable IMU data in this log'}")
    trace = max(sending, key=lambda trace: (len(trace.attitudes), -trace.address.system_id))
    recorder = replay.estimator(trace.address)
    assert isinstance(recorder, RecordingEstimator)
    if len(recorder.samples) != len(trace.attitudes):
        raise InputError(f"{path}: with the base profile the estimate is not finite")
    return _flight(path, sha256, trace, recorder)


def _flight(path: Path, sha256: str, trace: VehicleTrace, recorder: RecordingEstimator) -> Flight:
    compared = compare(path, trace, None)
    restart = np.zeros(len(recorder.samples), dtype=bool)
    restart[[k for k in recorder.restarts if k < len(restart)]] = True
    return Flight(
        name=path.name,
        sha256=sha256,
        message=max(trace.imu_messages, key=lambda name: trace.imu_messages[name]),
        reference=compared.source or "none",
        samples=tuple(recorder.samples),
        calls=tuple(recorder.calls),
        restart=restart,
        truth=compared.truth,
        known=compared.known,
        headed=np.array([a.heading_reference != "none" for a in trace.attitudes]),
    )
