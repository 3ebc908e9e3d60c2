"""Is a wrong attitude told, how soon, of whom, and how often is a right one accused?

    python benchmarks/second_opinion.py DIR|LOG...

Every log is replayed once as it is: what is said then is a false alarm, unless log and reference
really differ. Then the autopilot's attitude is turned by 10, 20 and 45 deg about each axis of NED,
for 40 s from 30 % and 60 % of the log on, at once or within the first 20 s; so is ours, with its
sigma as it was. "known" are the cases in which
three sigma and the usual offset leave room for the difference to be seen. The rival says that they
differ by more than 15 deg for 3 s.

Then each healthy log is replayed with a fault of our IMU from 40 % on, while the autopilot's
attitude stays as it was recorded; "wrong" are the cases in which ours is led more than 20 deg off
for 10 s. At last both are right, but the autopilot's is late, trimmed, or from another north.
"""

import sys
from collections import Counter
from collections.abc import Callable, Iterable
from itertools import product
from math import cos, degrees, radians, sin
from pathlib import Path
from statistics import median
from typing import NamedTuple

import msgspec
from common.report import Row, parser, show

from drivers.events import Event, Imu, ReferenceAttitude, VehicleId
from drivers.logs.open import SUFFIXES, open_log
from estimator.errors import InputError
from estimator.geometry.earth import PlaceField
from estimator.geometry.quaternion import add, angle_between, exp, multiply, rotate, scale
from estimator.profile import load_profile
from estimator.types import Attitude, ImuSample, Quaternion, Vec3
from fuzzbee.replays.trace import Replay
from service.second_opinion import Doubts, Opinion, SecondOpinion, Verdict, differences

DATA = Path(__file__).parents[1] / "tests" / "data"
BEGIN_SHARES, LASTS_S, CREEPS_S = (0.3, 0.6), 40.0, 20.0
SIZES_DEG = (10.0, 20.0, 45.0)
RIVAL_DEG, RIVAL_S = 15.0, 3.0
FAST_HZ = 9.0
FAULT_FROM, WRONG_DEG, WRONG_S, SURE_DEG = 0.4, 20.0, 10.0, 5.0


class Look(NamedTuple):
    """What :meth:`SecondOpinion.look` was given."""

    time_us: int
    message: str
    theirs: Quaternion
    ours: Attitude
    sample: ImuSample
    place: PlaceField | None
    doubts: Doubts = Doubts()


def _with(**changes: Callable[[ImuSample], Vec3]) -> Callable[[ImuSample], ImuSample]:
    return lambda sample: sample._replace(**{k: new(sample) for k, new in changes.items()})


def _on(axis: int, vector: Vec3, value: float) -> Vec3:
    made = list(vector)
    made[axis] = value
    return (made[0], made[1], made[2])


SENSOR_FAULTS: dict[str, Callable[[ImuSample], ImuSample]] = {
    "gyroscope x, 10 deg/s off": _with(gyr_rad_s=lambda s: add(s.gyr_rad_s, (0.17, 0.0, 0.0))),
    "gyroscope z, 10 deg/s off": _with(gyr_rad_s=lambda s: add(s.gyr_rad_s, (0.0, 0.0, 0.17))),
    "gyroscope z, half": _with(gyr_rad_s=lambda s: _on(2, s.gyr_rad_s, 0.5 * s.gyr_rad_s[2])),
    "gyroscope x, stuck": _with(gyr_rad_s=lambda s: _on(0, s.gyr_rad_s, 0.01)),
    "accelerometer, 4 m/s^2 off": _with(acc_m_s2=lambda s: add(s.acc_m_s2, (4.0, 0.0, 0.0))),
    "compass, turned by 45 deg": _with(
        mag_gauss=lambda s: rotate(exp((0.0, 0.0, radians(45.0))), s.mag_gauss)
    ),
}
BOTH_RIGHT: dict[str, Callable[["Look"], "Look"]] = {
    "0.2 s late": lambda look: look._replace(
        theirs=multiply(look.theirs, exp(scale(-0.2, look.ours.rate_rad_s)))
    ),
    "trimmed by 5 deg": lambda look: look._replace(
        theirs=multiply(look.theirs, exp((0.0, radians(5.0), 0.0)))
    ),
    "12 deg of declination, ours magnetic": lambda look: look._replace(
        theirs=multiply(exp((0.0, 0.0, radians(12.0))), look.theirs),
        ours=look.ours._replace(heading_reference="magnetic"),
    ),
    "12 deg of declination, ours true": lambda look: look._replace(
        theirs=multiply(exp((0.0, 0.0, radians(12.0))), look.theirs)
    ),
}


