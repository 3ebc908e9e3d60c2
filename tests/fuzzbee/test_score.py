"""The figures of a report are those of the arrays that ``replay`` gives beside it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.events import VehicleId
from drivers.logs import table
from estimator.geometry.metrics import batch_angle_errors
from estimator.geometry.rotations import exp
from estimator.types import ImuSample
from fuzzbee import replay
from fuzzbee.replays import motion
from fuzzbee.replays.score import constant_turn
from fuzzbee.replays.trace import VehicleTrace
from tests.flight import banked_flight
from tests.fuzzbee.recording import DATA, recorded
from tests.fuzzbee.recording import table as written_table
from tests.service.records import ATTITUDE

DOWN, G = (0.0, 0.0, 1.0), 9.80665


def mean(values, rel=1e-12, of=float):
    return pytest.approx(of(np.mean(values)), rel=rel) if len(values) else None


def rms(values):
    return mean(np.square(values), 1e-9, np.sqrt)


def moved(log):
    """Whether each sample of a log is within 1.5 s of motion, computed sample by sample."""
    time_s, gyr, acc = recorded(log)[:3]
    found = []
    for now_s in time_s:
        near = np.abs(time_s - now_s) <= motion.WINDOW_S
        steady = (
            np.linalg.norm(x[near] - np.median(x[near], axis=0), axis=1).max() < limit
            for x, limit in ((gyr, motion.REST_GYR_RAD_S), (acc, motion.REST_ACC_M_S2))
        )
        turns = np.linalg.norm(np.median(gyr[near], axis=0)) > motion.MOST_BIAS_RAD_S
        found.append(not all(steady) or bool(turns))
    return np.array(found)


@pytest.mark.parametrize(
    ("log", "skip_s"),
    [
        ("sitl_copter_takeoff", 5.0),
        ("sub_bluerov", 0.0),
        ("sub_on_its_side", 0.0),
        ("rover_no_magnetometer", 0.0),  # it never has a heading
    ],
)
def test_every_figure_is_that_of_the_samples_that_count(log, skip_s, monkeypatch):
    monkeypatch.setattr(table, "BLOCK", 70)
    path = DATA / f"{log}.tlog"
    flight = replay(path, skip_s=skip_s)
    report, ours = flight.report, flight.attitudes
    assert len(ours) == report.imu.samples == len(flight.error_rad)
    pair = ours.q_ned_frd, flight.reference_q_ned_frd
    assert batch_angle_errors(*pair) == pytest.approx(flight.error_rad, nan_ok=True)
    counted = np.isfinite(flight.error_rad[:, 0]) & (ours.time_s >= skip_s)
    total, heading, inclination = np.degrees(flight.error_rad[counted]).T
    reported = ours.heading_reference[counted] != "none"
    assert report.error_deg.total_rms == rms(total[reported])
    assert report.error_deg.heading_rms == rms(heading[reported])
    assert report.error_deg.inclination_rms == rms(inclination)
    assert report.error_deg.inclination_p95 == pytest.approx(np.percentile(inclination, 95.0))
    upright = inclination <= np.degrees(ours.sigma_inclination_rad[counted])
    pointed = heading <= np.degrees(ours.sigma_heading_rad[counted])
    moving = moved(path)[-len(counted) :][counted]
    assert report.coverage.inclination == mean(upright)
    assert report.coverage.heading == mean(pointed[reported])
    assert report.coverage.inclination_moving == mean(upright[moving])
    assert report.coverage.heading_moving == mean(pointed[reported & moving])
    names, counts = np.unique(ours.heading_reference[counted], return_counts=True)
    assert report.heading_references == dict(zip(names.tolist(), counts.tolist(), strict=True))
    assert report.mean_gain == pytest.approx(np.mean(ours.gain))
    known = np.flatnonzero(np.isfinite(flight.error_rad[:, 0]))
    good = np.flatnonzero(flight.error_rad[:, 0] < np.radians(5.0))
    converged_s = ours.time_s[good[0]] - ours.time_s[known[0]] if reported.any() else None
    assert report.convergence_s == pytest.approx(converged_s)
    assert_constant_turn(report.constant_turn, flight, counted, moving)


def assert_constant_turn(found, flight, counted, moving):
    """SciPy finds the same turn of the body between both verticals, and the same is left."""
    ours, theirs = (
        Rotation.from_quat(q[counted][:, [1, 2, 3, 0]]).inv().apply(DOWN)
        for q in (flight.attitudes.q_ned_frd, flight.reference_q_ned_frd)
    )
    turned = Rotation.align_vectors(theirs, ours)[0].apply(ours)

    def apart_deg(some, others):
        return np.degrees(2.0 * np.arcsin(0.5 * np.linalg.norm(some - others, axis=1)))

    left = apart_deg(turned, theirs)
    assert found.turn_deg == pytest.approx(np.sqrt(np.mean(apart_deg(turned, ours) ** 2)), rel=1e-5)
    assert found.inclination_rms == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-5)
    under = left <= np.degrees(flight.attitudes.sigma_inclination_rad[counted])
    assert found.inclination_coverage == mean(under)
    assert found.inclination_coverage_moving == mean(under[moving])


def test_a_constant_turn_is_reported(printed):
    log = DATA / "sub_bluerov.tlog"
    turn = replay(log).report.constant_turn
    words = " ".join(printed("replay", log).split())
    assert f"{turn.turn_deg:.1f}° of it is a constant turn" in words


BIAS, STEADY = np.radians((1.0, 1.0, 1.0)), np.array((0.0, 0.0, 1.01 * motion.MOST_BIAS_RAD_S))


@pytest.mark.parametrize(
    ("rate", "turn", "push", "moving"),
    [
        (BIAS, slice(0), slice(0), 0),
        (BIAS, slice(20, 21), slice(0), 13),  # a turn, 1.5 s to both sides
        (BIAS, slice(None), slice(0), 40),  # a steady turn
        (STEADY, slice(0), slice(0), 40),  # hardly beyond any bias, to either side
        (-STEADY, slice(0), slice(0), 40),
        (BIAS, slice(0), slice(None, None, 2), 40),  # shaking
    ],
)
def test_when_a_vehicle_moves(rate, turn, push, moving):
    """On its side, both sensors with noise; the gyroscope's leaves its median as it is."""
    rng = np.random.default_rng(1)
    gyr = rate + 0.004 * np.tile([[0.0, 0.0, -1.0], [0.0] * 3, [0.0] * 3, [0.0, 0.0, 1.0]], (10, 1))
    acc = np.array([0.0, 9.8, 0.0]) + 0.05 * rng.standard_normal((40, 3))
    gyr[turn] += 0.2
    acc[push] += 1.0
    columns = {"time_us": np.arange(40) * 250_000, "gyr_rad_s": gyr, "acc_m_s2": acc}
    assert np.count_nonzero(motion.motion_mask(columns)) == moving
    assert motion.motion_mask({name: column[:0] for name, column in columns.items()}).shape == (0,)


