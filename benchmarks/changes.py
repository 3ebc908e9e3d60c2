"""What does a recording's attitude lose when samples, sources or sensors are missing or worse?

    python benchmarks/changes.py LOG            with the simulator's truth (SIM_STATE)
    python benchmarks/changes.py LOG --thinned  the same at a ground station's rates

Degrees RMS behind the first 40 s, or 120 s where it says so; shares of errors of inclination and
heading under sigma, in all and in the worst 20 s; ``accelerometer`` is the inclination by the
accelerometer alone. ``--thinned`` keeps IMU and velocities at a rate whose intervals scatter by
15 %, ATTITUDE's body rates at one of their own or with the IMU, where they show nothing more; each
row is the median of ``--draws``.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np
from common.report import Row, parser, show
from flying.replayed import Events, changed, fly, read, score

from drivers.events import BodyRates, Event, Imu, Velocity
from estimator.geometry.quaternion import add
from estimator.types import ZERO_VEC3, ImuSample, Vec3, VelocitySample

SKIP_S, LATE_S = 40.0, 120.0
SEED, JITTER = 7, 0.15
HARD_IRON_GAUSS = (0.2, -0.15, 0.22)  # 335 mGauss
# Rates of IMU and velocities, and of ATTITUDE (0: it comes with the IMU), in Hz.
THINNED_HZ = ((1.0, 0.0), (2.0, 0.0), (2.0, 4.0), (2.0, 10.0), (4.0, 0.0), (4.0, 10.0))
SHORT_LOG = Path(__file__).parents[1] / "tests" / "data" / "sitl_copter_flips.tlog"


def keep_one_in(n: int) -> Callable[[Events], Events]:
    """Keep every n-th sample; the field of a dropped one comes with the next, as in streams."""

    def change(events: Events) -> Events:
        number, mag = -1, None

        def keep(_: float, s: ImuSample) -> ImuSample | None:
            nonlocal number, mag
            number, mag = number + 1, s.mag_gauss if s.has_mag else mag
            if number % n:
                return None
            kept, mag = s._replace(mag_gauss=mag or ZERO_VEC3, has_mag=mag is not None), None
            return kept

        return changed(events, keep)

    return change


def faster(north_m_s: Callable[[float], float]) -> Callable[[Events], Events]:
    """All sources say so much more to the north."""

    def change(t: float, s: VelocitySample, _: str) -> VelocitySample:
        return s._replace(velocity_ned_m_s=add(s.velocity_ned_m_s, (north_m_s(t), 0.0, 0.0)))

    return lambda events: changed(events, velocity=change)


def noise(events: Events) -> Events:
    """Noise on every sensor, and on velocity an error of first order over 5 s."""
    rng = np.random.default_rng(SEED)
    slow, last_s = np.zeros(3), 0.0

    def scatter(vector: Vec3, sigma: float) -> Vec3:
        x, y, z = (sigma * rng.standard_normal(3)).tolist()
        return add(vector, (x, y, z))

    def imu(_: float, s: ImuSample) -> ImuSample:
        return s._replace(
            gyr_rad_s=scatter(s.gyr_rad_s, 0.005),
            acc_m_s2=scatter(s.acc_m_s2, 0.3),
            mag_gauss=scatter(s.mag_gauss, 0.005) if s.has_mag else s.mag_gauss,
        )

    def velocity(t: float, s: VelocitySample, _: str) -> VelocitySample:
        nonlocal slow, last_s
        keep = np.exp(-max(0.0, t - last_s) / 5.0)
        slow = keep * slow + 0.2 * np.sqrt(1.0 - keep**2) * rng.standard_normal(3)
        last_s = max(last_s, t)
        x, y, z = slow.tolist()
        return s._replace(velocity_ned_m_s=add(s.velocity_ned_m_s, (x, y, z)))

    return changed(events, imu, velocity)


def field(change: Callable[[Vec3], Vec3 | None]) -> Callable[[Events], Events]:
    """Another field in every sample; None where there is none."""

    def imu(_: float, s: ImuSample) -> ImuSample:
        mag = change(s.mag_gauss) if s.has_mag else None
        return s._replace(mag_gauss=mag or ZERO_VEC3, has_mag=mag is not None)

    return lambda events: changed(events, imu)


def broken(name: str, by: Vec3) -> Callable[[Events], Events]:
    """A step of one sensor's readings at 120 s."""

    def imu(t: float, s: ImuSample) -> ImuSample:
        return s._replace(**{name: add(getattr(s, name), by)}) if t >= LATE_S else s

    return lambda events: changed(events, imu)


