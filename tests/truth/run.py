"""One motion with one fault, as MAVLink frames through decoder and pipeline, and the verdict.

Time is given, nothing waits. A tick comes with every IMU message, so that an attitude is published
for the time of each sample.
"""

from collections.abc import Iterator
from math import cos, radians
from typing import Any, NamedTuple

import numpy as np

from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.dialect import mavlink
from drivers.mavlink.framing import FrameReader
from drivers.simulation.rotations import CONJUGATE, Floats, exponential, multiply
from estimator.profile import load_profile
from estimator.types import STANDARD_GRAVITY_M_S2
from service.pipeline import Pipeline
from service.records import AttitudeRecord, Published, StatusRecord
from tests.truth.faults import Fault, Place, Readings, earth_field, impair, sense
from tests.truth.motions import FINE_HZ, MOTIONS, REST_S, Draw, Motion

START_UNIX_US = 1_760_000_000_000_000
UNDER_WAY_S = 0.002
METRES_A_DEGREE = 111_195.0
WRONG_DEG = 15.0
SURE_DEG = 5.0  # a sigma of at most this is sure of itself; the rival's always is
RIVAL_SIGMA_DEG = 5.0
ARDUPILOT, ACTIVE, ARMED, DISARMED = 3, 4, 0xD1, 0x51
FILTER_IS_WELL = 0x01 | 0x02 | 0x04 | 0x08 | 0x10 | 0x20
FIX_3D = 3
MG, MILLI = 1000.0 / STANDARD_GRAVITY_M_S2, 1000.0


class Case(NamedTuple):
    """All that one verdict depends on."""

    motion: str
    fault: Fault = Fault()
    has_velocity: bool = True
    rate_hz: float = 50.0
    seed: int = 0
    spread: float = 0.0  # of the motion's sizes
    beside: str = ""  # "attitude": healthy rates in ATTITUDE; "imu2": a healthy SCALED_IMU2
    place: Place = Place()

    def __str__(self) -> str:
        words = [
            f"{self.motion}, {self.fault}",
            "with velocity" if self.has_velocity else "no velocity",
        ]
        return ", ".join([*words, f"{self.rate_hz:g} Hz", *filter(None, [self.beside])])


class Angle(NamedTuple):
    """How one angle fares: degrees, and shares of its errors."""

    rms_deg: float
    worst_deg: float
    sigma_deg: float  # median
    under_sigma: float
    beyond_three: float
    rival_under: float
    rival_beyond: float


class Verdict(NamedTuple):
    """What became of a case."""

    wrong_and_sure_s: float  # the longest time
    since_s: float  # when that began
    after_fault_s: float  # the longest time behind the beginning of the fault
    rival_s: float  # the same with the rival's sigma
    inclination: Angle
    heading: Angle  # nan where the heading is not known to be one
    running: float  # share of the samples for which an attitude was published as running
    warnings: dict[str, float]  # word: when it came first, s
    rejected: dict[str, float]


class _Published(NamedTuple):
    """One published attitude."""

    row: int  # of the sample
    record: AttitudeRecord
    is_warned: bool


def judge(case: Case, profile: str = "imu") -> Verdict:
    """Fly a case and score it."""
    motion, readings = make(case)
    said = list[_Published]()
    warnings, rejected = dict[str, float](), dict[str, float]()
    service = Pipeline(load_profile(profile))
    decoder, reader = MavlinkDecoder(references=False), FrameReader()
    warned = False
    for k, frames in enumerate(_frames(case, motion, readings)):
        now_us = START_UNIX_US + round(1e6 * (readings.time_s[k] + UNDER_WAY_S))
        for frame in reader.feed(frames):
            for event in decoder.events(frame, now_us):
                service.handle(event)
        for output in service.tick(now_us):
            if not isinstance(output, Published):
                continue
            match output.record:
                case StatusRecord(warnings=words, rejected=reasons):
                    warned = bool(words)
                    for seen, now in ((warnings, words), (rejected, reasons)):
                        for word in now:
                            seen.setdefault(str(word), float(readings.time_s[k]))
                case AttitudeRecord() as record:
                    said.append(_Published(k, record, warned))
    return _verdict(case, motion, readings, said, warnings, rejected)


