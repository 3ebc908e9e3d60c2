"""The telemetry log that an autopilot would record of a motion.

The stream has what real ones have: an IMU low-passed at 20 Hz and truncated toward zero, a field
averaged to 10 Hz, sample times that miss the grid, velocities from an autopilot's filter and from
a receiver, each with its own faults, positions before there are any, and the autopilot's report
of its own filter. The truth comes behind each IMU sample as SIM_STATE.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from common.paper_filter import matrices
from common.recordings import Array
from common.ways import direction
from flying.motions import FINE_HZ, Motion
from pymavlink.dialects.v20 import ardupilotmega
from scipy.signal import butter, lfilter, lfilter_zi

from estimator.geometry.earth import field_at
from estimator.geometry.frames import euler_rad
from estimator.types import STANDARD_GRAVITY_M_S2

ARMED = 0xD1  # MAV_MODE_FLAG: armed, stabilized, manual input, custom mode
START_UNIX_US = 1_760_000_000_000_000
LATITUDE_DEG, LONGITUDE_DEG, ALTITUDE_M = -35.363, 149.165, 584.0
METRES_A_DEGREE = 111_320.0
FIX_S = 12.0  # the receiver gets its fix at this time
FILTER_S = 20.0  # the autopilot's filter has a position from this time on
GOOD_FLAGS = 0x01 | 0x02 | 0x04 | 0x08 | 0x10 | 0x20
LOST_FLAGS = 0x01 | 0x04 | 0x20 | 0x80  # constant position: no velocity, no position
BEFORE_FIX_FLAGS = 0x01 | 0x04 | 0x20 | 0x80 | 0x400
FIX_NONE, FIX_3D = 1, 3
VIBRATION_S, FORGETS_S = 3.0, 1.0  # how long it lasts, and how long in a filter's velocity
MIX = (0.68, 0.31, 0.01)  # of a plane's intervals
WRONG_M_S = 4.0  # what velocities are off by while the satellites are wrong


class Sensors(NamedTuple):
    """One sigma each, SI and gauss."""

    gyr: float = 0.003
    gyr_bias: float = 0.003
    acc: float = 0.15
    acc_bias: float = 0.05
    vibration: float = 0.0  # bias of the accelerometer that comes and goes in flight
    mag: float = 0.004
    hard_iron: float = 0.005  # length of the vector
    current: float = 0.0  # of the motors' field at full throttle
    field_turn_rad: float = 0.0  # by which iron all around turns the field about the body's down
    field_scale: float = 1.0  # and its strength
    gyr_hz: float = 20.0  # cutoff of the low-pass
    acc_hz: float = 20.0


class Filter(NamedTuple):
    """The velocity of an autopilot's filter."""

    ahead_s: float = 0.0125
    slow_m_s: float = 0.1  # per component, everywhere
    turning_m_s: float = 0.15  # added to that for each g of horizontal acceleration
    tau_s: float = 5.0


class Receiver(NamedTuple):
    """A satellite receiver's velocity."""

    late_s: float = 0.12
    jitter_s: float = 0.0  # a report is later by up to this, at random
    noise_m_s: float = 0.05
    slow_m_s: float = 0.1
    tau_s: float = 20.0
    reported_m_s: float = 0.3  # the accuracy that it reports of itself; 0: none


class Link(NamedTuple):
    """When samples are sent, and how they arrive."""

    period_s: float = 0.02
    mixed: bool = False  # 20 and 40 ms, as planes send them
    late_s: float = 0.006  # mean delay beyond the shortest one, exponentially distributed
    drift: float = 1e-3  # the vehicle's clock runs slow by this share
    holes: int = 0  # stretches of 1 to 5 s in which nothing arrives


class Trouble(NamedTuple):
    """With satellites, (from, to) in s: None where there is none."""

    lost: tuple[float, float] | None = None
    wrong: tuple[float, float] | None = None


class Flight(NamedTuple):
    """All that a recording is made of."""

    sensors: Sensors = Sensors()
    filter: Filter = Filter()
    receiver: Receiver = Receiver()
    link: Link = Link()
    trouble: Trouble = Trouble()
    vehicle_type: int = 2  # MAV_TYPE


