"""Fuzzbee, its variants and other filters behind one face: rows in, attitudes out."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from common.recordings import Array, Trial
from common.report import names

from estimator.geometry.rotations import conjugate, from_matrices, multiply
from estimator.profile import Profile, merge_profile
from estimator.types import STANDARD_GRAVITY_M_S2
from fuzzbee import Estimator, load_profile

# Body axes are forward, right, down; the recordings' forward, left, up.
FRD_OF_SENSOR = np.array([1.0, -1.0, -1.0])
GAUSS_PER_MICRO_TESLA = 0.01
# Of the other filters: the best common settings over the trials this was developed on.
IMUFUSION = {
    "gain": 0.2,
    "gyroscope_range": 0.0,
    "acceleration_rejection": 10.0,
    "magnetic_rejection": 10.0,
    "rejection_timeout": 10.0,
}
MAHONY = {"k_P": 0.3, "k_I": 1e-6}  # ahrs refuses zero
MADGWICK = {"gain": 0.1}
# Madgwick's earth frame in ahrs is north-west-up: ENU turned by 90 deg. Mahony's is ENU.
Q_ENU_EARTH = {
    "Mahony": np.array([1.0, 0.0, 0.0, 0.0]),
    "Madgwick": np.sqrt([0.5, 0.0, 0.0, 0.5]),
}


class Output(NamedTuple):
    """N attitudes, sensor to ENU, w first; sigmas (N, 2) of inclination and heading, degrees."""

    q_enu_sensor: Array
    sigma_deg: Array | None = None


class Run:
    """A filter at work on one trial."""

    def __init__(self, trial: Trial) -> None:
        self._trial = trial

    def advance(self, rows: slice) -> Output:
        """Take the rows, in order."""
        raise NotImplementedError

    def turn(self, turn_enu: Array) -> None:
        """Turn every attitude of the filter by a rotation in ENU that no sensor has felt."""


Filter = Callable[[Trial], Run]


class FuzzbeeRun(Run):
    """The estimator as programs have it; ``smooth`` with what came later, all rows at once."""

    def __init__(self, trial: Trial, profile: Profile, *, smooth: bool = False) -> None:
        averaged = {"conditioning": {"averaged_samples": trial.averaged}}
        self._estimator = Estimator(
            merge_profile(profile, averaged), trial.rate_hz, compass_calibrated=True
        )
        self._readings = body_readings(trial)
        estimator = self._estimator
        self._estimate = estimator.smooth if smooth else estimator.update_batch

    def advance(self, rows: slice) -> Output:
        found = self._estimate(*(column[rows] for column in self._readings))
        sigma = np.stack([found.sigma_inclination_rad, found.sigma_heading_rad], axis=1)
        return Output(found.q_enu_flu, np.degrees(sigma))

    def turn(self, turn_enu: Array) -> None:
        # only tests do this, so the public class has no name for it
        w, east, north, up = turn_enu.tolist()
        self._estimator._inner.turn((w, north, east, -up))  # noqa: SLF001


def body_readings(trial: Trial) -> tuple[Array, Array, Array]:
    """Rad/s, m/s^2 and gauss, forward, right, down."""
    mag = trial.mag_ut * GAUSS_PER_MICRO_TESLA
    gyr, acc, mag = (column * FRD_OF_SENSOR for column in (trial.gyr_rad_s, trial.acc_m_s2, mag))
    return gyr, acc, mag


class OfflineVqfRun(Run):
    """VQF's own acausal version, with its defaults; nothing turns what knows what comes later."""

    def advance(self, rows: slice) -> Output:
        from vqf import offlineVQF

        t = self._trial
        mag = t.mag_ut[rows] if t.has_mag else None
        result = offlineVQF(t.gyr_rad_s[rows], t.acc_m_s2[rows], mag, t.dt_s)
        return Output(np.asarray(result["quat9D" if t.has_mag else "quat6D"]))


class VqfRun(Run):
    """VQF (Laidig and Seel 2023), its own package, with its defaults but tauMag."""

    def __init__(self, trial: Trial, tau_mag_s: float) -> None:
        from vqf import VQF

        super().__init__(trial)
        self._vqf = VQF(trial.dt_s, tauMag=tau_mag_s)
        self._attitude = self._vqf.getQuat9D if trial.has_mag else self._vqf.getQuat6D

    def advance(self, rows: slice) -> Output:
        t = self._trial
        mag = t.mag_ut[rows] if t.has_mag else None
        result = self._vqf.updateBatch(t.gyr_rad_s[rows], t.acc_m_s2[rows], mag)
        return Output(np.asarray(result["quat9D" if t.has_mag else "quat6D"]))

    def turn(self, turn_enu: Array) -> None:
        state = self._vqf.state
        body = body_turn(self._attitude(), turn_enu)
        state["gyrQuat"] = list(multiply(np.array(state["gyrQuat"]), body))
        self._vqf.state = state


def body_turn(q: Array, turn_enu: Array) -> Array:
    """The turn as the body at ``q`` makes it."""
    return multiply(conjugate(q), multiply(turn_enu, q))


