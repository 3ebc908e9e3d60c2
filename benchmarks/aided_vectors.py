"""The filter on measured vectors in aided flight, beside the one that follows the aiding.

In aided flight the paper's filter is given gravity and north as the aiding's attitude sees them.
Here it is given measured vectors instead, offline, on the same flights: the specific force less
the acceleration that velocity shows (of the aiding's velocity, or of raw reports, over a second),
and the field free of the learnt hard iron, each with several gains; and a blend of the better of
them with the follower. The gyroscope's bias is the aiding's for all.

``--faults`` breaks the flights after 150 s and compares sigma with and without what measured
vectors say against the attitude (estimator/aiding/witness.py).

example: python benchmarks/aided_vectors.py flight.tlog --seeds 300-301 --faults
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from aided_faults import FAULTS, break_flight, coverage
from aided_recording import AidedRecording, record_aided
from flight_motions import MOTIONS
from flight_recorder import record
from flights import CASES, SKIP_S, ordinary_flight
from numpy.typing import NDArray
from real_logs import log_files

from drivers.events import Event, ReferenceAttitude
from drivers.logs.open import open_log
from estimator.compilation.compiled import compiled
from estimator.filter.kernel import correct, integrate_rate
from estimator.filter.types import FilterParams, FilterState, Vectors, initial_state
from estimator.geometry.metrics import batch_angle_errors
from estimator.geometry.quaternion import (
    conjugate,
    exp,
    log,
    multiply,
    rotate,
    rotate_inverse,
    scale,
)
from estimator.live.settings import settings_of
from estimator.profile import load_profile
from estimator.types import STANDARD_GRAVITY_M_S2, Vec3

Floats = NDArray[np.float64]

FLIGHTS = (
    ("sound", "plane"),
    ("sound", "copter"),
    ("sound", "rover"),
    ("noisy", "copter"),
    ("compass", "plane"),
    ("satellites", "copter"),
    ("4 Hz", "plane"),
    ("4 Hz", "copter"),
)
BROKEN = (("sound", "plane"), ("sound", "copter"), ("sound", "rover"))
GAINS: tuple[float | str, ...] = (0.2, 1.0, 3.5, 20.0, "fuzzy", "noise")
WINDOW_S = 1.0
BLEND = 0.3


class Directions(NamedTuple):
    """Measured (FRD) and expected (NED) unit vectors (N, 3) with confidences (N,)."""

    frd: Floats
    ned: Floats
    share: Floats


def turn_rows(function: Callable[[Any, Any], Vec3], q: Floats, v: Floats) -> Floats:
    """A rotation of each row of v by the quaternion of that row."""
    rows = zip(q.tolist(), v.tolist(), strict=True)
    return np.array([function(tuple(a), tuple(b)) for a, b in rows])


def unit_rows(v: Floats) -> Floats:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-12))


def by_reports(of: AidedRecording) -> Directions:
    """The force of the last window between two reports, as the witness has it."""
    c = of.columns
    frd = turn_rows(rotate_inverse, c["q_g_frd"], c["force_g"])
    return Directions(frd, c["force_ned"], c["force_share"])


def by_aiding(of: AidedRecording) -> Directions:
    """The force over ``WINDOW_S`` against the change of the aiding's own velocity."""
    c, t = of.columns, of.time_s
    force = turn_rows(rotate, c["q_g_frd"], c["acc"])
    pushed = np.zeros_like(force)
    pushed[1:] = np.cumsum(0.5 * np.diff(t)[:, None] * (force[1:] + force[:-1]), axis=0)
    first = np.minimum(
        np.searchsorted(t, t - WINDOW_S - 1e-4), np.maximum(np.arange(len(t)) - 1, 0)
    )
    time_s = t - t[first]
    change = c["velocity"] - c["velocity"][first]
    change[:, 2] -= STANDARD_GRAVITY_M_S2 * time_s
    is_whole = np.cumsum(1.0 - c["aided"])  # no unaided sample in between
    known = (is_whole == is_whole[first]) & (time_s > 0.0) & (time_s < 3.0 * WINDOW_S)
    frd = turn_rows(rotate_inverse, c["q_g_frd"], unit_rows(pushed - pushed[first]))
    return Directions(frd, unit_rows(change), known.astype(float))


