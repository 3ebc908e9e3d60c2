"""Changes of a recording: samples left out, noise, sources that stop, jump or come alone."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import msgspec
import numpy as np

from drivers.events import BodyRates, Event, Imu, Velocity
from estimator.types import ZERO_VEC3, Vec3

Events = list[Event]
SEED = 7
HARD_IRON_GAUSS = (0.2, -0.15, 0.22)  # 335 mGauss
GAPS_S = ((60, 0.5), (100, 0.8), (150, 1.1), (200, 1.4), (260, 1.7), (330, 2.1), (400, 0.9))


class Change(NamedTuple):
    """One row: its name, how much of the start is not scored, and how the events are changed."""

    name: str
    skip_s: float
    change: Callable[[Events], Events]


def start_us(events: Events) -> int:
    """The first IMU sample's time."""
    return next(e.sample.time_us for e in events if isinstance(e, Imu))


def velocities(events: Events, keep: Callable[[float, str], bool]) -> Events:
    """Leave out velocities for which ``keep`` is False; it is given time in s and message."""
    begin = start_us(events)
    return [
        e
        for e in events
        if not isinstance(e, Velocity) or keep(1e-6 * (e.sample.time_us - begin), e.message)
    ]


def samples(events: Events, keep: Callable[[float, int], bool]) -> Events:
    """Leave out IMU samples for which ``keep`` is False; it is given time in s and number."""
    begin, kept, number = start_us(events), [], 0
    for event in events:
        if isinstance(event, Imu):
            number += 1
            if not keep(1e-6 * (event.sample.time_us - begin), number - 1):
                continue
        kept.append(event)
    return kept


def keep_one_in(events: Events, n: int) -> Events:
    """Keep every n-th sample; the field of a dropped one comes with the next, as in streams."""
    kept: Events = []
    number, mag = 0, None
    for event in events:
        if not isinstance(event, Imu):
            kept.append(event)
            continue
        if event.sample.has_mag:
            mag = event.sample.mag_gauss
        if number % n == 0:
            held = mag or ZERO_VEC3
            sample = event.sample._replace(mag_gauss=held, has_mag=mag is not None)
            kept.append(msgspec.structs.replace(event, sample=sample))
            mag = None
        number += 1
    return kept


def slow_down(events: Events) -> Events:
    """Another ground station slows IMU and ATTITUDE down to 4 Hz again and again."""
    begin, kept = start_us(events), []
    last_s: dict[tuple[type, str], float] = {}
    for event in events:
        if isinstance(event, Imu | BodyRates):
            t, stream = 1e-6 * (event.sample.time_us - begin), (type(event), event.message)
            is_slow = t % 2.0 > 0.9 and t % 7.0 > 1.5
            if is_slow and t - last_s.get(stream, -1.0) < 0.245:
                continue
            last_s[stream] = t
        kept.append(event)
    return kept


def lose_samples(events: Events) -> Events:
    """Lose three in ten samples at random."""
    rng = np.random.default_rng(SEED)
    return samples(events, lambda _, __: rng.random() > 0.3)


def gaps(events: Events) -> Events:
    """Leave seven gaps."""
    return samples(events, lambda t, _: not any(a <= t < a + s for a, s in GAPS_S))


def add_velocity(events: Events) -> Events:
    """Add 8 m/s for 5 s, and 3 m/s from 200 s on, to the velocities of all sources."""
    begin, changed = start_us(events), []
    for event in events:
        if isinstance(event, Velocity):
            t = 1e-6 * (event.sample.time_us - begin)
            more = 8.0 * (120.0 <= t < 125.0) + 3.0 * (t >= 200.0)
            north, east, down = event.sample.velocity_ned_m_s
            sample = event.sample._replace(velocity_ned_m_s=(north + more, east, down))
            changed.append(msgspec.structs.replace(event, sample=sample))
        else:
            changed.append(event)
    return changed


def add_noise(events: Events, times: float) -> Events:
    """Add noise to every sensor, and to velocity an error of first order over 5 s."""
    rng = np.random.default_rng(SEED)
    return list(_noisy_events(events, times, rng))