def make(case: Case) -> tuple[Motion, Readings]:
    """The truth and the readings of a case."""
    motion = MOTIONS[case.motion](Draw(case.seed, case.spread))
    healthy = sense(motion, case.rate_hz, earth_field(case.place), case.seed)
    return motion, impair(healthy, case.fault, case.seed)


def _frames(case: Case, motion: Motion, readings: Readings) -> Iterator[bytes]:
    """The bytes that come with each sample."""
    dialect = mavlink()
    link = dialect.MAVLink(None, srcSystem=1, srcComponent=1)

    def pack(name: str, *fields: Any) -> bytes:
        return bytes(getattr(dialect, f"MAVLink_{name}_message")(*fields).pack(link))

    healthy = readings
    if case.beside:
        healthy = sense(motion, case.rate_hz, earth_field(case.place), case.seed + 1)
    reports = _Reports(case, readings)
    next_beat_s, begin_s = 0.0, 0.0 if motion.velocity_m_s[0].any() else REST_S
    for k, time_s in enumerate(readings.time_s):
        out = bytearray()
        if time_s >= next_beat_s:
            next_beat_s = time_s + 1.0
            mode = ARMED if time_s >= begin_s else DISARMED
            out += pack("heartbeat", motion.vehicle_type, ARDUPILOT, mode, 0, ACTIVE, 3)
        for message in reports.at(k):
            out += pack(*message)
        out += pack("raw_imu", round(1e6 * readings.stamp_s[k]), *_whole(readings, k))
        boot_ms = round(1e3 * readings.boot_s[k])
        if case.beside == "imu2":
            out += pack("scaled_imu2", boot_ms, *_whole(healthy, k))
        if case.beside == "attitude":
            out += pack("attitude", boot_ms, 0.0, 0.0, 0.0, *healthy.gyr_rad_s[k])
        yield bytes(out)


def _whole(readings: Readings, k: int) -> list[int]:
    """A sample in whole mg, mrad/s and mGauss, cut towards zero as autopilots do."""
    values = (*readings.acc_m_s2[k] * MG, *readings.gyr_rad_s[k] * MILLI)
    field = readings.mag_gauss[k] * MILLI
    return [int(np.clip(value, -32768, 32767)) for value in (*values, *field)]


class _Reports:
    """Velocities of an autopilot's filter and of its receiver, which is late; none if unwanted."""

    def __init__(self, case: Case, readings: Readings) -> None:
        self._case, self._readings = case, readings
        self._rng = np.random.default_rng([case.seed, 3])
        steps = np.diff(readings.time_s, prepend=0.0)[:, None]
        self._way_m = np.cumsum(readings.velocity_m_s * steps, axis=0)
        self._next_s = {"filter": 0.0, "receiver": 0.0, "flags": 0.0}

    def at(self, k: int) -> Iterator[tuple[Any, ...]]:
        """Messages that are due at sample k: name and fields."""
        if not self._case.has_velocity:
            return
        r, time_s = self._readings, self._readings.time_s[k]
        boot_s, now = r.boot_s[k], r.velocity_m_s[k]
        if self._is_due("flags", time_s, 1.0):
            yield ("ekf_status_report", FILTER_IS_WELL, 0.05, 0.05, 0.05, 0.05, 0.0)
        if self._is_due("filter", time_s, 0.1):
            cm_s = (int(100.0 * v) for v in now)
            yield ("global_position_int", round(1e3 * boot_s), *self._place(k), 0, *cm_s, 0)
        if self._is_due("receiver", time_s, 0.2):
            late = max(0, k - round(0.12 * self._case.rate_hz))
            north, east = r.velocity_m_s[late, :2] + 0.05 * self._rng.standard_normal(2)
            speed = round(100.0 * float(np.hypot(north, east)))
            course = round(100.0 * float(np.degrees(np.arctan2(east, north)))) % 36000
            fields = (90, 90, speed, course, 12, 0, 500, 800, 300, 0)
            yield ("gps_raw_int", round(1e6 * boot_s), FIX_3D, *self._place(late), *fields)

    def _is_due(self, name: str, time_s: float, period_s: float) -> bool:
        if time_s < self._next_s[name] - 1e-9:
            return False
        self._next_s[name] = time_s + period_s
        return True

    def _place(self, k: int) -> tuple[int, int, int]:
        place, (north, east, down) = self._case.place, self._way_m[k]
        latitude_deg = place.latitude_deg + north / METRES_A_DEGREE
        east_deg = east / (METRES_A_DEGREE * cos(radians(place.latitude_deg)))
        degrees = latitude_deg, place.longitude_deg + east_deg
        altitude_m = place.altitude_m - down
        return round(1e7 * degrees[0]), round(1e7 * degrees[1]), round(1e3 * altitude_m)


