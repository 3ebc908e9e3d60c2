"""How accurate is the attitude on simulated flights, with velocity and without?

    python benchmarks/flights.py [--seeds 100-102] [--cases sound,compass]

Planes, copters and rovers. Each flight is written as a telemetry log with what real
ones have (flying/recorder.py) and replayed through decoder and service. Nothing is shared with the
estimator but quaternion algebra and the field's model, so it shows the aiding on flights that it
was not made on. Degrees RMS from 40 s on; shares of errors of inclination and heading under sigma,
in all and in the worst 20 s; ``accelerometer`` is the inclination by the accelerometer alone,
``unaided`` the total without velocity.
"""

from argparse import Namespace

from common.report import Row, Tables, benchmark, names, option, seeds
from flying.cases import CASES, DURATION_S, SKIP_S, recorded
from flying.replayed import UNAIDED, fly, score

SMOKE_S = 60.0


def row(case: str, motion: str, seed: int, duration_s: float) -> Row:
    """One flight."""
    of = recorded(case, motion, seed, duration_s)
    found = {"case": case, "motion": motion, "seed": seed, **score(fly(of), SKIP_S)}
    found["unaided"] = score(fly(of, UNAIDED), SKIP_S)["total"]
    return found


@benchmark(
    option("--seeds", type=seeds, default=range(100, 103), metavar="A-B"),
    option("--cases", default=",".join(CASES), help="names, with commas between them"),
)
def main(options: Namespace) -> Tables:
    cases = [(c, motion) for c in names(CASES, options.cases) for motion in CASES[c].motions]
    if options.smoke:
        cases, options.seeds = [("4 Hz", "rover")], options.seeds[:1]
    length_s = SMOKE_S if options.smoke else DURATION_S
    rows = [row(case, motion, seed, length_s) for case, motion in cases for seed in options.seeds]
    return {"simulated flights, degrees": rows}