def _noisy_events(events: Events, times: float, rng: np.random.Generator) -> Iterator[Event]:
    slow, last_us = np.zeros(3), 0

    def scatter(vector: Vec3, sigma: float) -> Vec3:
        x, y, z = (np.array(vector) + times * sigma * rng.standard_normal(3)).tolist()
        return (x, y, z)

    for event in events:
        if isinstance(event, Imu):
            old = event.sample
            sample = old._replace(
                gyr_rad_s=scatter(old.gyr_rad_s, 0.005),
                acc_m_s2=scatter(old.acc_m_s2, 0.3),
                mag_gauss=scatter(old.mag_gauss, 0.005) if old.has_mag else old.mag_gauss,
            )
            yield msgspec.structs.replace(event, sample=sample)
        elif isinstance(event, Velocity):
            at_us = event.sample.time_us
            keep = np.exp(-max(0.0, 1e-6 * (at_us - last_us)) / 5.0)
            slow = keep * slow + 0.2 * times * np.sqrt(1.0 - keep * keep) * rng.standard_normal(3)
            last_us = max(last_us, at_us)
            x, y, z = (np.array(event.sample.velocity_ned_m_s) + slow).tolist()
            yield msgspec.structs.replace(
                event, sample=event.sample._replace(velocity_ned_m_s=(x, y, z))
            )
        else:
            yield event


def fields(events: Events, change: Callable[[Vec3], Vec3 | None]) -> Events:
    """Replace the field in every sample; where the function gives None there is no field."""
    changed: Events = []
    for event in events:
        if isinstance(event, Imu) and event.sample.has_mag:
            mag = change(event.sample.mag_gauss)
            sample = event.sample._replace(mag_gauss=mag or ZERO_VEC3, has_mag=mag is not None)
            changed.append(msgspec.structs.replace(event, sample=sample))
        else:
            changed.append(event)
    return changed


def remove_field(events: Events) -> Events:
    """No magnetometer."""
    return fields(events, lambda _: None)


def add_iron(events: Events) -> Events:
    """335 mGauss of hard iron."""
    iron = HARD_IRON_GAUSS
    return fields(events, lambda m: (m[0] + iron[0], m[1] + iron[1], m[2] + iron[2]))


CHANGES = (
    Change("as it is", 40.0, lambda events: events),
    Change("every second sample", 40.0, lambda events: keep_one_in(events, 2)),
    Change("every fourth", 40.0, lambda events: keep_one_in(events, 4)),
    Change("every fifth", 40.0, lambda events: keep_one_in(events, 5)),
    Change("every tenth", 40.0, lambda events: keep_one_in(events, 10)),
    Change("every 25th", 40.0, lambda events: keep_one_in(events, 25)),
    Change("slowed down to 4 Hz in bursts", 40.0, slow_down),
    Change("30 % of the samples lost", 40.0, lose_samples),
    Change("seven gaps of 0.5 to 2.1 s", 40.0, gaps),
    Change("no velocity for 30 s", 40.0, lambda e: velocities(e, lambda t, _: not 150 < t < 180)),
    Change("no velocity after 200 s", 40.0, lambda e: velocities(e, lambda t, _: t < 200.0)),
    Change("8 m/s too much for 5 s, 3 from 200 s", 40.0, add_velocity),
    Change("a receiver alone", 40.0, lambda e: velocities(e, lambda _, m: m.startswith("GPS"))),
    Change("a filter alone", 40.0, lambda e: velocities(e, lambda _, m: not m.startswith("GPS"))),
    Change("noise on every sensor", 40.0, lambda e: add_noise(e, 1.0)),
    Change("three times that", 40.0, lambda e: add_noise(e, 3.0)),
    Change("no magnetometer", 40.0, remove_field),
    Change("no magnetometer, from 120 s on", 120.0, remove_field),
    Change("335 mGauss of hard iron", 40.0, add_iron),
    Change("that, from 120 s on", 120.0, add_iron),
)
