"""How long is the estimate wrong and sure of it? Motions, streams and faults, with the truth known.

python benchmarks/truth.py [--smoke] [--only WORD ...] [--json] [--jobs 2] [--draw N --seed S]

Every motion of ``tests/truth/motions.py`` with every fault of ``tests/truth/faults.py``, with and
without velocity in the stream, at 50 and 4 Hz, goes as MAVLink frames through decoder and pipeline.
A row a case, worst first:

    time    the longest time wrong and sure: inclination or heading more than 15 deg wrong at a
            sigma of that angle of at most 5 deg, state running, no warning in the status; from
            the beginning of the fault on
    rival   the same time for the same estimator with a flat sigma of 5 deg
    inclination, heading: error RMS (deg), median sigma (deg), share of errors under sigma (0.68 is
            honest), share beyond three sigma
    warned  what the status warned of, and when (in brackets: what it refused)

The last lines count the cases that are wrong and sure for more than 3 s, by kind of fault.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np

from tests.truth.faults import HEALTHY, KINDS, Fault, Place, drawn_fault, listed_faults
from tests.truth.motions import MOTIONS
from tests.truth.run import Angle, Case, Verdict, judge

LASTING_S = 3.0
MOST_BEYOND = 0.1  # share of errors beyond three sigma that a healthy case may have
RATES_HZ = (50.0, 4.0)
DRAWN_RATES_HZ = (50.0, 25.0, 10.0, 4.0)
DRAWN_SPREAD = 0.5
PLACES = {
    "zurich": Place(),
    "canberra": Place(-35.363, 149.165, 584.0),
    "seattle": Place(47.6, -122.3, 50.0),
    "singapore": Place(1.35, 103.8, 20.0),
    "tromso": Place(69.65, 18.96, 10.0),
}
SMOKE = ("slalom 30", "still", "climb and turn")
SMOKE_FAULTS = (HEALTHY, Fault("gyroscope offset", 2, 0.5), Fault("clock pace", 0, 1e-3))

Row = tuple[Case, Verdict]


def listed_cases(seeds: Sequence[int], place: Place) -> Iterator[Case]:
    """The product, and gyroscopes at fault beside a message that is not."""
    for seed in seeds:
        for rate_hz in RATES_HZ:
            for motion in MOTIONS:
                for fault in listed_faults():
                    yield Case(motion, fault, True, rate_hz, seed=seed, place=place)
                    if not fault.kind.startswith("velocity"):
                        yield Case(motion, fault, False, rate_hz, seed=seed, place=place)
        for motion in ("hover", "slalom 20", "coasting turn", "hand"):
            for fault in (Fault("gyroscope stuck", 2), Fault("gyroscope offset", 0, 0.5)):
                for beside in ("attitude", "imu2"):
                    for with_velocity in (True, False):
                        yield Case(motion, fault, with_velocity, 50.0, beside, seed, place=place)


def drawn_cases(count: int, seed: int, place: Place | None) -> Iterator[Case]:
    """Cases at random: motions of other sizes, other faults, axes, times, rates and places."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        motion, fault = str(rng.choice(list(MOTIONS))), drawn_fault(rng)
        with_velocity = bool(rng.random() < 0.5) or fault.kind.startswith("velocity")
        where = PLACES[str(rng.choice(list(PLACES)))]
        yield Case(
            motion,
            fault,
            with_velocity,
            float(rng.choice(DRAWN_RATES_HZ)),
            seed=int(rng.integers(1_000_000)),
            spread=DRAWN_SPREAD,
            place=where if place is None else place,
        )


def judge_all(cases: Sequence[Case], jobs: int) -> list[Row]:
    """All verdicts, worst first."""
    with ProcessPoolExecutor(jobs) as pool:
        verdicts = list(pool.map(judge, cases, chunksize=8))
    rows = list(zip(cases, verdicts, strict=True))
    return sorted(rows, key=lambda row: (row[1].wrong_and_sure_s, row[1].rival_s), reverse=True)


def line(case: Case, v: Verdict) -> str:
    """A row of the table."""
    words = [f"{word} {at:.0f}" for word, at in v.warnings.items()]
    words += [f"({word} {at:.0f})" for word, at in v.rejected.items()]
    running = "" if v.running > 0.99 else f" running {v.running:.2f}"
    return (
        f"{case!s:64} {v.wrong_and_sure_s:5.1f} s at {v.since_s:4.1f} rival {v.rival_s:5.1f} "
        f"| {_angle(v.inclination)} | {_angle(v.heading)} | {', '.join(words) or '-'}{running}"
    )


