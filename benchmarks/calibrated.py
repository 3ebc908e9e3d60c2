"""What does a calibration win, of sensors whose errors are added, and of recordings as they are?

    python benchmarks/calibrated.py DIR [DIR ...] [--seeds 1-3] [--by others|half]
    python benchmarks/calibrated.py --by flights|bench [--seeds 1-3]

Every recording gets the constant errors of one made-up sensor a seed: scales and crossed axes of
0.5, 1 and 2 % (gyroscope, accelerometer, magnetometer), 0.15 m/s^2 of bias, 5 or 20 % of iron.
Constants are fitted on four recordings that turn about all axes and applied to all others, or on a
recording's first half and scored on the rest. A row a folder and kind of errors: the mean over
recordings of total, total with free heading, inclination, and total with a free turn of all sensors
alike (degrees), free of the errors (``clean``), with them, and calibrated, and the worst ratio of
calibrated to clean. Beside it are VQF with and without the same calibration, and a sphere and an
ellipsoid fitted to the field.

``flights`` are those of simulated vehicles, with the errors of ``sim --imu-errors``: one is fitted,
another one scored (total, heading, inclination). ``bench`` fits ``sim --motion bench``: the share
of scales, biases and iron within their sigma of the truth, and of the variance before that is left.
"""

from argparse import Namespace
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from operator import itemgetter

import msgspec
import numpy as np
from common.filters import FRD_OF_SENSOR, PEERS, body_readings, fuzzbee, is_installed, run_whole
from common.recordings import Array, Trial, chosen_sets
from common.report import FOLDERS, Row, Tables, benchmark, names, option, seeds
from common.scores import by, conjugate, errors_deg, mean_of, multiply, rms, score
from common.ways import accelerometer_bias, iron, scales_and_axes
from flying.cases import SKIP_S, recorded, written
from flying.motions import MOTIONS
from flying.replayed import changed, fly, read
from flying.replayed import score as flight_score

from drivers.simulation.simulated_vehicle import SimulatedVehicle, imu_errors
from estimator.calibration import Calibration
from estimator.types import ImuSample
from fuzzbee import Estimator
from fuzzbee.calibration_report import recording as flown_recording
from tuning.calibration.fit import KEYS, fit_sensors
from tuning.calibration.spans import Recording

FITTED_ON = 4  # recordings
SIDES_SEEN = 0.5  # a recording turns about all axes if its field has been so far along each way
FIGURES = ("total", "free", "inclination", "turn free")
FLIGHT_FIGURES = ("total", "heading", "inclination")
FLOWN_APART = 100  # between the seeds of the flight that is fitted and of that which is scored
BENCH_S, BENCH_HZ = 180.0, 50.0
SENSORS, BIASES = ("gyr", "acc", "mag"), ("gyr_bias_rad_s", "acc_bias_m_s2", "mag_offset_gauss")
Rng = np.random.Generator
STRENGTH_UT = 45.0  # the same iron in all recordings of a sensor
ERRORS: dict[str, Callable[[Trial, Rng], Trial]] = {
    "none": lambda trial, _: trial,
    "scales and axes": scales_and_axes,
    "accelerometer's bias": accelerometer_bias,
    "5 % of iron": partial(iron, share=0.05, field_ut=STRENGTH_UT),
    "20 % of iron": partial(iron, share=0.2, field_ut=STRENGTH_UT),
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


def ellipsoidal_field(trial: Trial, fitted_on: list[Trial]) -> Trial:
    """The field as a sphere again, by a linear fit of an ellipsoid: m.A m + b.m = 1."""
    m = np.concatenate([each.mag_ut for each in fitted_on]) / STRENGTH_UT
    x, y, z = m.T
    columns = np.column_stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, 2 * m])
    a, b, c, d, e, f, *rest = np.linalg.lstsq(columns, np.ones(len(m)))[0]
    A = np.array([[a, d, e], [d, b, f], [e, f, c]])
    values, axes = np.linalg.eigh(A)
    if values.min() <= 0.0:  # too few turns for one
        return centred_field(trial, fitted_on)
    centre = -np.linalg.solve(A, rest)
    root = axes * np.sqrt(values / np.exp(np.mean(np.log(values)))) @ axes.T
    return replace(trial, mag_ut=(trial.mag_ut - STRENGTH_UT * centre) @ root)


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


def rows_of(trials: list[Trial], kind: str, seed: int, way: str) -> list[Row]:
    """A row a recording that is scored."""
    rows: list[Row] = []
    for fitted, scored in cases(trials, seed, way):
        wrong = [ERRORS[kind](each, np.random.default_rng(seed)) for each in fitted]
        found = fit_sensors([recording(each) for each in wrong]).found
        for trial in scored:
            bad = ERRORS[kind](trial, np.random.default_rng(seed))
            good = calibrated(bad, found)
            ways = {"clean": trial, "as is": bad, "calibrated": good}
            row: Row = {name: figures(each, "fuzzbee") for name, each in ways.items()}
            for fit, refit in (("sphere", centred_field), ("ellipsoid", ellipsoidal_field)):
                row[fit] = figures(refit(bad, wrong), "fuzzbee") if trial.has_mag else None
            if is_installed("vqf"):
                row["vqf"], row["vqf calibrated"] = (figures(each, "vqf") for each in (bad, good))
            rows.append(row)
    return rows