def test_a_heading_by_velocity_is_scored_without_a_magnetometer(tmp_path):
    flight = banked_flight(seconds=60.0, rate_hz=50.0)
    velocity = {k: report.velocity_ned_m_s for k, report in flight.reports}
    rows = [
        (*sample.gyr_rad_s, *np.divide(sample.acc_m_s2, G), *velocity.get(k, ("", "", "")), *q)
        for k, (sample, q) in enumerate(zip(flight.samples, flight.truth, strict=True))
    ]
    path = written_table(tmp_path / "flight.csv", 50.0, rows, ("vn", "ve", "vd", *"wxyz"))
    path.with_suffix(".toml").write_text(
        'axes = "frd"\nvelocity = { columns = ["vn", "ve", "vd"] }\n'
        'truth = { columns = ["w", "x", "y", "z"] }'
    )
    report = replay(path).report
    assert report.heading_references["true"] > 1000
    assert report.error_deg.heading_rms < 5.0
    assert report.error_deg.total_rms < 5.0
    assert report.coverage.heading is not None


def test_a_mirror_is_no_turn():
    """The reference rolls to the other side: a reflection would explain all of it."""
    roll, pitch = 0.3 * np.array([(1, 0), (0, 1), (-1, 0), (0, -1)]).T
    columns = {
        "q_ned_frd": exp(np.stack([roll, pitch, 0.0 * roll], axis=1)),
        "reference_q_ned_frd": exp(np.stack([-roll, pitch, 0.0 * roll], axis=1)),
        "sigma_inclination_rad": np.full(4, 0.01),
    }
    found = constant_turn(columns, np.ones(4, bool), np.ones(4, bool))
    # two of four are off by twice 0.3 rad whichever way it turns
    assert found.inclination_rms == pytest.approx(np.degrees(0.6 / np.sqrt(2.0)), rel=0.01)
    assert found.inclination_coverage == 0.5


@pytest.mark.parametrize("norths", ["none true", "true none", "none none"])
def test_a_heading_is_scored_wherever_it_was_known(norths):
    trace, sample = VehicleTrace(VehicleId(1, 1)), ImuSample(0, *((0.0, 0.0, 0.0),) * 3, False)
    for north in norths.split():
        trace.take(0, 0, ATTITUDE._replace(heading_reference=north), sample, False)
    assert trace.has_heading == ("true" in norths)
