"""How long is the estimate wrong and sure of it? Motions, streams and faults, with the truth known.

python benchmarks/truth.py [--smoke] [--only WORD ...] [--json] [--jobs 2] [--draw N --seed S]

Every motion of ``tests/truth/motions.py`` with every fault of ``tests/truth/faults.py``, with and
without velocity in the stream, at 50 and 4 Hz, goes as MAVLink frames through decoder and pipeline.
A row a case, worst first:

    time    the longest time wrong and sure: inclination or heading more than 15 deg wrong at a
            sigma of that angle of at most 5 deg, state running, no warning in the status; from
            the beginning of the fault on
    flat    the same time for the same estimator with a flat sigma of 5 deg
    inclination, heading: error RMS (deg), median sigma (deg), share of errors under sigma (0.68 is
            honest), share beyond three sigma
    warned  what the status warned of, and when (in brackets: what it refused)

The last lines count the cases that are wrong and sure for more than 3 s, by kind of fault, and
those with a tenth of the errors beyond three sigma.
"""

from argparse import Namespace
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import product

import numpy as np
from common.report import Row, Tables, benchmark, option, seeds

from tests.truth.faults import HEALTHY, KINDS, Fault, Place, drawn_fault, listed_faults
from tests.truth.motions import MOTIONS
from tests.truth.run import Case, Verdict, judge

LASTING_S = 3.0
MOST_BEYOND = 0.1  # share of errors beyond three sigma that a case may have
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

BESIDE = (
    ("hover", "slalom 20", "coasting turn", "hand"),
    (Fault("gyroscope stuck", 2), Fault("gyroscope offset", 0, 0.5)),
    ("attitude", "imu2"),
)

Judged = tuple[Case, Verdict]


def listed_cases(seeds: Sequence[int], place: Place) -> Iterator[Case]:
    """The product, and gyroscopes at fault beside a message that is not."""
    for seed in seeds:
        for rate_hz, motion, fault in product(RATES_HZ, MOTIONS, listed_faults()):
            yield Case(motion, fault, True, rate_hz, seed=seed, place=place)
            if not fault.kind.startswith("velocity"):
                yield Case(motion, fault, False, rate_hz, seed=seed, place=place)
        for motion, fault, beside, aided in product(*BESIDE, (True, False)):
            yield Case(motion, fault, aided, 50.0, beside, seed, place=place)


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


def summary(rows: Sequence[Judged]) -> Iterator[Row]:
    """How many cases are wrong and sure for too long, by kind of fault.

    ``beyond`` counts those with many errors of more than three sigma.
    """
    for kind in ("none", *KINDS, "all"):
        own = [v for case, v in rows if kind in (case.fault.kind, "all")]
        beyond = [np.fmax(v.inclination.beyond_three, v.heading.beyond_three) for v in own]
        if own:
            yield {
                "fault": kind,
                "cases": len(own),
                "wrong and sure": sum(v.wrong_and_sure_s > LASTING_S for v in own),
                "flat sigma": sum(v.flat_s > LASTING_S for v in own),
                "longest s": round(max(v.wrong_and_sure_s for v in own), 1),
                "beyond": sum(bool(share > MOST_BEYOND) for share in beyond),
            }


def _place(text: str) -> Place:
    return PLACES[text] if text in PLACES else Place(*map(float, text.split(",")))


def shown(case: Case, v: Verdict) -> Row:
    """A row of the table; what is not known is None."""
    angles = {
        name: [None if value != value else value for value in getattr(v, name)]  # noqa: PLR0124
        for name in ("inclination", "heading")
    }
    warned = [f"{word} {at:.0f}" for word, at in v.warnings.items()]
    warned += [f"({word} {at:.0f})" for word, at in v.rejected.items()]
    times = {"time": v.wrong_and_sure_s, "at": v.since_s, "flat sigma": v.flat_s}
    return {"case": str(case), **times, **angles, "running": v.running, "warned": warned}


@benchmark(
    option("--only", nargs="+", default=[], metavar="WORD", help="all in a case's name"),
    option("--worst", type=int, default=1_000_000, metavar="N", help="so many rows"),
    option("--seeds", type=seeds, default=range(1), metavar="A-B"),
    option("--draw", type=int, default=0, metavar="N", help="N cases at random instead"),
    option("--seed", type=int, default=0, help="of the draw"),
    option("--place", type=_place, help="LAT,LON,ALT or one of " + ", ".join(PLACES)),
    option("--jobs", type=int, default=2),
)
def main(options: Namespace) -> Tables:
    if options.draw:
        cases = list(drawn_cases(options.draw, options.seed, options.place))
    else:
        cases = list(listed_cases(options.seeds, options.place or Place()))
    if options.smoke:
        slow = [case for case in cases if case.rate_hz == min(RATES_HZ)]
        cases = [case for case in slow if case.motion in SMOKE and case.fault in SMOKE_FAULTS]
    cases = [case for case in cases if all(word in str(case) for word in options.only)]
    if not cases:
        raise SystemExit("no such case")
    with ProcessPoolExecutor(options.jobs) as pool:
        rows = [*zip(cases, pool.map(judge, cases, chunksize=8), strict=True)]
    rows.sort(key=lambda row: (row[1].wrong_and_sure_s, row[1].flat_s), reverse=True)
    return {
        "worst first": [shown(*row) for row in rows[: options.worst]],
        f"wrong and sure for more than {LASTING_S:g} s": [*summary(rows)],
    }