def by_field(of: AidedRecording) -> Directions:
    """The field free of hard iron, held between its samples."""
    c = of.columns
    frd = turn_rows(rotate_inverse, c["q_g_frd"], c["field_g"])
    return Directions(frd, c["field_ned"], c["field_share"])


@compiled
def _filter(
    params: FilterParams,
    blank: FilterState,
    columns: tuple[Floats, Floats, Floats, Floats, Floats],
    field: tuple[Floats, Floats, Floats],
    force: tuple[Floats, Floats, Floats],
) -> Floats:
    aided, follower, rate, bias, dt = columns
    v1, u1, s1 = field
    v2, u2, s2 = force
    out = follower.copy()
    state = blank
    for k in range(len(dt)):
        if aided[k] == 0.0 or k == 0 or aided[k - 1] == 0.0:
            q = (follower[k, 0], follower[k, 1], follower[k, 2], follower[k, 3])
            state = _at(blank, q)
            continue
        b = (bias[k, 0], bias[k, 1], bias[k, 2])
        state = integrate_rate(state, (rate[k, 0], rate[k, 1], rate[k, 2]), dt[k], b)
        vectors = Vectors(
            v1_frd=(v1[k, 0], v1[k, 1], v1[k, 2]),
            v1_ned=(u1[k, 0], u1[k, 1], u1[k, 2]),
            s1=s1[k],
            v2_frd=(v2[k, 0], v2[k, 1], v2[k, 2]),
            v2_ned=(u2[k, 0], u2[k, 1], u2[k, 2]),
            s2=s2[k],
            s3=1.0,
        )
        if s1[k] + s2[k] > 0.0:
            state = correct(params, state, vectors, dt[k])
        for i in range(4):
            out[k, i] = state.q_ned_frd[i]
    return out


@compiled
def _at(blank: FilterState, q: tuple[float, float, float, float]) -> FilterState:
    return FilterState(
        q_ned_frd=q,
        gyr_bias_rad_s=blank.gyr_bias_rad_s,
        error=0.0,
        error_rate_1_s=0.0,
        gain=blank.gain,
        has_error=False,
        rate_rad_s=blank.rate_rad_s,
        noise=blank.noise,
        decay=blank.decay,
    )


def filter_params(gain: float | str) -> FilterParams:
    """The paper's memberships, the adaptive gain or a number; the bias is the aiding's."""
    if isinstance(gain, str):
        named = settings_of(load_profile("paper" if gain == "fuzzy" else "adaptive")).filter
        return named._replace(gamma=0.0, euler_step_max_s=0.0)
    return settings_of(load_profile("imu"), fixed_gain=gain).filter


def filtered(of: AidedRecording, gain: float | str, field: Directions, force: Directions) -> Floats:
    """Attitudes (N, 4) of the filter with this gain."""
    c = of.columns
    columns = (c["aided"], c["follower"], c["rate"], c["bias"], c["dt_s"])
    blank = initial_state()
    return _filter(filter_params(gain), blank, columns, tuple(field), tuple(force))


def blended(some: Floats, others: Floats, share: float) -> Floats:
    """From some attitudes towards others by this share of the turn between them."""
    return np.array(
        [
            multiply(p, exp(scale(share, log(multiply(conjugate(p), q)))))
            for p, q in zip(map(tuple, some.tolist()), map(tuple, others.tolist()), strict=True)
        ]
    )


def rms_deg(of: AidedRecording, q: Floats) -> tuple[float, float, float]:
    """Total, heading and inclination, turned on by the age of the samples as it is published."""
    c = of.columns
    ahead = [exp(scale(a, tuple(w))) for a, w in zip(c["lag"], c["rate"].tolist(), strict=True)]
    turned = np.array([multiply(tuple(a), b) for a, b in zip(q.tolist(), ahead, strict=True)])
    counted = of.known & (of.time_s >= SKIP_S) & (c["aided"] > 0.0)
    errors = np.degrees(batch_angle_errors(turned[counted], of.truth[counted]))
    total, heading, inclination = np.sqrt(np.mean(errors**2, axis=0)).tolist()
    return total, heading, inclination