def _verdict(
    case: Case,
    motion: Motion,
    readings: Readings,
    said: list[_Published],
    warnings: dict[str, float],
    rejected: dict[str, float],
) -> Verdict:
    said = [one for one in said if one.record.state == "running"]
    time_s = np.array([readings.time_s[one.row] for one in said])
    errors, sigmas, known = _errors_deg(case, motion, readings, said)
    silent = np.array([not one.is_warned for one in said], bool)
    wrong = (errors > WRONG_DEG) & known & silent[:, None]
    period_s = 1.0 / case.rate_hz
    is_sure_and_wrong = np.any(wrong & (sigmas <= SURE_DEG), axis=1)
    longest_s, since_s = _longest(time_s, is_sure_and_wrong, period_s)
    after_s, _ = _longest(time_s, is_sure_and_wrong & (time_s >= case.fault.begin_s), period_s)
    rival_s, _ = _longest(time_s, np.any(wrong, axis=1), period_s)
    inclination, heading = (_angle(errors[now, k], sigmas[now, k]) for k, now in enumerate(known.T))
    running = len(said) / len(readings.time_s)
    return Verdict(
        longest_s, since_s, after_s, rival_s, inclination, heading, running, warnings, rejected
    )


def _errors_deg(
    case: Case, motion: Motion, readings: Readings, said: list[_Published]
) -> tuple[Floats, Floats, np.ndarray[Any, np.dtype[np.bool_]]]:
    """Errors of inclination and heading, their sigmas, and whether they are said to be known.

    A heading against magnetic north is compared with that. Errors as in BROAD's evaluation.
    """
    grid = np.round(readings.time_s[[one.row for one in said]] * FINE_HZ).astype(int)
    truth = motion.q_ned_frd[grid]
    references = np.array([one.record.heading_reference for one in said])
    to_magnetic = np.zeros((len(said), 3))
    to_magnetic[references == "magnetic", 2] = -earth_field(case.place).declination_rad
    truth = multiply(exponential(to_magnetic), truth)
    estimate = np.array([one.record.q_ned_frd for one in said]).reshape(-1, 4)
    w, x, y, z = np.abs(multiply(estimate, truth * CONJUGATE)).T
    inclination = 2.0 * np.arctan2(np.hypot(x, y), np.hypot(w, z))
    heading = 2.0 * np.arctan2(z, w)
    sigmas = [(s.inclination, s.heading) for s in (one.record.sigma_deg for one in said)]
    known = np.stack([np.ones(len(said), bool), references != "none"], axis=1)
    return (
        np.degrees(np.stack([inclination, heading], axis=1)),
        np.array(sigmas).reshape(-1, 2),
        known,
    )


def _angle(errors: Floats, sigmas: Floats) -> Angle:
    if not len(errors):
        return Angle(*[float("nan")] * 7)
    return Angle(
        float(np.sqrt(np.mean(errors**2))),
        float(np.max(errors)),
        float(np.median(sigmas)),
        float(np.mean(errors <= sigmas)),
        float(np.mean(errors > 3.0 * sigmas)),
        float(np.mean(errors <= RIVAL_SIGMA_DEG)),
        float(np.mean(errors > 3.0 * RIVAL_SIGMA_DEG)),
    )


def _longest(
    time_s: Floats, flags: np.ndarray[Any, np.dtype[np.bool_]], period_s: float
) -> tuple[float, float]:
    """The longest unbroken time for which the flag stands, and when it began, s."""
    best, since_s, begin = 0.0, 0.0, None
    for k, flag in enumerate(flags):
        if not flag or (k and time_s[k] - time_s[k - 1] > 2.5 * period_s):
            begin = k if flag else None
            continue
        begin = k if begin is None else begin
        length = float(time_s[k] - time_s[begin]) + period_s
        if length > best:
            best, since_s = length, float(time_s[begin])
    return best, since_s
