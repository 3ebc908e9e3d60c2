"""What does a fault in mid-flight do, and does sigma know?

    python benchmarks/faults.py [--seeds 300] [--skip-unaided]

Simulated flights of a plane, a copter and a rover (flying/recorder.py); after 150 s one thing goes
wrong. RMS errors of inclination and heading in degrees, and the shares of them under sigma, from 1
to 5 s and from 5 to 20 s after the fault, means over the flights. ``unaided`` is the same estimator
without velocity.
"""

import sys
from collections.abc import Callable
from math import radians
from typing import NamedTuple

from common.report import Row, parser, seeds, show
from common.scores import covered, mean_of, rms
from flying.cases import DURATION_S, recorded
from flying.replayed import UNAIDED, ChangeImu, ChangeVelocity, Events, changed, fly

from estimator.estimator import Estimator
from estimator.geometry.quaternion import add, exp
from estimator.reasons import Reason
from estimator.types import ImuSample, Quaternion, Vec3, VelocitySample

VEHICLES = ("plane", "copter", "rover")
FAULT_S, SMOKE_FAULT_S = 150.0, 60.0
SPANS_S = ((1.0, 5.0), (5.0, 20.0))


class Fault(NamedTuple):
    """What becomes of samples and of velocities, given s since it began."""

    imu: ChangeImu = lambda _, sample: sample
    velocity: ChangeVelocity = lambda _, sample, _message: sample
    turn: Quaternion | None = None  # that the gyroscope does not feel


def more(field: str, by: Vec3) -> ChangeImu:
    """A step of one sensor's readings."""
    return lambda _, s: s._replace(**{field: add(getattr(s, field), by)})


def wrong_velocity(north_m_s: Callable[[float], float]) -> ChangeVelocity:
    """Every source says so much more to the north."""

    def change(t: float, s: VelocitySample, _: str) -> VelocitySample:
        return s._replace(velocity_ned_m_s=add(s.velocity_ned_m_s, (north_m_s(t), 0.0, 0.0)))

    return change


FAULTS = {
    "none": Fault(),
    "turned unfelt, 20 deg about down": Fault(turn=exp((0.0, 0.0, radians(20.0)))),
    "turned unfelt, 60 deg": Fault(turn=exp((0.6, 0.6, 0.6))),
    "gyroscope, 0.02 rad/s a component": Fault(imu=more("gyr_rad_s", (0.02, -0.02, 0.02))),
    "accelerometer, 0.5 m/s^2 on two": Fault(imu=more("acc_m_s2", (0.5, -0.5, 0.0))),
    "magnet, 60 mGauss": Fault(imu=more("mag_gauss", (0.036, 0.038, -0.029))),
    "magnet, 200 mGauss": Fault(imu=more("mag_gauss", (0.12, 0.128, -0.096))),
    "velocity, 4 m/s from then on": Fault(velocity=wrong_velocity(lambda _: 4.0)),
    "velocity, 8 m/s for 5 s": Fault(velocity=wrong_velocity(lambda t: 8.0 * (t < 5.0))),
    "velocity, 0.3 m/s^2 for 20 s": Fault(velocity=wrong_velocity(lambda t: 0.3 * min(t, 20.0))),
}


class TurnedEstimator(Estimator):
    """Turned once without telling the gyroscope."""

    turn_at_s: float
    unfelt: Quaternion | None = None
    first_us: int | None = None

    def update(self, sample: ImuSample) -> Reason | None:
        """See :class:`Estimator`."""
        reason = super().update(sample)
        self.first_us = sample.time_us if self.first_us is None else self.first_us
        if self.unfelt is not None and sample.time_us >= self.first_us + 1e6 * self.turn_at_s:
            self.turn(self.unfelt)
            self.unfelt = None
        return reason


def after(events: Events, fault: Fault, at_s: float, *, aided: bool) -> Row:
    """Errors and coverage behind the fault."""

    def new_estimator(profile):
        made = TurnedEstimator(profile)
        made.turn_at_s, made.unfelt = at_s, fault.turn
        return made

    broken = changed(
        events,
        lambda t, s: fault.imu(t - at_s, s) if t >= at_s else s,
        lambda t, s, name: fault.velocity(t - at_s, s, name) if t >= at_s else s,
    )
    flown = fly(broken, {} if aided else UNAIDED, new_estimator)
    found: Row = {}
    for first, last in SPANS_S:
        rows = flown.known & (flown.time_s >= at_s + first) & (flown.time_s < at_s + last)
        errors = flown.errors_deg[rows]
        _, heading, inclination = rms(errors)
        found[f"inclination, heading {first:g}..{last:g} s"] = [inclination, heading]
        found[f"under sigma {first:g}..{last:g} s"] = covered(errors, flown.sigma_deg[rows])
    return found


def main() -> int:
    made = parser(__doc__)
    made.add_argument("--seeds", type=seeds, default=range(300, 301), metavar="A-B")
    made.add_argument("--skip-unaided", action="store_true")
    options = made.parse_args()
    at_s, faults, vehicles, length_s = FAULT_S, FAULTS, VEHICLES, DURATION_S
    if options.smoke:
        at_s, vehicles, length_s = SMOKE_FAULT_S, VEHICLES[-1:], SMOKE_FAULT_S + 25.0
        faults = {name: FAULTS[name] for name in list(FAULTS)[:2]}
    flights = [
        recorded("sound", vehicle, seed, length_s).events
        for vehicle in vehicles
        for seed in options.seeds
    ]
    table: list[Row] = []
    for name, fault in faults.items():
        for kind in ("aided",) if options.skip_unaided else ("aided", "unaided"):
            found = [after(e, fault, at_s, aided=kind == "aided") for e in flights]
            table.append({"fault": name, "estimate": kind, **mean_of(found)})
    show({f"means of {len(flights)} flights, degrees": table}, as_json=options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