NO_FIELD, IRON = field(lambda _: None), field(lambda m: add(m, HARD_IRON_GAUSS))
# By name what is not scored of the start, s, and how the events are changed.
CHANGES: dict[str, tuple[float, Callable[[Events], Events]]] = {
    "as it is": (SKIP_S, lambda events: events),
    "every sample of 25": (SKIP_S, keep_one_in(25)),
    "noise on every sensor": (SKIP_S, noise),
    "no magnetometer, from 120 s on": (LATE_S, NO_FIELD),
    "335 mGauss of hard iron, from 120 s on": (LATE_S, IRON),
    "gyroscope, a step of 0.02 rad/s": (LATE_S, broken("gyr_rad_s", (0.02, -0.02, 0.02))),
    "accelerometer, a step of 0.5 m/s^2": (LATE_S, broken("acc_m_s2", (0.5, -0.5, 0.0))),
    "velocity, 0.3 m/s^2 for 20 s": (
        LATE_S,
        faster(lambda t: 0.3 * min(max(t - LATE_S, 0.0), 20.0)),
    ),
}


class Schedule:
    """Lets through the first event behind each due time."""

    def __init__(self, rate_hz: float, rng: np.random.Generator) -> None:
        self._period_us, self._rng = 1e6 / rate_hz, rng
        self._due_us: float | None = None

    def lets_through(self, time_us: int) -> bool:
        """Whether an event of that time is kept."""
        self._due_us = float(time_us) if self._due_us is None else self._due_us
        if time_us < self._due_us:
            return False
        while self._due_us <= time_us:
            scatter = 1.0 + JITTER * float(self._rng.uniform(-1.0, 1.0))
            self._due_us += self._period_us * scatter
        return True


def thin(events: Events, imu_hz: float, attitude_hz: float, draw: int) -> Events:
    """The events that a slower link would carry."""
    rng = np.random.default_rng(500 + draw)
    imu, rates = Schedule(imu_hz, rng), Schedule(attitude_hz or imu_hz, rng)
    by_message: dict[str, Schedule] = {}

    def is_kept(event: Event) -> bool:
        match event:
            case Imu():
                return imu.lets_through(event.sample.time_us)
            case BodyRates():
                return attitude_hz > 0.0 and rates.lets_through(event.sample.time_us)
            case Velocity():
                one = by_message.setdefault(event.message, Schedule(imu_hz, rng))
                return one.lets_through(event.sample.time_us)
        return True

    return [event for event in events if is_kept(event)]


def thinned_row(
    events: Events, imu_hz: float, attitude_hz: float, draws: int, skip_s: float
) -> Row:
    """The median of the draws, number by number."""
    rows = [score(fly(thin(events, imu_hz, attitude_hz, k)), skip_s) for k in range(draws)]
    found: Row = {"IMU Hz": imu_hz, "ATTITUDE Hz": attitude_hz or "with the IMU"}
    for name, value in rows[0].items():
        columns = [row[name] for row in rows]
        is_list = isinstance(value, list)
        found[name] = (
            [median(c) for c in zip(*columns, strict=True)] if is_list else median(columns)
        )
    return found


def main() -> int:
    made = parser(__doc__)
    made.add_argument("recording", type=Path, nargs="?", metavar="LOG")
    made.add_argument("--thinned", action="store_true")
    made.add_argument("--draws", type=int, default=3, metavar="N")
    options = made.parse_args()
    if options.recording is None and not options.smoke:
        made.error("give a LOG, or --smoke")
    changes, rates, skips = dict(CHANGES), list(THINNED_HZ), (SKIP_S, LATE_S)
    if options.smoke:
        options.recording, options.draws = options.recording or SHORT_LOG, 1
        changes, rates, skips = dict(list(CHANGES.items())[:3]), rates[-1:], (10.0, 10.0)
    events = read(options.recording)
    tables: dict[str, list[Row]] = {}
    if options.thinned or options.smoke:
        tables["at a ground station's rates, degrees"] = [
            thinned_row(events, *hz, options.draws, skips[0]) for hz in rates
        ]
    if not options.thinned:
        tables["changed, degrees"] = [
            {"but": name, **score(fly(change(events)), min(skip_s, max(skips)))}
            for name, (skip_s, change) in changes.items()
        ]
    show(tables, as_json=options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