def rivals(of: AidedRecording) -> dict[str, tuple[float, float, float]]:
    """Every way of giving the filter its vectors, scored."""
    follower, field = of.columns["follower"], by_field(of)
    scores = {"follower": rms_deg(of, follower)}
    for name, force in (("aiding's velocity", by_aiding(of)), ("reports", by_reports(of))):
        for gain in GAINS:
            scores[f"{name}, {gain}"] = rms_deg(of, q := filtered(of, gain, field, force))
            if gain == 1.0:
                scores[f"{name}, {gain}, blended"] = rms_deg(of, blended(follower, q, BLEND))
    return scores


def flights(options: argparse.Namespace) -> Iterator[tuple[str, list[Event]]]:
    """The logs that are given, then the simulated flights of the seeds."""
    for path in log_files(options.logs):
        with open_log(path) as recording:
            yield path.name, list(recording)
    if not options.seeds:
        return
    first, _, last = options.seeds.partition("-")
    for case, motion in BROKEN if options.faults else FLIGHTS:
        for seed in range(int(first), int(last or first) + 1):
            yield f"{case}, {motion} {seed}", simulated_events(case, motion, seed)


def simulated_events(case: str, motion: str, seed: int) -> list[Event]:
    """A flight of benchmarks/flights.py."""
    rng = np.random.default_rng(77_000 + seed)
    flight = CASES[case].change(ordinary_flight(rng, motion), rng)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.tlog"
        record(path, MOTIONS[motion](seed), flight, seed)
        with open_log(path) as recording:
            return list(recording)


def print_rivals(results: list[dict[str, Any]]) -> None:
    """Ratios to the follower, geometric means over all flights."""
    for name in results[0]["rivals"]:
        ratios = np.array([[*r["rivals"][name]] for r in results])
        ratios /= np.array([[*r["rivals"]["follower"]] for r in results])
        means = np.exp(np.mean(np.log(ratios), axis=0))
        worst = ratios[:, 0].max()
        print(
            f"{name:36s} total {means[0]:5.2f} heading {means[1]:5.2f} inclination "
            f"{means[2]:5.2f} of the follower's, total at worst {worst:5.2f}"
        )


def print_faults(results: list[dict[str, Any]]) -> None:
    """Means over the flights, a line a fault and span."""
    for fault in results[0]["faults"]:
        for k, span in enumerate(results[0]["faults"][fault]):
            text = f"{fault:34s} {span['from_s']:4.0f}..{span['to_s']:3.0f} s"
            for axis in ("inclination", "heading"):
                of = [r["faults"][fault][k][axis] for r in results]
                mean = {key: float(np.mean([each[key] for each in of])) for key in of[0]}
                text += (
                    f"  {axis} {mean['rms_deg']:6.2f} under sigma "
                    f"{mean['by_covariance']:.2f} > {mean['published']:.2f}"
                )
            e = float(np.median([r["faults"][fault][k]["error"] for r in results]))
            print(f"{text}  e {e:.1e}")


def main() -> int:
    """Replay all, print a table or one object."""
    parser = argparse.ArgumentParser(description="Measured vectors in aided flight.")
    parser.add_argument("logs", nargs="*", type=Path, help="with a simulator's truth")
    parser.add_argument("--seeds", metavar="A-B", help="simulated flights, too")
    parser.add_argument("--faults", action="store_true", help="break them, and look at sigma")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    options = parser.parse_args()
    results = []
    for name, events in flights(options):
        if not any(isinstance(e, ReferenceAttitude) and e.source == "sim" for e in events):
            print(f"{name}: no truth in it, left out", file=sys.stderr)
            continue
        result: dict[str, Any] = {"flight": name}
        if options.faults:
            broken = {fault.name: break_flight(events, fault) for fault in FAULTS}
            result["faults"] = {fault: coverage(of) for fault, of in broken.items()}
        else:
            result["rivals"] = rivals(record_aided(events))
        results.append(result)
        if not options.json:
            print(name, file=sys.stderr, flush=True)
    if not results:
        parser.error("no flight: give logs or --seeds")
    if options.json:
        print(json.dumps({"flights": results}))
    else:
        (print_faults if options.faults else print_rivals)(results)
    return 0


if __name__ == "__main__":
    sys.exit(main())
