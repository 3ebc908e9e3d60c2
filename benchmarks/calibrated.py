"""What does a calibration win, of sensors whose errors are added, and of recordings as they are?

    python benchmarks/calibrated.py DIR [DIR ...] [--seeds 1-3] [--by others|half]

Every recording gets the constant errors of one made-up sensor a seed: scales and crossed axes of
0.5, 1 and 2 % (gyroscope, accelerometer, magnetometer), 0.15 m/s^2 of bias, 5 or 20 % of iron.
Constants are fitted on four recordings that turn about all axes and applied to all others, or on a
recording's first half and scored on the rest. A row a folder and kind of errors: the mean over
recordings of total, total with free heading and inclination (degrees), free of the errors
(``clean``), with them, and calibrated, and the worst ratio of calibrated to clean. Beside it are
VQF with and without the same calibration, and a sphere fitted to the field.
"""

import sys
from argparse import Namespace
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np
from common.filters import FRD_OF_SENSOR, PEERS, body_readings, fuzzbee, is_installed
from common.recordings import Array, Trial, chosen_sets
from common.report import FOLDERS, Row, Tables, benchmark, option, seeds
from common.scores import by, mean_of, score
from common.ways import WAYS, direction

from estimator.calibration import Calibration
from fuzzbee import Estimator
from tuning.calibration.fit import fit_sensors
from tuning.calibration.spans import Recording

FITTED_ON = 4  # recordings
SIDES_SEEN = 0.5  # a recording turns about all axes if its field has been so far along each way
FIGURES = ("total", "free", "inclination")
Rng = np.random.Generator


def by_way(trial: Trial, rng: Rng, way: str) -> Trial:
    return next(WAYS[way](trial, rng))


def iron(trial: Trial, rng: Rng, share: float) -> Trial:
    return replace(trial, mag_ut=trial.mag_ut + direction(rng) * share * STRENGTH_UT)


STRENGTH_UT = 45.0  # the same iron in all recordings of a sensor
ERRORS: dict[str, Callable[[Trial, Rng], Trial]] = {
    "none": lambda trial, _: trial,
    **{way: partial(by_way, way=way) for way in ("scales and axes", "accelerometer's bias")},
    "5 % of iron": partial(iron, share=0.05),
    "20 % of iron": partial(iron, share=0.2),
}


def recording(trial: Trial) -> Recording:
    """As ``calibrate`` takes it; the attitudes to begin with are the estimator's."""
    gyr, acc, mag = body_readings(trial)
    has_mag = np.isfinite(mag).all(axis=1)
    mag = np.where(has_mag[:, None], mag, 0.0)
    estimator = Estimator("imu", trial.rate_hz, compass_calibrated=True)
    q = estimator.update_batch(gyr, acc, mag if has_mag.any() else None).q_ned_frd
    readings = (trial.times_s, gyr, acc, mag, has_mag, q)
    return Recording(*readings, np.zeros(0), np.zeros((0, 3)))


def calibrated(trial: Trial, found: Calibration) -> Trial:
    """The recording without what is wrong with its sensors."""
    columns = found.applied(*(rows.T for rows in body_readings(trial)))
    gyr, acc, mag = (FRD_OF_SENSOR * np.column_stack(each) for each in columns)
    return replace(trial, gyr_rad_s=gyr, acc_m_s2=acc, mag_ut=100.0 * mag)


def centred_field(trial: Trial, fitted_on: list[Trial]) -> Trial:
    """The field less the centre of a sphere, by linear least squares: m^2 = 2 b.m + d."""
    m = np.concatenate([each.mag_ut for each in fitted_on])
    columns = np.column_stack([2.0 * m, np.ones(len(m))])
    centre = np.linalg.lstsq(columns, np.sum(m * m, axis=1), rcond=None)[0][:3]
    return replace(trial, mag_ut=trial.mag_ut - centre)


def turns_all_ways(trial: Trial) -> bool:
    """Whether a recording has turned about all axes."""
    if not trial.has_mag:
        return False
    u = trial.mag_ut / np.linalg.norm(trial.mag_ut, axis=1)[:, None]
    return bool(min(u.max(axis=0).min(), (-u).max(axis=0).min()) > SIDES_SEEN)


def cases(trials: list[Trial], seed: int, way: str) -> Iterator[tuple[list[Trial], list[Trial]]]:
    """What is fitted on, and what is scored."""
    if way == "half":
        for trial in trials:
            middle = len(trial.moving) // 2
            yield [trial.cut(slice(0, middle))], [trial.cut(slice(middle, None))]
        return
    able = [trial for trial in trials if turns_all_ways(trial)] or trials
    chosen = np.random.default_rng(seed).permutation(len(able))[:FITTED_ON]
    fitted = [able[k] for k in chosen]
    yield fitted, [trial for trial in trials if all(trial is not each for each in fitted)] or fitted


def rows_of(folder: str, trials: list[Trial], kind: str, seed: int, way: str) -> list[Row]:
    """A row a recording that is scored."""
    rows: list[Row] = []
    for fitted, scored in cases(trials, seed, way):
        wrong = [ERRORS[kind](each, np.random.default_rng(seed)) for each in fitted]
        found = fit_sensors([recording(each) for each in wrong]).found
        for trial in scored:
            bad = ERRORS[kind](trial, np.random.default_rng(seed))
            good = calibrated(bad, found)
            row: Row = {"folder": folder, "errors": kind}
            for name, each in (("clean", trial), ("as is", bad), ("calibrated", good)):
                row[name] = figures(each, "fuzzbee")
            if trial.has_mag:
                row["sphere"] = figures(centred_field(bad, wrong), "fuzzbee")
            if is_installed("vqf"):
                row["vqf"], row["vqf calibrated"] = (figures(each, "vqf") for each in (bad, good))
            rows.append(row)
    return rows


def figures(trial: Trial, name: str) -> list[float]:
    """Total, free of a constant heading, inclination."""
    run = (PEERS[name] if name in PEERS else fuzzbee({}))(trial)
    scored = score(trial, *run.advance(slice(0, None)))
    return [scored[figure] for figure in FIGURES]


def tables(options: Namespace) -> Tables:
    jobs = [
        (folder, trials, kind, seed, options.by)
        for folder, trials in chosen_sets(options).items()
        for kind in (list(ERRORS)[:2] if options.smoke else ERRORS)
        for seed in options.seeds
    ]
    with ProcessPoolExecutor(options.jobs) as pool:
        rows = [row for rows in pool.map(rows_of, *zip(*jobs, strict=True)) for row in rows]
    shown = []
    for (folder, kind), group in by(rows, lambda row: (row["folder"], row["errors"])).items():
        ratios = [np.divide(row["calibrated"], row["clean"]) for row in group]
        named = [{k: v for k, v in row.items() if k not in ("folder", "errors")} for row in group]
        worst: Array = np.max(ratios, axis=0)
        shown.append({"folder": folder, "errors": kind, **mean_of(named), "worst": worst.tolist()})
    return {", ".join(FIGURES): shown}


main = benchmark(
    __doc__,
    tables,
    *FOLDERS,
    option("--seeds", type=seeds, default=range(1, 2), metavar="A-B"),
    option("--by", choices=("others", "half"), default="others"),
    option("--jobs", type=int, default=2),
)

if __name__ == "__main__":
    sys.exit(main())
