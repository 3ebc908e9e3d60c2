"""How accurate is the attitude on simulated flights, with velocity and without?

    python benchmarks/flights.py [--seeds 100-102] [--cases sound,compass]

Planes, copters, quadplanes and rovers. Each flight is written as a telemetry log with what real
ones have (flying/recorder.py) and replayed through decoder and service. Nothing is shared with the
estimator but quaternion algebra and the field's model, so it says how the aiding does on flights it
was not made on. Degrees RMS from 40 s on; shares of errors of inclination and heading under sigma,
in all and in the worst 20 s; ``accelerometer`` is the inclination by the accelerometer alone,
``unaided`` the total without velocity. Where the vehicle's clock stalls, ``live`` is the largest
error (99th percentile) of what is published at ticks meanwhile.
"""

import sys

import numpy as np
from common.report import Row, names, parser, seeds, show
from flying.cases import CASES, DURATION_S, SKIP_S, Recorded, recorded
from flying.motions import FINE_HZ
from flying.recorder import START_UNIX_US
from flying.replayed import UNAIDED, fly, score

from drivers.events import Imu
from estimator.geometry.metrics import batch_angle_errors
from estimator.profile import load_profile
from service.pipeline import Pipeline
from service.records import AttitudeRecord, Published

TICK_US = 20_000
SMOKE_S = 85.0


def live_error_deg(of: Recorded) -> str:
    """Of the attitudes published at ticks: the largest error, and the 99th percentile."""
    pipeline, errors = Pipeline(load_profile("imu")), []
    tick_us = START_UNIX_US + int(SKIP_S * 1e6)
    for event in of.events:
        while isinstance(event, Imu) and event.arrival_us > tick_us:
            t = 1e-6 * (tick_us - START_UNIX_US)
            for stall in of.stalls:
                t = max(min(t, stall), t - of.flight.link.stalls_s)
            truth = tuple(of.motion.attitude[min(round(t * FINE_HZ), len(of.motion.attitude) - 1)])
            errors += [
                (output.record.q_ned_frd, truth)
                for output in pipeline.tick(tick_us)
                if isinstance(output, Published) and isinstance(output.record, AttitudeRecord)
            ]
            tick_us += TICK_US
        pipeline.handle(event)
    published, true = (np.array(each) for each in zip(*errors, strict=True))
    total = np.degrees(batch_angle_errors(published, true)[:, 0])
    return f"{total.max():.1f} ({np.percentile(total, 99.0):.1f})"


def row(case: str, motion: str, seed: int, duration_s: float) -> Row:
    """One flight."""
    of = recorded(case, motion, seed, duration_s)
    found = {"case": case, "motion": motion, "seed": seed, **score(fly(of.events), SKIP_S)}
    found["unaided"] = score(fly(of.events, UNAIDED), SKIP_S)["total"]
    if len(of.stalls):
        found["live"] = live_error_deg(of)
    return found


def main() -> int:
    made = parser(__doc__)
    made.add_argument("--seeds", type=seeds, default=range(100, 103), metavar="A-B")
    made.add_argument("--cases", default=",".join(CASES), help="names, with commas between them")
    options = made.parse_args()
    cases = [(c, motion) for c in names(CASES, options.cases) for motion in CASES[c].motions]
    if options.smoke:
        cases, options.seeds = [("stalls", "copter")], options.seeds[:1]
    length_s = SMOKE_S if options.smoke else DURATION_S
    rows = [row(case, motion, seed, length_s) for case, motion in cases for seed in options.seeds]
    show({"simulated flights, degrees": rows}, as_json=options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
