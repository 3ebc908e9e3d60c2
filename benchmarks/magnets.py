"""What do magnets that pass, or that a vehicle starts beside, do to the heading?

    python benchmarks/magnets.py DIR [DIR ...] [--seed 0] [--half even]

On every undisturbed recording magnets of many kinds are put beside the sensor, and the heading is
compared with the truth: while a magnet is there and 20 s more, or from 5 to 35 s after a vehicle
has left the one that it has started beside. ``heading`` and ``alone`` are RMS errors in degrees
with and without the magnet, ``unaware`` the share of the time with an error of more than 10 deg
and three sigmas, ``under sigma`` that with an error under the heading's sigma.
"""

import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from common.filters import Filter, chosen_filters
from common.recordings import Array, Trial, add_folders, chosen_sets
from common.report import MISSING, Row, parser, show
from common.scores import by, errors_deg, mean_of, rms
from common.ways import direction
from scipy.spatial.transform import Rotation

DURATIONS_S = (1.0, 2.5, 4.0, 8.0, 16.0)
STARTS_S = (3.0, 8.0, 20.0)
TURNS_DEG = (30.0, 60.0, 120.0)
SIZES, START_SIZES = (0.3, 0.8, 2.0), (0.2, 0.5, 1.0)  # of the place's field
AFTER_S = 20.0
MOST_ALONE_DEG = 12.0  # a recording that is off by more without any magnet says nothing
LEAST_ROWS = 100
UNAWARE_DEG, UNAWARE_SIGMAS = 10.0, 3.0


class Case(NamedTuple):
    """A recording with a magnet, and the span that counts (s)."""

    kind: str
    trial: Trial
    begin_s: float
    end_s: float


def cases(trial: Trial, rng: np.random.Generator) -> Iterator[Case]:
    """The recording with each magnet, one at a time."""
    attitude, times = held_truth(trial), trial.times_s
    field = attitude.apply(trial.mag_ut)

    def beside(enu: Array) -> Trial:
        return replace(trial, mag_ut=np.ascontiguousarray(attitude.inv().apply(enu)))

    def span(lasts_s: float) -> tuple[float, float]:
        begin_s = rng.uniform(25.0, max(26.0, times[-1] - lasts_s - 25.0))
        return begin_s, begin_s + lasts_s + AFTER_S

    for lasts_s in DURATIONS_S:
        for ramp_s in (1e-6, 0.25 * lasts_s):
            for turn in np.radians(TURNS_DEG) * rng.choice((-1.0, 1.0), len(TURNS_DEG)):
                begin_s, end_s = span(lasts_s)
                near = presence(times, begin_s, lasts_s, ramp_s)
                turned = Rotation.from_euler("z", (turn * near)[:, None]).apply(field)
                yield Case(f"same norm and dip, {lasts_s:g} s", beside(turned), begin_s, end_s)
            for size in SIZES:
                begin_s, end_s = span(lasts_s)
                near = presence(times, begin_s, lasts_s, ramp_s)[:, None]
                magnet = direction(rng) * size * trial.field_ut
                yield Case("any", beside(field + near * magnet), begin_s, end_s)
    for lasts_s in STARTS_S:
        near = presence(times, -10.0, 11.0 + lasts_s, 1.0)[:, None]
        for size in START_SIZES:
            magnet = direction(rng) * size * trial.field_ut
            shown = beside(field + near * magnet)
            yield Case("start beside one", shown, lasts_s + 5.0, lasts_s + 35.0)


def held_truth(trial: Trial) -> Rotation:
    """The true attitudes, held where the markers were out of sight."""
    q = trial.q_enu_sensor
    seen = ~np.isnan(q).any(axis=1)
    rows = np.maximum.accumulate(np.where(seen, np.arange(len(q)), int(np.argmax(seen))))
    return Rotation.from_quat(np.roll(q[rows], -1, axis=1))


def presence(times: Array, begin_s: float, lasts_s: float, ramp_s: float) -> Array:
    """0 to 1: how near the magnet is."""
    rising, falling = (times - begin_s) / ramp_s, (begin_s + lasts_s - times) / ramp_s
    return np.asarray(np.clip(np.minimum(rising, falling), 0.0, 1.0))


def headings(filter_: Filter, trial: Trial) -> tuple[Array, Array | None]:
    """Errors and sigmas of the heading, degrees."""
    q, sigma = filter_(trial).advance(slice(0, None))
    return errors_deg(q, trial.q_enu_sensor)[:, 1], None if sigma is None else sigma[:, 1]


def judge(filter_: Filter, trial: Trial, rng: np.random.Generator) -> Iterator[Row]:
    """The figures of each case on this recording."""
    times = trial.times_s
    alone, _ = headings(filter_, trial)
    for case in cases(trial, rng):
        error, sigma = headings(filter_, case.trial)
        rows = (times >= case.begin_s) & (times < case.end_s) & ~np.isnan(error)
        if rows.sum() < LEAST_ROWS or alone[rows].max() > MOST_ALONE_DEG:
            continue
        row = {"kind": case.kind, "heading": rms(error[rows]), "alone": rms(alone[rows])}
        if sigma is not None:
            e, s = error[rows], sigma[rows]
            row["unaware"] = float(np.mean((e > UNAWARE_DEG) & (e > UNAWARE_SIGMAS * s)))
            row["under sigma"] = float(np.mean(e <= s))
        yield row


def main() -> int:
    made = parser(__doc__)
    add_folders(made)
    made.add_argument("--filters", default="fuzzbee,vqf", help="names, rivals, acausal or gains")
    made.add_argument("--seed", type=int, default=0)
    made.add_argument("--half", choices=("even", "odd"), help="every other recording only")
    options = made.parse_args()
    options.undisturbed = True
    trials = [t for some in chosen_sets(options).values() for t in some if t.has_mag]
    if options.half:
        trials = trials[1 if options.half == "odd" else 0 :: 2]
    table: list[Row] = []
    for name, filter_ in chosen_filters(options.filters):
        if filter_ is None:
            table.append({"filter": name, "kind": MISSING})
            continue
        rngs = [np.random.default_rng([options.seed, k]) for k in range(len(trials))]
        rows = [r for t, rng in zip(trials, rngs, strict=True) for r in judge(filter_, t, rng)]
        for kind, some in by(rows, lambda row: row.pop("kind")).items():
            table.append({"filter": name, "kind": kind, "n": len(some), **mean_of(some)})
    show({"the heading beside magnets, degrees": table}, as_json=options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
