"""How well is the attitude known in aerobatics that a slow stream hardly shows, and how soon after?

    python benchmarks/aerobatics.py [--seeds 100-105] [--rates 2,4]

Planes and copters roll, loop and flip for half a minute, twice, and fly calmly before and after;
with velocity and without, with a magnetometer and without. Each line is over all seeds. While it
lasts: degrees RMS of the error, the median of sigma and the share of errors under it. After the
last turn: seconds until the error has stayed under 10 degrees, at a sigma under 30, for 5 s, median
and the 90th percentile (40: never). First the inclination, then the heading, if there is one.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from changes import NO_FIELD
from common.recordings import Array
from common.report import Row, numbers, parser, seeds, show
from flying.cases import ordinary_flight
from flying.motions import integrate
from flying.recorder import Link, record
from flying.replayed import UNAIDED, Events, Flown, fly, read
from flying.stunts import RATES, STRETCHES_S, aerobat, ends_s

DURATION_S, LATEST_S, STAYS_S = 215.0, 40.0, 5.0
FOUND_DEG, KNOWN_DEG = 10.0, 30.0
WAYS = {
    "velocity": (True, None),
    "velocity, no field": (False, None),
    "no velocity": (True, UNAIDED),
}
ANGLES = {"inclination": (2, 0), "heading": (1, 1)}  # columns of errors and of sigmas


def flight(kind: str, seed: int, rate_hz: float, duration_s: float) -> Events:
    """The events of one flight; sample times scatter by 15 % of their interval."""
    drawn = ordinary_flight(np.random.default_rng(77_000 + seed), kind)
    drawn = drawn._replace(link=Link(period_s=1.0 / rate_hz, jitter=0.15))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.tlog"
        record(path, integrate(aerobat(kind, seed), duration_s), drawn, seed)
        return read(path)


def found_s(since_s: Array, error: Array, sigma: Array) -> float:
    """Seconds after which an angle is known, and stays so."""
    good = (error < FOUND_DEG) & (sigma < KNOWN_DEG)
    for t in since_s[(since_s >= 0.0) & (since_s < LATEST_S)]:
        if np.all(good[(since_s >= t) & (since_s <= t + STAYS_S)]):
            return float(t)
    return LATEST_S


def judged(flown: Flown, kind: str, seed: int, angle: str) -> list[list[float]]:
    """Mean square of the error, sigma, share under it, seconds until it is found: by stretch."""
    of_error, of_sigma = ANGLES[angle]
    t = flown.time_s + 0.5  # the first sample's
    error, sigma = flown.errors_deg[:, of_error], flown.sigma_deg[:, of_sigma]
    rows = []
    for (begin_s, _), end_s in zip(STRETCHES_S, ends_s(kind, seed), strict=True):
        during = flown.known & (t >= begin_s) & (t <= end_s)
        if end_s < t[-1]:
            e, s = error[during], sigma[during]
            after = found_s(t - end_s, error, sigma)
            rows.append([np.mean(e**2), np.median(s), np.mean(e <= s), after])
    return rows


def summary(rows: list[list[float]]) -> Row:
    """Of all stretches of all seeds."""
    squares, sigmas, shares, after = np.array(rows).T
    return {
        "while": [float(np.sqrt(np.mean(squares))), float(np.mean(sigmas))],
        "under sigma": float(np.mean(shares)),
        "found s": [float(np.median(after)), float(np.percentile(after, 90.0))],
    }


def row(kind: str, rate_hz: float, way: str, flights: dict[int, Events]) -> Row:
    """All flights of a kind, seen in one way."""
    has_field, profile = WAYS[way]
    found: dict[str, list[list[float]]] = {angle: [] for angle in ANGLES}
    for seed, events in flights.items():
        flown = fly(events if has_field else NO_FIELD(events), profile)
        for angle in ANGLES:
            found[angle] += judged(flown, kind, seed, angle)
    made: Row = {"motion": kind, "Hz": rate_hz, "with": way}
    for angle, judgements in found.items():
        made |= {f"{angle}, {name}": cell for name, cell in summary(judgements).items()}
    return made


def main() -> int:
    made = parser(__doc__)
    made.add_argument("--seeds", type=seeds, default=range(100, 106), metavar="A-B")
    made.add_argument("--rates", type=numbers, default=[2.0, 4.0], metavar="HZ,HZ")
    options = made.parse_args()
    kinds, ways, duration_s = list(RATES), list(WAYS), DURATION_S
    if options.smoke:
        kinds, options.rates, options.seeds = kinds[:1], options.rates[:1], options.seeds[:1]
        ways, duration_s = ways[:1], 110.0
    table = [
        row(kind, rate_hz, way, flights)
        for kind in kinds
        for rate_hz in options.rates
        for flights in [{each: flight(kind, each, rate_hz, duration_s) for each in options.seeds}]
        for way in ways
    ]
    show({"aerobatics in a slow stream, degrees": table}, as_json=options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
