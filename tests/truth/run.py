"""One motion with one fault, as MAVLink frames through decoder and pipeline, and the verdict."""

from collections.abc import Iterator
from math import cos, radians
from typing import Any, NamedTuple

import numpy as np

from drivers.mavlink.constants import mavlink
from drivers.mavlink.decoder import MavlinkDecoder
from estimator.geometry.metrics import batch_angle_errors
from estimator.geometry.rotations import exp, multiply
from estimator.profile import load_profile
from estimator.types import STANDARD_GRAVITY_M_S2, Floats
from service.pipeline import Pipeline
from service.records import AttitudeRecord, Published, StatusRecord
from tests.service.flight_rig import Wire
from tests.truth.faults import HEALTHY, Fault, Flags, Place, Readings, earth_field, impair, sense
from tests.truth.motions import FINE_HZ, MOTIONS, REST_S, Draw, Motion

START_UNIX_US = 1_760_000_000_000_000
UNDER_WAY_S = 0.002
METRES_A_DEGREE = 111_195.0
WRONG_DEG = 15.0
SURE_DEG = 5.0  # a sigma of at most this is sure; a flat sigma is always this
ARDUPILOT, ACTIVE, ARMED, DISARMED, FIX_3D = 3, 4, 0xD1, 0x51, 3
FILTER_IS_WELL = 0x01 | 0x02 | 0x04 | 0x08 | 0x10 | 0x20
MG, MILLI = 1000.0 / STANDARD_GRAVITY_M_S2, 1000.0


class Case(NamedTuple):
    """All that a verdict depends on. ``spread`` scatters the motion's sizes.

    ``beside`` names what else the stream has: "attitude" is ATTITUDE with rates of a healthy
    gyroscope, "imu2" a healthy IMU in SCALED_IMU2, "offsets" what calibrating the compass found.
    """

    motion: str
    fault: Fault = HEALTHY
    has_velocity: bool = True
    rate_hz: float = 50.0
    beside: str = ""
    seed: int = 0
    spread: float = 0.0
    place: Place = Place()

    def __str__(self) -> str:
        velocity = "with velocity" if self.has_velocity else "no velocity"
        words = (self.motion, str(self.fault), velocity, f"{self.rate_hz:g} Hz", self.beside)
        return ", ".join(filter(None, words))


class Angle(NamedTuple):
    """How one angle fares: degrees, and shares of the errors; nan if it is never known."""

    rms_deg: float
    sigma_deg: float  # median
    under_sigma: float
    beyond_three: float


class Verdict(NamedTuple):
    """What became of a case."""

    wrong_and_sure_s: float  # the longest time, from the beginning of the fault on
    since_s: float  # when that began
    flat_s: float  # the same with a flat sigma
    inclination: Angle
    heading: Angle
    running: float  # share of the samples for which an attitude was published as running
    warnings: dict[str, float]  # what the status warned of, and when first, s
    rejected: dict[str, float]  # likewise for what it counts as refused


# A published attitude, the row of its sample, and whether the last status warned.
Printed = list[tuple[AttitudeRecord, int, bool]]