class Recording(SecondOpinion):
    """Keeps what it was told, to be told again with a fault in it, and what it said."""

    def __init__(self) -> None:
        super().__init__()
        self.told: list[Look | tuple[int, Vec3]] = []
        self.said: list[Opinion] = []

    def look(self, *given) -> None:  # type: ignore[override]
        """See :class:`SecondOpinion`."""
        self.told.append(Look(*given))
        super().look(*given)
        assert self.opinion is not None
        self.said.append(self.opinion)

    @property
    def seen(self) -> list[Look]:
        """What it looked at."""
        return [each for each in self.told if isinstance(each, Look)]

    def take_velocity(self, time_us: int, velocity_ned_m_s: Vec3) -> None:
        """See :class:`SecondOpinion`."""
        self.told.append((time_us, velocity_ned_m_s))
        super().take_velocity(time_us, velocity_ned_m_s)


class Case(NamedTuple):
    """Who is turned, about which axis of NED, by how much, how fast, and from when on."""

    whose: str
    axis: int
    size_deg: float
    creeps_s: float
    begin_s: float


def recorded(
    path: Path,
    fault: Callable[[ImuSample], ImuSample] | None = None,
    from_us: int = 0,
) -> tuple[Recording, float]:
    """The looks of a log's vehicle with most of them, and the rate (Hz) of its samples.

    From ``from_us`` on (the vehicle's clock) its IMU has the fault.
    """
    replay = Replay(load_profile("imu"))
    kept: dict[VehicleId, Recording] = {}

    def events() -> Iterable[Event]:
        with open_log(path) as log:
            for event in log:
                if isinstance(event, ReferenceAttitude) and event.vehicle not in kept:
                    vehicle = replay.pipeline.vehicle(event.vehicle)
                    if vehicle is not None:
                        vehicle.comparison = kept[event.vehicle] = Recording()
                is_hit = isinstance(event, Imu) and event.sample.time_us >= from_us
                yield _hit(event, fault) if fault is not None and is_hit else event

    replay.run(events())
    if not kept:
        return Recording(), 0.0
    address = max(kept, key=lambda each: len(kept[each].told))
    vehicle = replay.pipeline.vehicle(address)
    return kept[address], 0.0 if vehicle is None else vehicle.imu.median_rate_hz


def _hit(event: Event, fault: Callable[[ImuSample], ImuSample]) -> Event:
    assert isinstance(event, Imu)
    return msgspec.structs.replace(event, sample=fault(event.sample))


def turned(case: Case, since_s: float, q: Quaternion) -> Quaternion:
    """An attitude with the case's fault, ``since_s`` after the log's first look."""
    after_s = since_s - case.begin_s
    if not 0.0 <= after_s <= LASTS_S:
        return q
    share = 1.0 if case.creeps_s == 0.0 else min(1.0, after_s / case.creeps_s)
    half = 0.5 * radians(share * case.size_deg)
    turn = [cos(half), 0.0, 0.0, 0.0]
    turn[1 + case.axis] = sin(half)
    return multiply((turn[0], turn[1], turn[2], turn[3]), q)


class Heard(NamedTuple):
    """What was said of a case."""

    said_s: float | None  # after its beginning
    rival_s: float | None
    wrong: str
    agreed: bool  # at a time when one was off by all of it, and over 20 deg
    is_known: bool


