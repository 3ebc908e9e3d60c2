"""Is a wrong attitude noticed, how soon, who is named, and how often is a right one named?

    python benchmarks/second_opinion.py DIR|LOG...

Every log is replayed once as it is: what is reported then is a false alarm, unless log and
reference really differ. Then the autopilot's attitude is turned by 10, 20 and 45 deg about each
axis of NED, for 40 s from 30 % and 60 % of the log on, at once or within the first 20 s; so is
ours, with its sigma as it was. "known" are the cases in which three sigma and the usual offset
leave room for the difference to be seen.
"""

from argparse import Namespace
from collections.abc import Iterable, Iterator
from itertools import product
from math import radians
from pathlib import Path
from statistics import median
from typing import NamedTuple

from common.report import DATA, Row, Tables, benchmark, each_log, log_files, option
from common.scores import by

from drivers.events import Event, ReferenceAttitude, VehicleId
from drivers.logs.open import open_log
from estimator.geometry.quaternion import exp, multiply, scale
from estimator.profile import load_profile
from estimator.types import Quaternion, Vec3
from fuzzbee.replays.trace import Replay
from service.second_opinion import Look, SecondOpinion, Verdict, differences

BEGIN_SHARES, LASTS_S, CREEPS_S = (0.3, 0.6), 40.0, 20.0
SIZES_DEG = (10.0, 20.0, 45.0)
FAST_HZ = 9.0
AXES_NED = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class Recording(SecondOpinion):
    """Keeps what it was given, to be given again with a fault in it."""

    def __init__(self) -> None:
        super().__init__()
        self.given: list[Look | tuple[int, Vec3]] = []

    def look(self, look: Look) -> None:
        self.given += [*self.velocities, look]
        super().look(look)

    @property
    def span_us(self) -> tuple[int, int]:
        """The times of the first look and the last; equal if there are fewer than two."""
        times_us = [each.time_us for each in self.given if isinstance(each, Look)]
        return (times_us[0], times_us[-1]) if times_us else (0, 0)


class Case(NamedTuple):
    """Who is turned, about which axis of NED, by how much, how fast, and from when on."""

    whose: str
    axis: int
    size_deg: float
    creeps_s: float
    begin_s: float


class Answer(NamedTuple):
    """What was reported of a case, and so long after its beginning."""

    after_s: float | None
    wrong: str
    agreed: bool  # at a time when one was off by all of it, and over 20 deg
    is_known: bool


def recorded(path: Path) -> tuple[Recording, float]:
    """The looks of a log's vehicle with most of them, and the rate (Hz) of its samples."""
    replay = Replay(load_profile("imu"))
    kept: dict[VehicleId, Recording] = {}

    def events() -> Iterable[Event]:
        with open_log(path) as log:
            for event in log:
                if isinstance(event, ReferenceAttitude) and event.vehicle not in kept:
                    vehicle = replay.pipeline.vehicle(event.vehicle)
                    if vehicle is not None:
                        vehicle.comparison = kept[event.vehicle] = Recording()
                yield event

    replay.run(events())
    if not kept:
        return Recording(), 0.0
    address = max(kept, key=lambda each: len(kept[each].given))
    return kept[address], replay.pipeline.vehicle(address).imu.median_rate_hz


def turned(case: Case, after_s: float, q: Quaternion) -> Quaternion:
    """An attitude with the case's fault, so long after its beginning."""
    share = 1.0 if case.creeps_s == 0.0 else min(1.0, after_s / case.creeps_s)
    turn_ned = scale(radians(share * case.size_deg), AXES_NED[case.axis])
    return multiply(exp(turn_ned), q)


def answer(recording: Recording, case: Case) -> Answer:
    """Give it all again, with the fault."""
    opinion, begun_us = SecondOpinion(), recording.span_us[0]
    named_s, wrong, agreed, rooms = None, "", False, []
    for each in recording.given:
        if not isinstance(each, Look):
            opinion.velocities.append(each)
            continue
        after_s = 1e-6 * (each.time_us - begun_us) - case.begin_s
        is_wrong = 0.0 <= after_s <= LASTS_S
        theirs, ours = each.theirs, each.ours
        if is_wrong and case.whose == "autopilot":
            theirs = turned(case, after_s, theirs)
        elif is_wrong:
            ours = ours._replace(q_ned_frd=turned(case, after_s, ours.q_ned_frd))
        opinion.look(each._replace(theirs=theirs, ours=ours))
        seen = opinion.opinion
        if not is_wrong or seen is None:
            continue
        axis = differences(theirs, ours)[case.axis == 2]
        rooms.append(case.size_deg - axis.allowed_deg)
        if seen.verdict is Verdict.DIFFERS:
            named_s = after_s if named_s is None else named_s
            wrong = seen.wrong or wrong
        is_whole = after_s >= case.creeps_s and case.size_deg > 20.0
        agreed = agreed or (is_whole and seen.verdict is Verdict.AGREES)
    return Answer(named_s, wrong, agreed, median(rooms or [-1.0]) > 0.0)


def cases(span_s: float, sizes: Iterable[float]) -> Iterable[Case]:
    """All faults of a log that is so long."""
    for *what, share in product(
        ("autopilot", "ours"), range(3), sizes, (0.0, CREEPS_S), BEGIN_SHARES
    ):
        yield Case(*what, share * span_s)


def table(found: list[tuple[Case, bool, Answer]]) -> Iterator[Row]:
    """One row for each kind of case."""
    kinds = by(found, lambda one: (one[0].whose, one[1], *one[0][2:4], one[0].axis == 2))
    for (whose, is_fast, size, creeps, is_heading), some in sorted(kinds.items()):
        those = [each for *_, each in some]
        reported = [each for each in those if each.after_s is not None]
        named = [each.wrong for each in reported if each.wrong]
        yield {
            "wrong": whose,
            "rate": "10 Hz and above" if is_fast else "slower",
            "angle": "heading" if is_heading else "inclination",
            "deg": size,
            "within s": creeps,
            "cases": len(those),
            "reported": len(reported),
            "known": sum(each.is_known for each in those),
            "known and reported": sum(each.is_known for each in reported),
            "after s": median(each.after_s for each in reported) if reported else None,
            "named": len(named),
            "named right": named.count(whose),
            "agreed meanwhile": sum(each.agreed for each in those),
        }


@benchmark(option("logs", nargs="*", type=Path, default=[DATA]))
def main(options: Namespace) -> Tables:
    paths = log_files(options.logs)
    sizes = SIZES_DEG[1:2] if options.smoke else SIZES_DEG
    found: list[tuple[Case, bool, Answer]] = []
    healthy: list[Row] = []
    for path, (recording, rate_hz) in each_log(paths[:3] if options.smoke else paths, recorded):
        begin_us, end_us = recording.span_us
        if begin_us == end_us:
            continue
        span_s, alarms = 1e-6 * (end_us - begin_us), len(recording.intervals)
        verdicts = {word.value: recording.looks[word] for word in Verdict}
        healthy.append({"log": path.name, "s": round(span_s), **verdicts, "alarms": alarms})
        if alarms or span_s < LASTS_S:
            continue  # a fault of its own is there already
        faults = cases(span_s, sizes)
        found += [(case, rate_hz >= FAST_HZ, answer(recording, case)) for case in faults]
    s, alarms = (sum(row[name] for row in healthy) for name in ("s", "alarms"))
    total = {"log": f"all, {s / 3600.0:.2f} h", "s": s, "alarms": alarms}
    return {"as recorded": [*healthy, total], "with a fault": [*table(found)]}