def judge(case: Case, profile: str = "imu") -> Verdict:
    """Fly a case and score it."""
    motion, readings = make(case)
    printed: Printed = []
    warnings: dict[str, float] = {}
    rejected: dict[str, float] = {}
    service, wire = Pipeline(load_profile(profile)), Wire(MavlinkDecoder(references=False))
    is_warned = False
    for row, frames in enumerate(_frames(case, motion, readings)):
        time_s = float(readings.time_s[row])
        now_us = START_UNIX_US + round(1e6 * (time_s + UNDER_WAY_S))
        for event in wire.events(frames, now_us):
            service.handle(event)
        for output in service.tick(now_us):
            match output:
                case Published(record=StatusRecord() as status):
                    is_warned = bool(status.warnings)
                    for seen, now in ((warnings, status.warnings), (rejected, status.rejected)):
                        for word in now:
                            seen.setdefault(str(word), time_s)
                case Published(record=AttitudeRecord() as record) if record.state == "running":
                    printed.append((record, row, is_warned))
    running = len(printed) / len(readings.time_s)
    return Verdict(*_score(case, motion, readings, printed), running, warnings, rejected)


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

    other = sense(motion, case.rate_hz, earth_field(case.place), case.seed + 1)
    counts, other_counts = _whole(readings), _whole(other)
    reports = _Reports(case, readings)
    axes = enumerate("XYZ" if case.beside == "offsets" else "")
    offsets = ((f"COMPASS_OFS_{axis}".encode(), 12.0, 9, 3, k) for k, axis in axes)
    first = b"".join(pack("param_value", *offset) for offset in offsets)
    next_beat_s, begin_s = 0.0, 0.0 if motion.velocity_m_s[0].any() else REST_S
    for row, time_s in enumerate(readings.time_s):
        out, first = first, b""
        if time_s >= next_beat_s:
            next_beat_s = time_s + 1.0
            mode = ARMED if time_s >= begin_s else DISARMED
            out += pack("heartbeat", motion.vehicle_type, ARDUPILOT, mode, 0, ACTIVE, 3)
        out += b"".join(pack(*message) for message in reports.at(row))
        out += pack("raw_imu", round(1e6 * readings.stamp_s[row]), *counts[row])
        boot_ms = round(1e3 * readings.boot_s[row])
        if case.beside == "imu2":
            out += pack("scaled_imu2", boot_ms, *other_counts[row])
        if case.beside == "attitude":
            out += pack("attitude", boot_ms, 0.0, 0.0, 0.0, *other.gyr_rad_s[row])
        yield out


def _whole(readings: Readings) -> list[list[int]]:
    """The samples in whole mg, mrad/s and mGauss, cut towards zero as autopilots do."""
    sensors = (readings.acc_m_s2 * MG, readings.gyr_rad_s * MILLI, readings.mag_gauss * MILLI)
    whole = np.trunc(np.clip(np.hstack(sensors), -32768, 32767)).astype(int)
    return list(whole.tolist())


class _Reports:
    """Velocities of an autopilot's filter and of its receiver, which is late; none if unwanted."""

    def __init__(self, case: Case, readings: Readings) -> None:
        self._case, self._readings = case, readings
        self._rng = np.random.default_rng([case.seed, 3])
        steps = np.diff(readings.time_s, prepend=0.0)[:, None]
        self._way_m = np.cumsum(readings.velocity_m_s * steps, axis=0)
        self._next_s = {"filter": 0.0, "receiver": 0.0, "flags": 0.0}

    def at(self, row: int) -> Iterator[tuple[Any, ...]]:
        """Messages that are due at a sample: name and fields."""
        if not self._case.has_velocity:
            return
        r, time_s = self._readings, self._readings.time_s[row]
        if self._is_due("flags", time_s, 1.0):
            yield ("ekf_status_report", FILTER_IS_WELL, 0.05, 0.05, 0.05, 0.05, 0.0)
        if self._is_due("filter", time_s, 0.1):
            cm_s = (int(100.0 * v) for v in r.velocity_m_s[row])
            boot_ms = round(1e3 * r.boot_s[row])
            yield ("global_position_int", boot_ms, *self._place(row), 0, *cm_s, 0)
        if self._is_due("receiver", time_s, 0.2):
            late = max(0, row - round(0.12 * self._case.rate_hz))
            north, east = r.velocity_m_s[late, :2] + 0.05 * self._rng.standard_normal(2)
            speed = round(100.0 * float(np.hypot(north, east)))
            course = round(100.0 * float(np.degrees(np.arctan2(east, north)))) % 36000
            rest = (90, 90, speed, course, 12, 0, 500, 800, 300, 0)
            yield ("gps_raw_int", round(1e6 * r.boot_s[row]), FIX_3D, *self._place(late), *rest)

    def _is_due(self, name: str, time_s: float, period_s: float) -> bool:
        if time_s < self._next_s[name] - 1e-9:
            return False
        self._next_s[name] = time_s + period_s
        return True

    def _place(self, row: int) -> tuple[int, int, int]:
        start, (north, east, down) = self._case.place, self._way_m[row]
        latitude_deg = start.latitude_deg + north / METRES_A_DEGREE
        shrinking = cos(radians(start.latitude_deg))
        longitude_deg = start.longitude_deg + east / (METRES_A_DEGREE * shrinking)
        altitude_mm = 1e3 * (start.altitude_m - down)
        return round(1e7 * latitude_deg), round(1e7 * longitude_deg), round(altitude_mm)