class ImufusionRun(Run):
    """imufusion (x-io), with its own gyroscope bias filter."""

    def __init__(self, trial: Trial) -> None:
        import imufusion

        settings, bias = imufusion.AhrsSettings(), imufusion.BiasSettings()
        settings.sample_rate = bias.sample_rate = trial.rate_hz
        settings.convention = imufusion.CONVENTION_ENU
        for name, value in IMUFUSION.items():  # the constructor ignores its arguments
            setattr(settings, name, value)
        super().__init__(trial)
        self._ahrs, self._bias = imufusion.Ahrs(), imufusion.Bias()
        self._ahrs.set_settings(settings)
        self._bias.set_settings(bias)

    def advance(self, rows: slice) -> Output:
        t, ahrs = self._trial, self._ahrs
        gyr, acc = np.degrees(t.gyr_rad_s[rows]), t.acc_m_s2[rows] / STANDARD_GRAVITY_M_S2
        mag = np.nan_to_num(t.mag_ut[rows])
        out = np.empty((len(gyr), 4))
        for k in range(len(gyr)):
            ahrs.update(self._bias.update(gyr[k]), acc[k], mag[k])
            out[k] = ahrs.get_quaternion()
        return Output(out)

    def turn(self, turn_enu: Array) -> None:
        q = np.array(self._ahrs.get_quaternion(), dtype=float)
        self._ahrs.set_quaternion(multiply(q, body_turn(q, turn_enu)))


class AhrsRun(Run):
    """Mahony's or Madgwick's filter of the ahrs package; its attitude is kept here."""

    def __init__(self, trial: Trial, name: str, settings: dict[str, float]) -> None:
        import ahrs.filters

        super().__init__(trial)
        self._q_enu_earth = Q_ENU_EARTH[name]
        self._filter: Any = getattr(ahrs.filters, name)(frequency=trial.rate_hz, **settings)
        self._q = multiply(conjugate(self._q_enu_earth), first_attitude(trial))

    def advance(self, rows: slice) -> Output:
        t, f = self._trial, self._filter
        columns = [t.gyr_rad_s[rows], t.acc_m_s2[rows], *([t.mag_ut[rows]] if t.has_mag else [])]
        update, out = f.updateMARG if t.has_mag else f.updateIMU, np.empty((len(columns[0]), 4))
        for k, row in enumerate(zip(*columns, strict=True)):
            out[k] = self._q = update(self._q, *row, t.dt_s)
        return Output(multiply(self._q_enu_earth, out))

    def turn(self, turn_enu: Array) -> None:
        q = multiply(self._q_enu_earth, self._q)
        self._q = multiply(self._q, body_turn(q, turn_enu))


def first_attitude(trial: Trial) -> Array:
    """The attitude, sensor to ENU, that gravity and the field of the first sample show."""
    up = trial.acc_m_s2[0] / np.linalg.norm(trial.acc_m_s2[0])
    east = np.cross(trial.mag_ut[0] if trial.has_mag else np.array([1.0, 0.0, 0.0]), up)
    east /= np.linalg.norm(east)
    rows = np.array([east, np.cross(up, east), up])
    return from_matrices(rows[None])[0]


PEERS: dict[str, Filter] = {
    "vqf": partial(VqfRun, tau_mag_s=9.0),
    "vqf tauMag 20": partial(VqfRun, tau_mag_s=20.0),
    "imufusion": ImufusionRun,
    "mahony": partial(AhrsRun, name="Mahony", settings=MAHONY),
    "madgwick": partial(AhrsRun, name="Madgwick", settings=MADGWICK),
}
ACAUSAL: dict[str, Filter] = {
    "smooth": partial(FuzzbeeRun, profile=load_profile("imu"), smooth=True),
    "vqf offline": OfflineVqfRun,
}


def fuzzbee(changes: dict[str, Any]) -> Filter:
    """With a profile that differs from the shipped one."""
    return partial(FuzzbeeRun, profile=merge_profile(load_profile("imu"), changes))


FIXED = {f"K = {K:g}": {"gain": "fixed", "fixed_gain": K} for K in (1.0, 5.0, 20.0, 50.0, 200.0)}
GAINS: dict[str, Filter] = {
    name: fuzzbee({"filter": change})
    for name, change in {
        "fuzzy gain": {"gain": "fuzzy"},
        **FIXED,
        "knows the noise": {"gain": "noise"},
    }.items()
}
SETS = {"peers": PEERS, "acausal": ACAUSAL, "gains": GAINS}  # each beside fuzzbee
KNOWN: dict[str, Filter] = {"fuzzbee": fuzzbee({}), **PEERS, **ACAUSAL, **GAINS}


def run_whole(filter_: Filter, trial: Trial) -> Output:
    """All attitudes of a recording."""
    return filter_(trial).advance(slice(0, None))


def chosen_filters(text: str) -> Iterator[tuple[str, Filter | None]]:
    """The filters of names, or of a set's name, with commas; None for one that is not installed."""
    for name in names([*KNOWN, *SETS], text):
        for each in ("fuzzbee", *SETS[name]) if name in SETS else (name,):
            yield each, KNOWN[each] if is_installed(each) else None


def is_installed(name: str) -> bool:
    """Whether a filter's package is there."""
    from importlib.util import find_spec

    package = "ahrs" if name in ("mahony", "madgwick") else name.split(maxsplit=1)[0]
    return name not in {*PEERS, *ACAUSAL} - {"smooth"} or find_spec(package) is not None