def heard(recording: Recording, case: Case) -> Heard:
    """Tell it all again, with the fault."""
    looks = recording.seen
    opinion, begun_us = SecondOpinion(), looks[0].time_us
    said_s, wrong, agreed, rooms = None, "", False, []
    rival_since_s, rival_s = None, None
    for each in recording.told:
        if not isinstance(each, Look):
            opinion.take_velocity(*each)
            continue
        since_s = 1e-6 * (each.time_us - begun_us)
        after_s = since_s - case.begin_s
        theirs, ours = each.theirs, each.ours
        if case.whose == "autopilot":
            theirs = turned(case, since_s, theirs)
        elif case.whose == "ours":
            ours = ours._replace(q_ned_frd=turned(case, since_s, ours.q_ned_frd))
        opinion.look(*each._replace(theirs=theirs, ours=ours))
        if not 0.0 <= after_s <= LASTS_S:
            rival_since_s = None
            continue
        said = opinion.opinion
        assert said is not None
        axis = said.heading if case.axis == 2 else said.inclination
        rooms.append(case.size_deg - axis.allowed_deg)
        tilt, turn = differences(theirs, ours)
        is_off = max(tilt.off_deg, abs(turn.off_deg)) > RIVAL_DEG
        rival_since_s = (rival_since_s or since_s) if is_off else None
        if rival_s is None and rival_since_s is not None and since_s - rival_since_s > RIVAL_S:
            rival_s = after_s
        if said.verdict is Verdict.DIFFERS:
            said_s = after_s if said_s is None else said_s
            wrong = said.wrong or wrong
        is_whole = after_s >= case.creeps_s and case.size_deg > 20.0
        agreed = agreed or (is_whole and said.verdict is Verdict.AGREES)
    return Heard(said_s, rival_s, wrong, agreed, median(rooms or [-1.0]) > 0.0)


class Led(NamedTuple):
    """What a fault of our IMU has done, and what was said of it."""

    is_wrong: bool  # ours was more than WRONG_DEG off for WRONG_S
    is_known: bool  # sigma allowed it to be seen for most of that time
    said_s: float | None  # after it was
    wrong: str  # named
    agreed: bool  # was said while ours was so far off and claimed to be good


def led(path: Path, clean: Recording, fault: Callable[[ImuSample], ImuSample]) -> Led:
    """Replay a log with a fault of its IMU, and compare ours with ours without the fault."""
    looks = clean.seen
    begin_us = looks[0].time_us + round(FAULT_FROM * (looks[-1].time_us - looks[0].time_us))
    true = {each.time_us: each.ours.q_ned_frd for each in looks}
    faulty, _ = recorded(path, fault, begin_us)
    since_us: int | None = None
    said_s, wrong, agreed, is_wrong = None, "", False, False
    rooms: list[float] = [-1.0]
    for look, said in zip(faulty.seen, faulty.said, strict=True):
        if look.time_us < begin_us or look.time_us not in true:
            continue
        off_deg = degrees(angle_between(true[look.time_us], look.ours.q_ned_frd))
        if off_deg <= WRONG_DEG:
            since_us = None
            continue
        since_us = look.time_us if since_us is None else since_us
        lasts_s = 1e-6 * (look.time_us - since_us)
        is_wrong = is_wrong or lasts_s >= WRONG_S
        both = (said.inclination, said.heading)
        rooms.append(max(abs(axis.off_deg) - axis.allowed_deg for axis in both))
        sigma_deg = degrees(max(look.ours.sigma_inclination_rad, look.ours.sigma_heading_rad))
        agreed = agreed or (said.verdict is Verdict.AGREES and sigma_deg < SURE_DEG and lasts_s > 1)
        if said.verdict is Verdict.DIFFERS:
            said_s = lasts_s if said_s is None else said_s
            wrong = said.wrong or wrong
    return Led(is_wrong, median(rooms) > 0.0, said_s, wrong, agreed)


def led_table(found: list[tuple[str, Led]]) -> list[Row]:
    """One row for each fault of our IMU."""
    rows: list[Row] = []
    for name in SENSOR_FAULTS:
        those = [each for fault, each in found if fault == name]
        wrong = [each for each in those if each.is_wrong]
        seconds = [each.said_s for each in wrong if each.said_s is not None]
        named = [each.wrong for each in wrong if each.wrong]
        rows.append(
            {
                "our IMU": name,
                "logs": len(those),
                "wrong": len(wrong),
                "said": len(seconds),
                "known": sum(each.is_known for each in wrong),
                "known and said": sum(e.is_known and e.said_s is not None for e in wrong),
                "after s": median(seconds) if seconds else None,
                "named": len(named),
                "named right": named.count("ours"),
                "agreed meanwhile": sum(each.agreed for each in those),
            }
        )
    return rows


def right_alarms(recording: Recording, changed: Callable[[Look], Look]) -> int:
    """How often it is said of two that are right that they differ."""
    opinion = SecondOpinion()
    for each in recording.told:
        if isinstance(each, Look):
            opinion.look(*changed(each))
        else:
            opinion.take_velocity(*each)
    return len(opinion.intervals)