def _score(
    case: Case, motion: Motion, readings: Readings, printed: Printed
) -> tuple[float, float, float, Angle, Angle]:
    """The verdict's figures about errors and sigmas."""
    time_s = readings.time_s[[row for _, row, _ in printed]]
    errors = _errors_deg(case, motion, time_s, [record for record, *_ in printed])
    by_record = (record.sigma_deg for record, *_ in printed)
    sigmas = np.array([(s.inclination, s.heading) for s in by_record]).reshape(-1, 2)
    is_warned = np.array([warned for *_, warned in printed], bool)
    is_silent = ~is_warned & (time_s >= case.fault.begin_s)
    wrong = (errors > WRONG_DEG) & is_silent[:, None]
    period_s = 1.0 / case.rate_hz
    longest_s, since_s = _longest(time_s, np.any(wrong & (sigmas <= SURE_DEG), axis=1), period_s)
    flat_s, _ = _longest(time_s, np.any(wrong, axis=1), period_s)
    inclination, heading = (_angle(errors[:, k], sigmas[:, k]) for k in range(2))
    return longest_s, since_s, flat_s, inclination, heading


def _errors_deg(
    case: Case, motion: Motion, time_s: Floats, records: list[AttitudeRecord]
) -> Floats:
    """Errors of inclination and heading (N, 2).

    A heading against magnetic north is compared with that; the error of one against nothing is nan.
    """
    truth = motion.q_ned_frd[np.round(time_s * FINE_HZ).astype(int)]
    references = np.array([record.heading_reference for record in records])
    to_magnetic = np.zeros((len(records), 3))
    to_magnetic[references == "magnetic", 2] = -earth_field(case.place).declination_rad
    truth = multiply(exp(to_magnetic), truth)
    estimate = np.array([record.q_ned_frd for record in records]).reshape(-1, 4)
    _, heading, inclination = np.degrees(batch_angle_errors(estimate, truth)).T
    heading[references == "none"] = np.nan
    return np.stack([inclination, heading], axis=1)


def _angle(errors: Floats, sigmas: Floats) -> Angle:
    is_known = np.isfinite(errors)
    errors, sigmas = errors[is_known], sigmas[is_known]
    if not len(errors):
        return Angle(*[float("nan")] * 4)
    return Angle(
        float(np.sqrt(np.mean(errors**2))),
        float(np.median(sigmas)),
        float(np.mean(errors <= sigmas)),
        float(np.mean(errors > 3.0 * sigmas)),
    )


def _longest(time_s: Floats, flags: Flags, period_s: float) -> tuple[float, float]:
    """The longest unbroken time for which the flag stands, and when it began, s."""
    best_s, since_s, begin_s, last_s = 0.0, 0.0, 0.0, -np.inf
    for now_s in time_s[flags]:
        if now_s - last_s > 1.5 * period_s:
            begin_s = now_s
        last_s = now_s
        if now_s - begin_s + period_s > best_s:
            best_s, since_s = float(now_s - begin_s) + period_s, float(begin_s)
    return best_s, since_s