def _angle(a: Angle) -> str:
    return f"{a.rms_deg:5.1f} sigma {a.sigma_deg:5.1f} {a.under_sigma:.2f} {a.beyond_three:.2f}"


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """How many cases are wrong and sure for too long, by kind of fault."""
    by_fault = {}
    for kind in ("none", *KINDS):
        own = [v for case, v in rows if case.fault.kind == kind]
        if own:
            by_fault[kind] = {
                "cases": len(own),
                "wrong_and_sure": sum(v.wrong_and_sure_s > LASTING_S for v in own),
                "rival": sum(v.rival_s > LASTING_S for v in own),
                "longest_s": round(max(v.wrong_and_sure_s for v in own), 1),
            }
    healthy = [v for case, v in rows if case.fault.kind == "none"]
    beyond = [np.fmax(v.inclination.beyond_three, v.heading.beyond_three) for v in healthy]
    return {
        "cases": len(rows),
        "wrong_and_sure": sum(of["wrong_and_sure"] for of in by_fault.values()),
        "rival": sum(of["rival"] for of in by_fault.values()),
        "healthy_beyond_three_sigma": sum(bool(share > MOST_BEYOND) for share in beyond),
        "by_fault": by_fault,
    }


def report(rows: Sequence[Row], most: int) -> None:
    """The table and the counts."""
    print(f"{'case':64} wrong and sure        rival | inclination | heading | warned (refused)")
    for case, verdict in rows[:most]:
        print(line(case, verdict))
    found = summary(rows)
    print(f"\nwrong and sure for more than {LASTING_S:g} s:")
    for kind, of in (*found["by_fault"].items(), ("all", found)):
        longest = f", longest {of['longest_s']:.1f} s" if "longest_s" in of else ""
        count = f"{of['wrong_and_sure']:4} of {of['cases']:4} (rival {of['rival']:4})"
        print(f"  {kind:24} {count}{longest}")
    beyond = found["healthy_beyond_three_sigma"]
    print(f"without a fault, more than {MOST_BEYOND:.0%} of errors beyond three sigma: {beyond}")


def as_json(rows: Sequence[Row]) -> dict[str, Any]:
    """All that the table says."""
    found = [{"case": str(case), **_named(case), **_named(verdict)} for case, verdict in rows]
    return {**summary(rows), "rows": found}


def _named(values: Any) -> Any:
    """A named tuple and those within as dictionaries; a number that is none as None."""
    if hasattr(values, "_asdict"):
        return {name: _named(value) for name, value in values._asdict().items()}
    return None if values != values else values  # noqa: PLR0124 - nan is not itself


def _place(text: str) -> Place:
    if text in PLACES:
        return PLACES[text]
    return Place(*map(float, text.split(",")))


def _seeds(text: str) -> range:
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1)


def main() -> int:
    parser = argparse.ArgumentParser(
        description="How long the estimate is wrong and sure of it, with the truth known.",
        epilog='example: python benchmarks/truth.py --only slalom "no velocity" --worst 20',
    )
    parser.add_argument("--smoke", action="store_true", help="a few cases, in seconds")
    parser.add_argument(
        "--only", nargs="+", default=[], metavar="WORD", help="all in a case's name"
    )
    parser.add_argument("--worst", type=int, default=1_000_000, metavar="N", help="so many rows")
    parser.add_argument("--json", action="store_true", help="one object instead of the table")
    parser.add_argument("--seeds", type=_seeds, default=range(1), metavar="A-B")
    parser.add_argument(
        "--draw", type=int, default=0, metavar="N", help="N cases at random instead"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the draw")
    parser.add_argument("--place", type=_place, help="LAT,LON,ALT or one of " + ", ".join(PLACES))
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    if args.draw:
        cases = list(drawn_cases(args.draw, args.seed, args.place))
    else:
        cases = list(listed_cases(args.seeds, args.place or Place()))
    if args.smoke:
        slow = [case for case in cases if case.rate_hz == min(RATES_HZ)]
        cases = [case for case in slow if case.motion in SMOKE and case.fault in SMOKE_FAULTS]
    cases = [case for case in cases if all(word in str(case) for word in args.only)]
    if not cases:
        print("no such case", file=sys.stderr)
        return 2
    rows = judge_all(cases, args.jobs)
    if args.json:
        print(json.dumps(as_json(rows)))
    else:
        report(rows, args.worst)
    return 0


if __name__ == "__main__":
    sys.exit(main())