def cases(span_s: float, sizes: Iterable[float], whose: Iterable[str]) -> Iterable[Case]:
    """All faults of a log that is so long."""
    for who, axis, size, creeps, share in product(
        whose, range(3), sizes, (0.0, CREEPS_S), BEGIN_SHARES
    ):
        yield Case(who, axis, size, creeps, share * span_s)


def rival_alarms(recording: Recording) -> int:
    """How often the rival speaks of a log as it is."""
    count, since_us, is_on = 0, None, False
    for each in recording.told:
        if isinstance(each, Look):
            tilt, turn = differences(each.theirs, each.ours)
            is_off = max(tilt.off_deg, abs(turn.off_deg)) > RIVAL_DEG
            since_us = (each.time_us if since_us is None else since_us) if is_off else None
            lasts = since_us is not None and each.time_us - since_us > 1e6 * RIVAL_S
            count, is_on = count + (lasts and not is_on), lasts
    return count


def table(found: list[tuple[Case, bool, Heard]]) -> list[Row]:
    """One row for each kind of case."""
    rows: list[Row] = []
    keys = sorted({(c.whose, fast, c.size_deg, c.creeps_s, c.axis == 2) for c, fast, _ in found})
    for key in keys:
        whose, is_fast, size, creeps, is_heading = key
        those = [h for c, f, h in found if (c.whose, f, c.size_deg, c.creeps_s, c.axis == 2) == key]
        known = [h for h in those if h.is_known]
        said = [h for h in those if h.said_s is not None]
        named = [h.wrong for h in said if h.wrong]
        rows.append(
            {
                "wrong": whose,
                "rate": "10 Hz and above" if is_fast else "slower",
                "angle": "heading" if is_heading else "inclination",
                "deg": size,
                "within s": creeps,
                "cases": len(those),
                "said": len(said),
                "known": len(known),
                "known and said": sum(h.said_s is not None for h in known),
                "after s": median([h.said_s for h in said]) if said else None,
                "named": len(named),
                "named right": named.count(whose),
                "agreed meanwhile": sum(h.agreed for h in those),
                "rival said": sum(h.rival_s is not None for h in those),
            }
        )
    return rows


def main() -> None:
    """Print the tables."""
    options = parser(__doc__)
    options.add_argument("logs", nargs="*", type=Path, default=[DATA])
    given = options.parse_args()
    paths = [
        path
        for each in given.logs
        for path in (sorted(each.rglob("*")) if each.is_dir() else [each])
        if path.suffix in SUFFIXES
    ]
    found: list[tuple[Case, bool, Heard]] = []
    sensors: list[tuple[str, Led]] = []
    right: Counter[str] = Counter()
    healthy_s = 0.0
    healthy: list[Row] = []
    for path in paths[:3] if given.smoke else paths:
        try:
            recording, rate_hz = recorded(path)
        except InputError as error:
            print(error, file=sys.stderr)
            continue
        looks = recording.seen
        if len(looks) < 2:
            continue
        span_s = 1e-6 * (looks[-1].time_us - looks[0].time_us)
        verdicts = {word.value: recording.looks[word] for word in Verdict}
        alarms, rival = len(recording.intervals), rival_alarms(recording)
        healthy.append(
            {"log": path.name, "s": round(span_s), **verdicts, "alarms": alarms, "rival": rival}
        )
        if recording.intervals or span_s < LASTS_S:
            continue  # a fault of its own is there already
        sizes = SIZES_DEG[1:2] if given.smoke else SIZES_DEG
        faults = cases(span_s, sizes, ("autopilot", "ours"))
        found += [(case, rate_hz >= FAST_HZ, heard(recording, case)) for case in faults]
        sensors += [(name, led(path, recording, each)) for name, each in SENSOR_FAULTS.items()]
        right.update({name: right_alarms(recording, each) for name, each in BOTH_RIGHT.items()})
        healthy_s += span_s
    hours = sum(row["s"] for row in healthy) / 3600.0
    total = {
        "log": f"all, {hours:.2f} h",
        **{name: sum(row[name] for row in healthy) for name in ("s", "alarms", "rival")},
    }
    show(
        {
            "as recorded": [*healthy, total],
            "with a fault": table(found),
            "a fault of our IMU": led_table(sensors),
            "both right": [
                {"autopilot's": name, "h": healthy_s / 3600.0, "alarms": right[name]}
                for name in BOTH_RIGHT
            ],
        },
        as_json=given.json,
    )


if __name__ == "__main__":
    main()
