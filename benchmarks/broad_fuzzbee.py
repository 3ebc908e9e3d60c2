"""Fuzzbee with its ``imu`` profile, as a batch and sample by sample."""

import numpy as np
from broad_data import Array, Trial
from broad_kernel import Parameters, Recording, run_conditioned
from broad_scores import multiply

import fuzzbee
from estimator.conditioning import apply_turn
from estimator.estimator import Estimator
from estimator.geometry.quaternion import conjugate as conjugate_one
from estimator.geometry.quaternion import multiply as multiply_one
from estimator.geometry.quaternion import normalize
from estimator.live.settings import settings_of
from estimator.profile import Profile, load_profile
from estimator.types import ImuSample

HALF_ROOT = np.sqrt(0.5)
# (x, y, z) up to (x, -y, -z) down: half a turn about x, the same both ways.
FRD_OF_SENSOR = np.array([1.0, -1.0, -1.0])
Q_FRD_SENSOR = np.array([0.0, 1.0, 0.0, 0.0])
# East, north, up from north, east, down: half a turn about (1, 1, 0).
Q_ENU_NED = np.array([0.0, HALF_ROOT, HALF_ROOT, 0.0])
# q -> Q_ENU_NED q Q_FRD_SENSOR is linear: the images of 1, i, j, k as rows.
ENU_SENSOR_OF_NED_FRD = multiply(Q_ENU_NED, multiply(np.eye(4), Q_FRD_SENSOR))
MICRO_TESLA_PER_GAUSS = 100.0


class FuzzbeeRun:
    """Fuzzbee on one trial; the first sample aligns it, as in the live estimator."""

    def __init__(self, trial: Trial, loaded: Profile, changes: dict[str, float | bool]) -> None:
        self._trial = trial
        settings = settings_of(loaded)
        conditioning = settings.conditioning._replace(averaged_samples=trial.averaged, **changes)
        self._params = Parameters(settings.filter, settings.reference, conditioning)
        first = Estimator(loaded)
        first.update(sample_of(trial, 0))
        core = first.snapshot.core
        self._state = core.filter
        self._memory = core.conditioning
        self._first = np.array([self._state.q_ned_frd])
        self._gyr = np.ascontiguousarray(trial.gyr_rad_s * FRD_OF_SENSOR)
        self._acc = np.ascontiguousarray(trial.acc_m_s2 * FRD_OF_SENSOR)
        self._mag = np.ascontiguousarray(trial.mag_ut * FRD_OF_SENSOR / MICRO_TESLA_PER_GAUSS)
        self._dt = np.full(len(self._mag), trial.dt_s)

    def advance(self, rows: slice) -> Array:
        """Take the rows, in order."""
        start, stop, _ = rows.indices(len(self._gyr))
        skip = 1 if start == 0 else 0
        rows = slice(start + skip, stop)
        q, self._state, self._memory = run_conditioned(
            self._params,
            self._state,
            self._memory,
            Recording(self._gyr[rows], self._acc[rows], self._mag[rows], self._dt[rows]),
        )
        if skip:
            q = np.concatenate([self._first, q])
        return q @ ENU_SENSOR_OF_NED_FRD

    def turn(self, turn_enu: Array) -> None:
        """Turn every attitude inside by one body rotation."""
        q = self._state.q_ned_frd
        to_ned = tuple(Q_ENU_NED)
        turn_ned = multiply_one(conjugate_one(to_ned), multiply_one(tuple(turn_enu), to_ned))
        body = multiply_one(conjugate_one(q), multiply_one(turn_ned, q))
        self._state = self._state._replace(q_ned_frd=normalize(multiply_one(q, body)))
        self._memory = apply_turn(self._memory, body)


class FuzzbeeFilter:
    """Fuzzbee with a profile; ``changes`` replace conditioning parameters, for ablations."""

    def __init__(
        self, name: str = "fuzzbee", profile: str | Profile = "imu", **changes: float | bool
    ) -> None:
        self.name = name
        self._profile = load_profile(profile) if isinstance(profile, str) else profile
        self._changes = changes

    def start(self, trial: Trial) -> FuzzbeeRun:
        """Begin on the trial."""
        return FuzzbeeRun(trial, self._profile, self._changes)

    def call_each(self, trial: Trial, rows: int) -> None:
        """One call a sample, as programs make it."""
        estimator = fuzzbee.Estimator(self._profile, trial.rate_hz)
        gyr, acc = trial.gyr_rad_s[:rows] * FRD_OF_SENSOR, trial.acc_m_s2[:rows] * FRD_OF_SENSOR
        mag = trial.mag_ut[:rows] * FRD_OF_SENSOR / MICRO_TESLA_PER_GAUSS
        for g, a, m in zip(gyr, acc, mag, strict=True):
            estimator.update(g, a, m)


def sample_of(trial: Trial, k: int) -> ImuSample:
    """Row k as the live estimator takes it."""
    gx, gy, gz = trial.gyr_rad_s[k].tolist()
    ax, ay, az = trial.acc_m_s2[k].tolist()
    mx, my, mz = (trial.mag_ut[k] / MICRO_TESLA_PER_GAUSS).tolist()
    return ImuSample(
        round(k * trial.dt_s * 1e6), (gx, -gy, -gz), (ax, -ay, -az), (mx, -my, -mz), True
    )
