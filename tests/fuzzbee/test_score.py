"""The figures of a report are those of its arrays; a simulator's truth is compared as it goes."""

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import astuple
from scipy.spatial.transform import Rotation

from drivers.events import VehicleId
from drivers.logs import table
from drivers.simulation.fleet import Fleet
from drivers.simulation.flight import MAGNET_S, ROUND_S
from drivers.simulation.simulated_vehicle import SimulatedVehicle
from drivers.simulation.source import SimSource
from estimator.estimator import Estimator
from estimator.geometry.metrics import batch_angle_errors
from estimator.geometry.rotations import exp
from estimator.profile import load_profile
from estimator.types import ImuSample
from fuzzbee import replay
from fuzzbee.app import build_command
from fuzzbee.replays import motion
from fuzzbee.replays.score import constant_turn
from fuzzbee.replays.trace import VehicleTrace
from fuzzbee.sim import SimOptions, _vehicle_options
from fuzzbee.truth_score import ScoredPipeline, TruthScore
from service.records import Message
from tests.fuzzbee.recording import DATA, recorded
from tests.fuzzbee.test_docs import command_lines
from tests.service.flight_rig import Wire
from tests.service.records import ATTITUDE

DOWN = (0.0, 0.0, 1.0)


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
    wanted = [*map(rms, (total[reported], heading[reported], inclination))]
    assert astuple(report.error_deg) == (*wanted, pytest.approx(np.percentile(inclination, 95.0)))
    upright = inclination <= np.degrees(ours.sigma_inclination_rad[counted])
    pointed = heading <= np.degrees(ours.sigma_heading_rad[counted])
    moving = moved(path)[-len(counted) :][counted]
    shares = (upright, pointed[reported], upright[moving], pointed[reported & moving])
    assert astuple(report.coverage) == tuple(map(mean, shares))
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
    gyr = rate + 0.004 * np.tile([[0.0, 0.0, -1.0], [0.0] * 3, [0.0] * 3, [0.0, 0.0, 1.0]], (10, 1))
    acc = np.array([0.0, 9.8, 0.0]) + 0.05 * np.random.default_rng(1).standard_normal((40, 3))
    gyr[turn] += 0.2
    acc[push] += 1.0
    columns = {"time_us": np.arange(40) * 250_000, "gyr_rad_s": gyr, "acc_m_s2": acc}
    assert np.count_nonzero(motion.motion_mask(columns)) == moving
    assert motion.motion_mask({name: column[:0] for name, column in columns.items()}).shape == (0,)


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


# --- a simulator's truth: each documented line of ``fuzzbee sim``, without waiting


def scored():
    pipeline = ScoredPipeline(load_profile("imu"), fits_built_in=True)
    pipeline.scores = {}
    return pipeline


def test_a_flight_is_announced_as_it_goes_and_judged_at_its_end():
    """On a clock that runs as fast as it can."""
    clock_us, lines, pipeline = [0], [], scored()
    times = {"monotonic_us": lambda: clock_us[0], "unix_us": lambda: 0}
    with SimSource(SimulatedVehicle(0, 50.0, "flight"), **times) as source:
        while clock_us[0] < 100e6:
            for event in source.drain(0.0):
                lines += [each.text for each in pipeline.handle(event) if isinstance(each, Message)]
            clock_us[0] += 20_000
    news = [line for line in lines if line.startswith("vehicle 1: now: ")]
    assert [line.split()[-1] for line in news] == ["wrong", "passes", "s"]
    assert not [line for line in lines if "±45°" in line]
    score = pipeline.scores["1"]
    result = score.result()
    assert result["rms_deg"]["total"] == pytest.approx(0.98, rel=0.2)  # with the wrong start
    assert result["worst_deg"] == pytest.approx(15.6, rel=0.2)
    assert result["worst_when"] == "while it was set down by hand"
    assert min(result["coverage"].values()) > 0.8
    assert score.line.startswith("truth: 0.")
    verdict = score.verdict()
    assert "1.0° RMS" in verdict
    assert "while it was set down by hand" in verdict


def parsed(arguments):
    """What a line of the documents asks ``fuzzbee sim`` for."""
    command = build_command(decorated=False).commands["sim"]
    params = command.make_context("sim", arguments).params
    key_file = params.pop("signing_key_file")  # text until the command itself is called
    return SimOptions(**params, signing_key_file=key_file and Path(key_file))


