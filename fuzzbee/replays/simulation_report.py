"""The paper's experiment over several noise seeds, as ``replay sim:`` reports it."""

from collections.abc import Callable, Sequence
from math import isfinite

import numpy as np

from estimator.geometry.metrics import COST_RATE_HZ, COST_SAMPLES, batch_angle_errors
from estimator.profile import Profile
from fuzzbee.replays.log_report import ImuSummary, Report, VehicleSummary
from fuzzbee.replays.score import CONVERGED_RAD, Coverage, error_summary
from tuning.paper_experiment import ExperimentResult, run_experiment


class SimulationReport(Report, frozen=True):
    """Schema of ``replay sim: --json``: that of a log, and the paper's figures."""

    seeds: tuple[int, int]
    cost: float
    cost_per_seed: list[float]
    steady_state_error: float
    settling_s: float | None


Export = Callable[[Sequence[int], Sequence[ExperimentResult]], None]


def report_simulation(
    profile: Profile,
    seeds: Sequence[int],
    fixed_gain: float | None = None,
    exports: Sequence[Export] = (),
) -> SimulationReport:
    """Run all seeds, and hand them to the exports. Errors in degrees are over all their samples.

    Raises:
        InputError: the profile is not one of raw vectors, or an export cannot be written.
    """
    results = [run_experiment(profile, seed, fixed_gain) for seed in seeds]
    for export in exports:
        export(seeds, results)
    errors = [batch_angle_errors(r.estimates, r.truth) for r in results]
    all_errors = np.concatenate(errors)
    everywhere = np.ones(len(all_errors), np.bool_)
    columns = {"time_us": everywhere, "error_rad": all_errors}
    settling = float(np.median([r.settling_s for r in results]))
    below = [np.flatnonzero(each[:, 0] < CONVERGED_RAD) for each in errors]
    converged = float(np.median([i[0] / COST_RATE_HZ if len(i) else np.inf for i in below]))
    return SimulationReport(
        source="sim:",
        vehicle=VehicleSummary(1, 1, None, None),
        imu=ImuSummary(
            message="RAW_IMU",
            samples=COST_SAMPLES * len(results),
            messages={"RAW_IMU": COST_SAMPLES * len(results)},
            median_rate_hz=COST_RATE_HZ,
            mean_rate_hz=COST_RATE_HZ,
            worst_gap_s=1.0 / COST_RATE_HZ,
            worst_arrival_gap_s=None,
        ),
        duration_s=(COST_SAMPLES - 1) / COST_RATE_HZ,
        reference="sim",
        error_deg=error_summary(columns, everywhere, everywhere),
        coverage=Coverage(),
        peers={},
        convergence_s=converged if isfinite(converged) else None,
        mean_gain=float(np.mean([r.mean_gain for r in results])),
        rejected={},
        wall_s=0.0,
        seeds=(seeds[0], seeds[-1]),
        cost=float(np.mean([r.cost for r in results])),
        cost_per_seed=[r.cost for r in results],
        steady_state_error=float(np.mean([r.steady_state_error for r in results])),
        settling_s=settling if isfinite(settling) else None,
    )
