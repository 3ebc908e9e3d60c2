"""Magnets that pass, and starts beside one, on recordings with optical truth.

python benchmarks/broad_magnets.py DIR [DIR ...] [--seed 0] [--half even]

Each DIR as for ``broad.py``. On every undisturbed recording magnets of many kinds are put
beside the sensor, and the heading is compared with the truth: while a magnet is there and
20 s more, or from 5 to 35 s after a vehicle has left the one that it has started beside.
"""

import argparse
import dataclasses
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

import numpy as np
from broad_data import Array, Trial, load_untroubled
from broad_live import run_live
from broad_scores import conjugate, errors_deg, multiply

DURATIONS_S = (1.0, 2.5, 4.0, 8.0, 16.0)
STARTS_S = (3.0, 8.0, 20.0)
TURNS_DEG = (30.0, 60.0, 120.0)
SIZES = (0.3, 0.8, 2.0)  # of the place's field
START_SIZES = (0.2, 0.5, 1.0)
AFTER_S = 20.0
# A recording that is off by more (deg) without any magnet says nothing about them.
MOST_ALONE_DEG = 12.0
LEAST_ROWS = 100
# An error beyond both, in degrees and in sigmas, is one that nobody is told of.
UNAWARE_DEG = 10.0
UNAWARE_SIGMAS = 3.0


class Case(NamedTuple):
    """A recording with a magnet, and the span that counts (s)."""

    kind: str
    trial: Trial
    begin_s: float
    end_s: float


class Figures(NamedTuple):
    """Of one case."""

    rms_deg: float
    alone_deg: float  # without the magnet
    unaware: float  # share of the span
    coverage: float  # likewise, with an error under sigma


def rotate(q: Array, vectors: Array) -> Array:
    """Vectors (N, 3) turned by quaternions (N, 4)."""
    pure = np.concatenate([np.zeros((len(vectors), 1)), vectors], axis=1)
    return np.asarray(multiply(multiply(q, pure), conjugate(q))[:, 1:])


def attitudes(trial: Trial) -> Array:
    """The truth, held where the markers were out of sight."""
    q = trial.q_enu_sensor
    seen = ~np.isnan(q).any(axis=1)
    rows = np.maximum.accumulate(np.where(seen, np.arange(len(q)), int(np.argmax(seen))))
    return np.asarray(q[rows])


def presence(times: Array, begin_s: float, lasts_s: float, ramp_s: float) -> Array:
    """0 to 1: how near the magnet is."""
    rising, falling = (times - begin_s) / ramp_s, (begin_s + lasts_s - times) / ramp_s
    return np.asarray(np.clip(np.minimum(rising, falling), 0.0, 1.0))


def turn_about_up(vectors: Array, angles: Array) -> Array:
    """Norm and dip stay as they are."""
    c, s = np.cos(angles), np.sin(angles)
    x, y, z = vectors.T
    return np.stack([c * x - s * y, s * x + c * y, z], axis=1)


def cases(trial: Trial, rng: np.random.Generator) -> Iterator[Case]:
    """The recording with each magnet, one at a time."""
    q, times = attitudes(trial), np.arange(len(trial.mag_ut)) * trial.dt_s
    field = rotate(q, trial.mag_ut)
    norm = float(np.median(np.linalg.norm(field, axis=1)))

    def with_field(enu: Array) -> Trial:
        return dataclasses.replace(
            trial, mag_ut=np.ascontiguousarray(rotate(np.asarray(conjugate(q)), enu))
        )

    def vector(size: float) -> Array:
        v = rng.normal(size=3)
        return np.asarray(v * size * norm / np.linalg.norm(v))

    for lasts_s in DURATIONS_S:
        for ramp_s in (1e-6, 0.25 * lasts_s):
            for turn in np.radians(TURNS_DEG) * rng.choice((-1.0, 1.0), len(TURNS_DEG)):
                begin_s = rng.uniform(25.0, max(26.0, times[-1] - lasts_s - 25.0))
                near = presence(times, begin_s, lasts_s, ramp_s)
                end_s = begin_s + lasts_s + AFTER_S
                turned = with_field(turn_about_up(field, turn * near))
                yield Case(f"same norm and dip, {lasts_s:g} s", turned, begin_s, end_s)
            for size in SIZES:
                begin_s = rng.uniform(25.0, max(26.0, times[-1] - lasts_s - 25.0))
                near = presence(times, begin_s, lasts_s, ramp_s)[:, None]
                end_s = begin_s + lasts_s + AFTER_S
                yield Case("any", with_field(field + near * vector(size)), begin_s, end_s)
    for lasts_s in STARTS_S:
        near = presence(times, -10.0, 11.0 + lasts_s, 1.0)[:, None]
        for size in START_SIZES:
            beside = with_field(field + near * vector(size))
            yield Case("start beside one", beside, lasts_s + 5.0, lasts_s + 35.0)


def headings(trial: Trial) -> tuple[Array, Array]:
    """Errors and sigmas of the heading, degrees."""
    said = run_live(trial)
    return errors_deg(said.q_enu_sensor, trial.q_enu_sensor)[1], said.sigma_heading_deg


def judge(trial: Trial, rng: np.random.Generator) -> Iterator[tuple[str, Figures]]:
    """The figures of each case on this recording."""
    times = np.arange(len(trial.mag_ut)) * trial.dt_s
    alone, _ = headings(trial)
    for case in cases(trial, rng):
        error, sigma = headings(case.trial)
        rows = (times >= case.begin_s) & (times < case.end_s) & ~np.isnan(error)
        if rows.sum() < LEAST_ROWS or alone[rows].max() > MOST_ALONE_DEG:
            continue
        e, s = error[rows], sigma[rows]
        yield (
            case.kind,
            Figures(
                rms_deg=float(np.sqrt(np.mean(e**2))),
                alone_deg=float(np.sqrt(np.mean(alone[rows] ** 2))),
                unaware=float(np.mean((e > UNAWARE_DEG) & (e > UNAWARE_SIGMAS * s))),
                coverage=float(np.mean(e <= s)),
            ),
        )


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(
        description="Magnets beside the recordings of BROAD and its like.",
        epilog="example: python benchmarks/broad_magnets.py broad/data --half odd",
    )
    parser.add_argument("folders", type=Path, nargs="+", metavar="DIR")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--half", choices=("even", "odd"), help="every other recording only")
    args = parser.parse_args(argv)
    trials = load_untroubled(args.folders)
    if args.half:
        trials = trials[1 if args.half == "odd" else 0 :: 2]
    found: dict[str, list[Figures]] = {}
    for k, trial in enumerate(trials):
        for kind, figures in judge(trial, np.random.default_rng([args.seed, k])):
            found.setdefault(kind, []).append(figures)
    print("kind, cases, heading's RMS in deg (without a magnet), share unaware, coverage")
    for kind, all_of_it in found.items():
        rms, alone, unaware, coverage = (fmean(column) for column in zip(*all_of_it, strict=True))
        n = len(all_of_it)
        print(f"{kind}, {n}, {rms:.2f} ({alone:.2f}), {unaware:.3f}, {coverage:.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