def figures(trial: Trial, name: str) -> list[float]:
    """Total, free of a constant heading, inclination, free of a constant turn of the sensors."""
    output = run_whole(PEERS.get(name, fuzzbee({})), trial)
    scored = score(trial, *output)
    q, truth = (each[trial.scored] for each in (output.q_enu_sensor, trial.q_enu_sensor))
    turn = multiply(conjugate(q), truth)
    turn = np.mean(turn * np.sign(turn[:, :1]), axis=0)
    scored["turn free"] = rms(errors_deg(multiply(q, turn / np.linalg.norm(turn)), truth))[0]
    return [scored[figure] for figure in FIGURES]


def flight_row(motion: str, seed: int) -> Row:
    """A flight free of errors, with those of a seed, and by the constants of another flight."""
    errors = imu_errors(seed)
    case = "cabin" if motion == "car" else "sound"

    def spoiled(sample: ImuSample) -> ImuSample:
        time_us, *readings, has_mag = sample
        pairs = zip(errors, readings, strict=True)
        wrong = [tuple((M @ read + b * any(read)).tolist()) for (M, b), read in pairs]
        return ImuSample(time_us, *wrong, has_mag)

    with written(case, motion, seed + FLOWN_APART) as path:
        trace = fly(changed(read(path), spoiled)).trace
        found = fit_sensors([flown_recording(trace, None)]).found
    events = recorded(case, motion, seed)
    wrong, row = changed(events, spoiled), Row()
    calibration = {"calibration": msgspec.to_builtins(found)}
    flights = {"clean": (events, {}), "as is": (wrong, {}), "calibrated": (wrong, calibration)}
    for name, (flown, changes) in flights.items():
        scored = flight_score(fly(flown, changes), SKIP_S)
        row[name] = [scored[figure] for figure in FLIGHT_FIGURES]
    return row


def bench_row(seed: int) -> Row:
    """How many constants of a bench recording are within their sigma, without a common turn."""
    vehicle = SimulatedVehicle(seed, BENCH_HZ, "bench", bias=0.0, errors_seed=seed)
    read = [next(vehicle) for _ in range(round(BENCH_S * BENCH_HZ))]
    times_us, gyr, acc, mag, q, *_ = map(np.array, zip(*read, strict=True))
    has_mag, none = np.ones(len(read), np.bool_), np.zeros((0, 3))
    fit = fit_sensors([Recording(1e-6 * times_us, gyr, acc, mag, has_mag, q, none[:, 0], none)])
    truth: dict[str, Array] = {}
    for sensor, bias, (M, b) in zip(SENSORS, BIASES, imu_errors(seed), strict=True):
        inverse = M if sensor == "mag" else np.linalg.inv(M)  # of a compass what it reads
        truth[f"{sensor}_matrix"] = inverse - np.eye(3)
        truth[bias] = b if sensor == "mag" else inverse @ b
    row: Row = {}
    for key, at in KEYS.items():
        scales = slice(None, None, 4 if "matrix" in key else 1)
        wrong = np.abs(fit.x[at] - truth[key].ravel())[scales]
        row[key] = float(np.mean(wrong < np.array(fit.sigma[key])[scales]))
        row[f"{key} left"] = fit.left[key]
    return row


@benchmark(
    *FOLDERS,
    option("--seeds", type=seeds, default=range(1, 2), metavar="A-B"),
    option("--by", choices=("others", "half", "flights", "bench"), default="others"),
    option("--errors", default=",".join(ERRORS), help="names, with commas between them"),
    option("--jobs", type=int, default=2),
)
def main(options: Namespace) -> Tables:
    if options.by == "bench":
        return {"within sigma": [mean_of([bench_row(seed) for seed in options.seeds])]}
    if options.by == "flights":
        each = {motion: [flight_row(motion, seed) for seed in options.seeds] for motion in MOTIONS}
        flown = [{"vehicle": motion, **mean_of(rows)} for motion, rows in each.items()]
        return {", ".join(FLIGHT_FIGURES): flown}
    jobs = [
        ((folder, kind), (trials, kind, seed, options.by))
        for folder, trials in chosen_sets(options).items()
        for kind in (list(ERRORS)[:2] if options.smoke else names(ERRORS, options.errors))
        for seed in options.seeds
    ]
    with ProcessPoolExecutor(options.jobs) as pool:
        found = pool.map(rows_of, *zip(*(job for _, job in jobs), strict=True))
        rows = [(head, row) for (head, _), rows in zip(jobs, found, strict=True) for row in rows]
    shown = []
    for (folder, kind), pairs in by(rows, itemgetter(0)).items():
        group = [row for _, row in pairs]
        worst: Array = np.max([np.divide(x["calibrated"], x["clean"]) for x in group], axis=0)
        shown.append({"folder": folder, "errors": kind, **mean_of(group), "worst": worst.tolist()})
    return {", ".join(FIGURES): shown}
