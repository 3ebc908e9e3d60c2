"""A recorded flight as arrays: one vehicle's samples, its reference, where its clock broke."""

from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.events import ClockReset, Event, Imu, Position, ReferenceAttitude, TrackLost, VehicleId
from drivers.logs.missing_imu import advice
from drivers.logs.open import open_log
from drivers.logs.reference_track import ReferenceTrack
from drivers.samples.preference import imu_rank
from estimator.aiding.place import Whereabouts, update_whereabouts
from estimator.errors import InputError
from estimator.live.refusal import refusal
from estimator.mounting import Mounting
from estimator.types import ImuSample

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

REFERENCES = ("sim", "autopilot")
LEAST_RATE_HZ = 1.0
BETTER_LOG = "record a better log: fuzzbee run URL --request-rate 50 --record FILE"
LEAST_DURATION_S = 60.0
# A vehicle that never turns faster than this, for this long in all, does not show how a filter
# copes with motion. At rest, engines running, the rates of recorded vehicles stay below 0.02 rad/s.
MOTION_RAD_S = 0.05
LEAST_MOTION_S = 10.0
# A compass that speaks less often than this is as good as none.
LEAST_FIELD_RATE_HZ = 0.2
# A message that comes at least this share as often as the most frequent one may be used instead.
AS_OFTEN = 0.8


PLAIN = Mounting()


class LogData(NamedTuple):
    """N samples of one vehicle's IMU message.

    ``restart`` marks samples after which nothing from before holds (the first,
    a reboot, a jump of the clock). ``truth`` (N, 4) is the reference's
    ``q_ned_frd`` where ``known``; ``reference`` is "sim", "autopilot" or "none".
    """

    name: str
    sha256: str
    message: str
    rate_hz: float
    reference: str
    declination_rad: float
    time_s: Array
    restart: Bools
    gyr_rad_s: Array
    acc_m_s2: Array
    mag_gauss: Array
    has_mag: Bools
    truth: Array
    known: Bools

    @property
    def duration_s(self) -> float:
        """From the first sample to the last, without what reboots and jumps of the clock add."""
        return float(self.time_s[-1] - self.time_s[0])

    @property
    def has_field(self) -> bool:
        """Whether the log has a magnetic field often enough to be of use."""
        return bool(np.sum(self.has_mag) > LEAST_FIELD_RATE_HZ * self.duration_s)


class _Stream:
    """What one vehicle sent, sorted by message and source."""

    def __init__(self, mounting: Mounting) -> None:
        self._mounting = mounting
        self.samples: dict[str, list[ImuSample]] = {}
        self.restarts: dict[str, list[int]] = {}
        self.tracks = {name: ReferenceTrack() for name in REFERENCES}
        self._whereabouts = Whereabouts()
        self._restart_pending: set[str] = set()

    def take(self, event: Event) -> None:
        match event:
            case Imu(message=message, sample=sample):
                self._take_sample(message, self._mounting.to_body_axes(sample))
            case ReferenceAttitude(source=source):
                self.tracks[source].add(event)
            case Position():
                place = (event.latitude_deg, event.longitude_deg, event.altitude_m)
                self._whereabouts = update_whereabouts(self._whereabouts, *place, event.arrival_us)
            case ClockReset():
                self._restart_pending = set(self.samples)
            case TrackLost(message=message):
                self._restart_pending.add(message)

    def _take_sample(self, message: str, sample: ImuSample) -> None:
        kept = self.samples.setdefault(message, [])
        if refusal(sample) is not None or (kept and sample.time_us <= kept[-1].time_us):
            return
        if not kept or message in self._restart_pending:
            self.restarts.setdefault(message, []).append(len(kept))
            self._restart_pending.discard(message)
        kept.append(sample)

    @property
    def declination_rad(self) -> float:
        """Declination at the last known place; 0 without one."""
        here = self._whereabouts.here
        return 0.0 if here is None else here.field.declination_rad

    @property
    def message(self) -> str:
        """The IMU message to use: of those that came often, the one that the service would take."""
        most = max(len(samples) for samples in self.samples.values())
        often = [name for name, samples in self.samples.items() if len(samples) >= AS_OFTEN * most]
        return min(often, key=lambda name: (imu_rank(name), name))


def read_log(path: Path, mounting: Mounting = PLAIN) -> LogData:
    """The vehicle with most IMU samples, as they are mounted.

    Raises:
        InputError: the log cannot be read, or is too slow, too short or without motion.
    """
    streams: dict[VehicleId, _Stream] = {}
    with open_log(path) as log:
        sha256 = log.sha256()
        for event in log:
            address = getattr(event, "vehicle", None)
            if address is not None:
                streams.setdefault(address, _Stream(mounting)).take(event)
    counts = Counter(
        {address: len(s.samples[s.message]) for address, s in streams.items() if s.samples}
    )
    if not counts or max(counts.values()) < 2:
        raise InputError(f"{path}: {advice(log) or 'no usable IMU data in this log'}")
    address = min(counts, key=lambda a: (-counts[a], a))
    data = _arrays(path.name, sha256, streams[address])
    _require_substance(path, data)
    return data


def _arrays(name: str, sha256: str, stream: _Stream) -> LogData:
    message = stream.message
    samples = stream.samples[message]
    times_us = np.array([s.time_us for s in samples], dtype=np.int64)
    restart = np.zeros(len(samples), dtype=bool)
    restart[stream.restarts[message]] = True
    steps_s = 1e-6 * np.diff(times_us)[~restart[1:]]
    reference = next((r for r in REFERENCES if stream.tracks[r].message is not None), "none")
    truth, known = stream.tracks[reference if reference != "none" else "sim"].at(times_us)
    return LogData(
        name=name,
        sha256=sha256,
        message=message,
        rate_hz=float(1.0 / np.median(steps_s)) if len(steps_s) else 0.0,
        reference=reference,
        declination_rad=stream.declination_rad,
        time_s=1e-6 * (times_us - times_us[0]),
        restart=restart,
        gyr_rad_s=np.array([s.gyr_rad_s for s in samples]),
        acc_m_s2=np.array([s.acc_m_s2 for s in samples]),
        mag_gauss=np.array([s.mag_gauss for s in samples]),
        has_mag=np.array([s.has_mag for s in samples]),
        truth=truth,
        known=known,
    )


def _require_substance(path: Path, data: LogData) -> None:
    if data.rate_hz < LEAST_RATE_HZ:
        raise InputError(
            f"{path}: {data.message} at {data.rate_hz:.2f} Hz; nothing can be tuned below "
            f"{LEAST_RATE_HZ:g} Hz ({BETTER_LOG})"
        )
    if data.duration_s < LEAST_DURATION_S:
        raise InputError(
            f"{path}: {data.duration_s:.0f} s of IMU data; "
            f"at least {LEAST_DURATION_S:g} s are needed"
        )
    moving_s = motion_s(data)
    if moving_s < LEAST_MOTION_S:
        raise InputError(
            f"{path}: no motion: it turns faster than {MOTION_RAD_S:g} rad/s for {moving_s:.0f} s, "
            f"at least {LEAST_MOTION_S:g} s are needed"
        )


def motion_s(data: LogData) -> float:
    """For how long the vehicle turned. The median rate, and with it a bias, is taken off first."""
    rate = np.linalg.norm(data.gyr_rad_s - np.median(data.gyr_rad_s, axis=0), axis=1)
    return float(np.mean(rate > MOTION_RAD_S)) * data.duration_s