def scored_on_the_wire(options, seconds, begin_s=0.0):
    """The scores of what ``run --truth`` hears of these vehicles between these times."""
    fleet = Fleet(_vehicle_options(options), options.vehicles)
    wire, pipeline, now_us, begin_us = Wire(), scored(), 0.0, 10**15

    def hear(data):
        for event in wire.events(data, begin_us + int(now_us)) if now_us >= 1e6 * begin_s else ():
            pipeline.handle(event)

    while fleet.due_us < 1e6 * seconds:
        now_us = fleet.due_us
        fleet.send_due(now_us, begin_us + int(now_us), hear)
    return pipeline.scores


UDP, TCP = "--to udpout:127.0.0.1:14550", "--to tcpin:127.0.0.1:5760"
# Lines, how long (s), and what was measured of the first vehicle: RMS in all (deg), and the share
# of the errors under sigma of inclination and heading. The paper's begin turned almost round.
SCORED = {
    f"{UDP} --motion flight": (100, 1.06, 0.955, 1.0),
    f"{UDP} --vehicles 3 --rate 50": (60, 10.9, 0.814, 0.945),
    f"{UDP} --motion turn --seconds 122 --seed 0": (122, 9.9, 0.668, 0.712),
    f"{UDP} --signing-key-file fleet.key": (10, 13.7, 0.697, 1.0),
}


def test_every_documented_vehicle_is_scored():
    assert {" ".join(words[1:]) for _, words in command_lines() if words[0] == "sim"} == {*SCORED}


@pytest.mark.parametrize("line", SCORED)
def test_a_documented_vehicle_is_estimated_as_well_as_was_measured(line, tmp_path, monkeypatch):
    key = tmp_path / "fleet.key"
    key.write_text("open sesame")
    key.chmod(0o600)
    monkeypatch.chdir(tmp_path)
    options = parsed(line.split())
    seconds, total, *coverage = SCORED[line]
    scores = scored_on_the_wire(options, seconds)
    assert [*scores] == [str(1 + k) for k in range(options.vehicles)]
    result = scores["1"].result()
    assert result["rms_deg"]["total"] == pytest.approx(total, rel=0.2)
    assert [*result["coverage"].values()] == pytest.approx(coverage, rel=0.2)
    is_noisy = "the paper's signals are that noisy" in scores["1"].verdict()
    assert is_noisy == (options.motion != "flight")


def test_a_magnet_beside_the_paper_s_vectors_turns_the_heading_round():
    """The filter follows it, but the gyroscope contradicts, as in docs/sitl.md: sigma knows."""
    options = parsed(f"{TCP} --motion turn --magnet 10:20".split())
    result = scored_on_the_wire(options, 25)["1"].result()
    assert result["worst_deg"] == pytest.approx(178.0, abs=4.0)
    assert 10.0 < result["worst_s"] < 20.0
    assert result["coverage"]["heading"] == pytest.approx(0.87, rel=0.1)  # by e alone 0.45


def test_a_flight_that_is_received_late_is_placed_by_its_time():
    """The motion is sent ten times a second, behind the first truth that is heard."""
    options = parsed(f"{UDP} --motion flight".split())
    score = scored_on_the_wire(options, 2.0, begin_s=1.025)["1"]
    assert score.result()["worst_s"] < 1.2
    assert score.result()["worst_when"] == "while it was set down by hand"


def test_another_s_simulator_has_no_chapters():
    """Of a motion that nobody knows the worst moment is named, and no reason."""
    score = TruthScore()
    assert (score.verdict(), score.result()) == ("", None)  # without a sample
    score.look(500_000, Estimator(load_profile("imu")).attitude(0), (0.0, 1.0, 0.0, 0.0))
    assert score.verdict().endswith("worst 180.0° at 0.5 s")
    # of the own flight each round is reported
    score, truth = TruthScore("flight"), (1.0, 0.0, 0.0, 0.0)
    times_s = (MAGNET_S[0], MAGNET_S[0] + 0.1, MAGNET_S[0] + ROUND_S)
    reported = [len(score.look(round(1e6 * time_s) + 1, None, truth)) for time_s in times_s]
    assert reported == [1, 0, 1]