class Signals(NamedTuple):
    """Everything at ``FINE_HZ``."""

    gyr: Array
    acc: Array
    mag: Array
    by_filter: Array
    by_receiver: Array
    position: Array


def signals(motion: Motion, flight: Flight, rng: np.random.Generator) -> Signals:
    """What sensors, filter and receiver make of a motion."""
    R = matrices(motion.attitude)
    n, s = len(R), flight.sensors
    acceleration = np.gradient(motion.velocity, 1.0 / FINE_HZ, axis=0)
    force = acceleration - (0.0, 0.0, STANDARD_GRAVITY_M_S2)
    felt = np.einsum("nji,nj->ni", R, force)
    left_over = np.sqrt(FINE_HZ / 44.0)  # so much noise remains behind the low-pass
    moving = np.linalg.norm(motion.velocity, axis=1) > 0.1
    shaken = np.zeros((n, 3))
    if s.vibration > 0.0:
        shaken = s.vibration * moving[:, None] * _slow(n, 1.0, VIBRATION_S, rng)

    # what a filter that integrates the same accelerometer makes of its errors
    keep = 1.0 - 1.0 / (FORGETS_S * FINE_HZ)
    shaken_ned = np.einsum("nij,nj->ni", R, shaken)
    integrated = lfilter([1.0 / FINE_HZ], [1.0, -keep], shaken_ned, axis=0)

    def sense(signal: Array, sigma: float, bias: float, cutoff_hz: float) -> Array:
        noise = left_over * sigma * (0.1 + 0.9 * moving[:, None]) * rng.standard_normal((n, 3))
        wrong = signal + bias * rng.standard_normal(3) + noise
        b, a = butter(2, cutoff_hz, fs=FINE_HZ)
        start = lfilter_zi(b, a)[:, None] * wrong[:1]
        return np.asarray(lfilter(b, a, wrong, axis=0, zi=start)[0])

    return Signals(
        sense(motion.rate, s.gyr, s.gyr_bias, s.gyr_hz),
        sense(felt + shaken, s.acc, s.acc_bias, s.acc_hz),
        _averaged_field(R, motion, s, rng),
        _filters(motion, acceleration, flight.filter, rng) + integrated,
        motion.velocity + _slow(n, flight.receiver.slow_m_s, flight.receiver.tau_s, rng),
        np.cumsum(motion.velocity, axis=0) / FINE_HZ,
    )


def _averaged_field(R: Array, motion: Motion, s: Sensors, rng: np.random.Generator) -> Array:
    """Means over 0.1 s, each held over the next."""
    place = field_at(LATITUDE_DEG, LONGITUDE_DEG, ALTITUDE_M, START_UNIX_US)
    assert place is not None
    dip, declination = place.dip_rad, place.declination_rad
    north = (np.cos(dip) * np.cos(declination), np.cos(dip) * np.sin(declination), np.sin(dip))
    field = np.einsum("nji,j->ni", R, place.strength_gauss * np.array(north))
    c, d = s.field_scale * np.cos(s.field_turn_rad), s.field_scale * np.sin(s.field_turn_rad)
    field = field @ np.array([[c, d, 0.0], [-d, c, 0.0], [0.0, 0.0, s.field_scale]])
    field += s.hard_iron * direction(rng)
    field += s.current * motion.throttle[:, None] * direction(rng)
    block = FINE_HZ // 10
    means = field[: len(field) // block * block].reshape(-1, block, 3).mean(axis=1)
    means += s.mag * rng.standard_normal(means.shape)
    return np.repeat(np.vstack([means[:1], means]), block, axis=0)


def _filters(
    motion: Motion, acceleration: Array, chosen: Filter, rng: np.random.Generator
) -> Array:
    """A filter's velocity: ahead of its time stamp, and further off where the vehicle turns."""
    b, a = butter(1, 0.3, fs=FINE_HZ)
    turning = lfilter(b, a, np.hypot(acceleration[:, 0], acceleration[:, 1]))
    share = chosen.slow_m_s + chosen.turning_m_s * turning / STANDARD_GRAVITY_M_S2
    slow = share[:, None] * _slow(len(turning), 1.0, chosen.tau_s, rng)
    ahead = round(chosen.ahead_s * FINE_HZ)
    velocity = np.vstack([motion.velocity[ahead:], np.repeat(motion.velocity[-1:], ahead, axis=0)])
    at_rest = np.linalg.norm(motion.velocity, axis=1) < 0.1
    return np.asarray(velocity + slow * (0.2 + 0.8 * ~at_rest[:, None]))


def _slow(n: int, sigma: float, tau_s: float, rng: np.random.Generator) -> Array:
    """First-order noise, smoothed: neither has steps."""
    keep = np.exp(-1.0 / (FINE_HZ * tau_s))
    white = np.sqrt(1.0 - keep * keep) * rng.standard_normal((n, 3))
    slow = lfilter([1.0], [1.0, -keep], white, axis=0)
    b, a = butter(1, 0.5, fs=FINE_HZ)
    return np.asarray(sigma * lfilter(b, a, slow, axis=0))


def sample_times(link: Link, end_s: float, rng: np.random.Generator) -> Array:
    """Seconds at which the IMU is sent."""
    sent, t = [], 0.5
    while t < end_s - 0.5:
        sent.append(t)
        t += float(rng.choice((0.02, 0.04, 0.1), p=MIX)) if link.mixed else link.period_s
    times = np.array(sent)
    for begin in rng.uniform(40.0, end_s - 20.0, link.holes):
        times = times[(times < begin) | (times > begin + rng.uniform(1.0, 5.0))]
    return times


def record(path: Path, motion: Motion, flight: Flight, seed: int) -> None:
    """Write the telemetry log of one flight."""
    rng = np.random.default_rng(1000 + seed)
    now = signals(motion, flight, rng)
    mav, file = ardupilotmega.MAVLink(None, srcSystem=1, srcComponent=1), path.open("wb")

    def put(arrival_us: int, name: str, *fields: Any) -> None:
        message = getattr(ardupilotmega, f"MAVLink_{name}_message")(*fields)
        file.write(struct.pack(">Q", arrival_us & ~3) + message.pack(mav))

    reports = _Reports(flight, now, rng)
    link, sensors = flight.link, flight.sensors
    end_s = len(motion.attitude) / FINE_HZ
    mg, mrad, arrival_us, next_beat_s = 1000.0 / STANDARD_GRAVITY_M_S2, 1000.0, 0, 0.0
    times = sample_times(link, end_s, rng)
    with file:
        for k, axis in enumerate("XYZ"):
            put(START_UNIX_US, "param_value", f"COMPASS_OFS_{axis}".encode(), 40.0 + k, 9, 4, k)
        for t in times:
            i = int(t * FINE_HZ)  # up to 2.5 ms older than its stamp
            stamp_us = round(1e6 * (5.0 + t * (1.0 - link.drift)))
            late_s = 0.002 + float(rng.exponential(link.late_s))
            arrival_us = max(arrival_us, START_UNIX_US + round(1e6 * (t + late_s)))
            if t >= next_beat_s:
                next_beat_s = t + 1.0
                put(arrival_us, "heartbeat", flight.vehicle_type, 3, ARMED, 0, 4, 3)
            for message in reports.until(t, stamp_us):
                put(arrival_us, *message)
            q = motion.attitude[i].tolist()
            readings = (*now.acc[i] * mg, *now.gyr[i] * mrad, *now.mag[i] * 1000.0)
            put(arrival_us, "raw_imu", stamp_us, *(int(value) for value in readings))
            roll, pitch, yaw = euler_rad((q[0], q[1], q[2], q[3]))
            put(arrival_us, "sim_state", *q, roll, pitch, yaw, *(0.0,) * 14)
            if t == times[0]:  # a parameter counts once its vehicle is known
                put(arrival_us, "param_value", b"INS_GYRO_FILTER", sensors.gyr_hz, 9, 4, 3)
                put(arrival_us, "param_value", b"INS_ACCEL_FILTER", sensors.acc_hz, 9, 4, 3)


class _Reports:
    """Velocities, positions and the filter's state, each at its own rate."""

    def __init__(self, flight: Flight, now: Signals, rng: np.random.Generator) -> None:
        self._flight, self._now, self._rng = flight, now, rng
        self._next_s = dict.fromkeys(("filter", "receiver", "flags"), 0.5)
        self._drift = np.zeros(3)

    def until(self, t: float, stamp_us: int) -> Iterator[tuple[Any, ...]]:
        """Messages that are due at ``t``, each as a name and its fields."""
        slow = max(0.1, self._flight.link.period_s)
        for name, period_s in (("flags", 1.0), ("filter", slow), ("receiver", 0.2)):
            if t >= self._next_s[name]:
                self._next_s[name] = max(self._next_s[name] + period_s, t - period_s)
                yield from getattr(self, "_" + name)(t, stamp_us)

    def _are_satellites_lost(self, t: float) -> bool:
        lost = self._flight.trouble.lost
        return t < FILTER_S or (lost is not None and lost[0] <= t < lost[1])

    def _satellite_error(self, t: float) -> Array:
        """Error of a velocity (m/s) while the satellites are wrong."""
        wrong = self._flight.trouble.wrong
        is_wrong = wrong is not None and wrong[0] <= t < wrong[1]
        return np.array([WRONG_M_S * is_wrong, 0.0, 0.0])

    def _flags(self, t: float, _: int) -> Iterator[tuple[Any, ...]]:
        lost = BEFORE_FIX_FLAGS if t < FILTER_S else LOST_FLAGS
        flags = lost if self._are_satellites_lost(t) else GOOD_FLAGS
        yield ("ekf_status_report", flags, 0.05, 0.05, 0.05, 0.05, 0.0)

    def _filter(self, t: float, stamp_us: int) -> Iterator[tuple[Any, ...]]:
        i = int(t * FINE_HZ)
        velocity = self._now.by_filter[i] + self._satellite_error(t - 2.0)
        if self._are_satellites_lost(t) and t >= FILTER_S:
            self._drift += 0.3 * self._rng.standard_normal(3)
            velocity = velocity + self._drift + np.array([3.0, -3.0, 0.0])
        elif t < FILTER_S:
            velocity = 0.02 * self._rng.standard_normal(3)
        else:
            self._drift[:] = 0.0
            yield ("local_position_ned", stamp_us // 1000, 0.0, 0.0, 0.0, *velocity.tolist())
        lat, lon = (2081, -732) if t < FIX_S else self._place(i)  # near (0, 0) before the fix
        cm_s = (int(100.0 * v) for v in velocity)
        alt = round(1e3 * ALTITUDE_M)
        yield ("global_position_int", stamp_us // 1000, lat, lon, alt, 0, *cm_s, 0)

    def _receiver(self, t: float, stamp_us: int) -> Iterator[tuple[Any, ...]]:
        chosen = self._flight.receiver
        lost = self._are_satellites_lost(t) and t > FILTER_S
        fix = FIX_NONE if t < FIX_S or lost else FIX_3D
        age = chosen.late_s + chosen.jitter_s * float(self._rng.random())
        i = max(0, int((t - age) * FINE_HZ))
        v = self._now.by_receiver[i] + chosen.noise_m_s * self._rng.standard_normal(3)
        v = v + self._satellite_error(t)
        speed = min(65534, round(100.0 * float(np.hypot(v[0], v[1]))))
        course = round(100.0 * float(np.degrees(np.arctan2(v[1], v[0])))) % 36000
        lat, lon = self._place(i) if fix == FIX_3D else (0, 0)
        alt, sigma = round(1e3 * ALTITUDE_M), round(1e3 * chosen.reported_m_s)
        accuracy = (0, 500, 800, sigma, 0)
        yield ("gps_raw_int", stamp_us, fix, lat, lon, alt, 90, 90, speed, course, 12, *accuracy)

    def _place(self, i: int) -> tuple[int, int]:
        north, east, _ = self._now.position[i]
        lat = LATITUDE_DEG + north / METRES_A_DEGREE
        lon = LONGITUDE_DEG + east / (METRES_A_DEGREE * float(np.cos(np.radians(LATITUDE_DEG))))
        return round(1e7 * lat), round(1e7 * lon)
