"""The built-in vehicle through the service: right, known to be, and the paper's experiment."""

from math import degrees

import numpy as np
import pytest

from drivers.events import BuiltIn, ClockReset, Imu, ReferenceAttitude
from drivers.mavlink.encoder import FrameEncoder, raw_imu
from drivers.simulation.autopilot import SimulatedAutopilot, VehicleOptions
from drivers.simulation.simulated_vehicle import SimulatedVehicle
from drivers.simulation.source import SimSource
from estimator.estimator import Estimator
from estimator.filter import kernel
from estimator.geometry.metrics import COST_SAMPLES, angle_errors, paper_cost, rms
from estimator.geometry.quaternion import normalized_distance
from estimator.live.settings import settings_of
from service.pipeline import Pipeline
from service.records import Replaced
from tests.service.flight_rig import IMU, ONE, PAPER, START_US, Wire, imu_events, statuses, texts
from tuning.paper_experiment import run_experiment

RATE_HZ = 50.0


def flown(motion, seconds, seed, **options):
    """Times, total, heading and inclination errors, both sigmas likewise (s, deg) at samples."""
    vehicle = SimulatedAutopilot(VehicleOptions(seed, RATE_HZ, motion, **options), 1)
    pipeline = Pipeline(IMU, fits_built_in=True)
    wire, rows = Wire(), []
    for step in range(round(seconds * RATE_HZ)):
        boot_us = step * 20_000
        for event in wire.events(vehicle.advance(boot_us, 0), START_US + boot_us):
            pipeline.handle(event)
            if isinstance(event, Imu):
                time_us = event.sample.time_us
            elif isinstance(event, ReferenceAttitude) and event.source == "sim":
                attitude = pipeline.vehicle(ONE).estimator.attitude(time_us)
                errors = angle_errors(attitude.q_ned_frd, event.q_ned_frd)
                angles = (*errors, attitude.sigma_heading_rad, attitude.sigma_inclination_rad)
                rows.append((boot_us * 1e-6, *map(degrees, angles)))
    return np.array(rows)


@pytest.mark.parametrize(
    ("motion", "error_deg", "least", "most"),
    [("paper", 6.6, 0.55, 0.98), ("rest", 2.2, 0.9, 1.0), ("turn", 8.7, 0.5, 0.9)],
)
def test_the_paper_s_signals_are_read_with_the_paper_s_profile(motion, error_deg, least, most):
    rows = np.concatenate([flown(motion, 15.0, seed)[200:] for seed in (1, 2)])
    assert rms(rows[:, 1]) == pytest.approx(error_deg, rel=0.2)
    for error, sigma in ((2, 4), (3, 5)):
        assert least <= np.mean(rows[:, error] <= rows[:, sigma]) <= most


def test_the_flight_is_right_from_start_to_landing():
    """Through a wrong start, a magnet and a silence, none of which it may fall for."""
    rows = flown("flight", 100.0, seed=1)
    after_start = rows[rows[:, 0] >= 2.0]
    assert rms(after_start[:, 1]) == pytest.approx(0.483, rel=0.2)
    assert after_start[:, 1].max() < 5.7  # 4.8, in the climb
    assert rows[rows[:, 0] < 0.5][:, 3].max() > 8.0  # the wrong start is one
    for error, sigma in ((2, 4), (3, 5)):
        assert np.mean(after_start[:, error] <= after_start[:, sigma]) > 0.8


def built_in(motion):
    return BuiltIn(ONE, START_US, motion)


def test_fuzzbee_s_own_vehicle_gets_the_profile_that_fits():
    pipeline = Pipeline(IMU, fits_built_in=True)
    assert pipeline.handle(built_in("of another version")) == []
    noisy = "profile paper (signals so noisy that 5 to 10° remain)"
    notified = texts(pipeline.handle(built_in("paper")))
    assert notified == [f"vehicle 1: fuzzbee's own, motion paper, {noisy}"]
    assert pipeline.handle(built_in("paper")) == []
    for event in imu_events(300):
        pipeline.handle(event)
    assert pipeline.vehicle(ONE).profile == PAPER
    outputs = pipeline.tick(START_US + 3_000_000)
    assert [o for o in outputs if isinstance(o, Replaced)] == [Replaced(ONE, PAPER)]
    assert texts(outputs) == []
    notified = texts(pipeline.handle(built_in("flight")))
    assert notified == ["vehicle 1: fuzzbee's own, motion flight, profile imu"]
    assert pipeline.vehicle(ONE).profile == IMU
    # after a reboot another vehicle may have the address
    pipeline.handle(built_in("paper"))
    assert pipeline.vehicle(ONE).profile == PAPER
    pipeline.handle(ClockReset(ONE, START_US, "reboot", -7.0))
    assert pipeline.vehicle(ONE).profile == IMU
    pipeline.handle(built_in("paper"))
    assert pipeline.vehicle(ONE).profile == PAPER


def test_a_profile_that_was_asked_for_stays_and_is_reported_if_it_does_not_fit():
    pipeline = Pipeline(IMU)
    (text,) = texts(pipeline.handle(built_in("paper")))
    assert text.endswith("profile paper would fit, this one does not")
    assert pipeline.vehicle(ONE).profile == IMU
    (status,) = statuses(pipeline.tick(START_US))
    assert status.warnings == ("profile_unfit",)
    pipeline.replace_profile(ONE, {"filter": {"gamma": 0.5}})  # somebody knows better
    (status,) = statuses(pipeline.tick(START_US + 2_000_000))
    assert status.warnings == ()
    assert texts(pipeline.handle(built_in("flight"))) == []


SEED = 9_002


@pytest.fixture(scope="module")
def experiment():
    return run_experiment(PAPER, SEED)


@pytest.fixture(scope="module")
def simulated():
    vehicle = SimulatedVehicle(SEED)
    return [next(vehicle) for _ in range(COST_SAMPLES)]


def predicted(estimator, sample):
    """The estimate at a sample that the estimator has not taken yet."""
    if not estimator.aligned:
        return settings_of(PAPER).initial
    now = estimator.snapshot
    dt = 1e-6 * (sample.time_us - now.core.time_us)
    return kernel.propagate(now.core.filter, sample.gyr_rad_s, dt).q_ned_frd


def handled(pipeline, events):
    """The estimates at the samples among the events, before the pipeline takes each."""
    estimates = []
    for event in events:
        if isinstance(event, Imu):
            vehicle = pipeline.vehicle(ONE)
            estimator = Estimator(PAPER) if vehicle is None else vehicle.estimator
            estimates.append(predicted(estimator, event.sample))
        pipeline.handle(event)
    return estimates


def cost(estimates, simulated):
    pairs = zip(simulated, estimates, strict=True)
    return paper_cost(np.array([normalized_distance(s.q_ned_frd, q) for s, q in pairs]))


def test_the_pipeline_on_sim_is_the_experiment_to_the_last_digit(experiment, simulated):
    clock_us, pipeline, estimates = [0], Pipeline(PAPER), []
    with SimSource(SimulatedVehicle(SEED), lambda: clock_us[0], lambda: clock_us[0]) as source:
        for sample in simulated:
            clock_us[0] = sample.time_us
            estimates += handled(pipeline, source.drain(0.0))
            pipeline.tick(clock_us[0] + 3_000)  # publishing leaves the states alone
    assert np.array_equal(estimates, experiment.estimates)
    assert cost(estimates, simulated) == experiment.cost


@pytest.mark.parametrize(
    ("stamp_us", "measured"),
    [
        (lambda true_us, _: true_us, 5.303),
        (lambda true_us, rng: true_us + int(rng.integers(-1, 2)), 5.303),
        (lambda true_us, rng: (true_us + int(rng.integers(0, 1500))) // 1000 * 1000, 5.282),
    ],
    ids=["exact", "a microsecond of jitter", "whole milliseconds"],
)
def test_as_mavlink_it_costs_what_the_rounding_does(experiment, simulated, stamp_us, measured):
    """Stamped by three kinds of clocks: uneven steps are taken as those of 10 ms are."""
    rng, encoder, wire = np.random.default_rng(1), FrameEncoder(ONE), Wire()
    pipeline, estimates = Pipeline(PAPER), []
    for sample in simulated:
        boot_us = stamp_us(1_000_000 + sample.time_us, rng)
        message = raw_imu(boot_us, sample.acc_m_s2, sample.gyr_rad_s, sample.mag_gauss)
        arrival_us = START_US + sample.time_us
        frame = encoder.frame(message, arrival_us)
        estimates += handled(pipeline, wire.events(frame, arrival_us))
    assert cost(estimates, simulated) == pytest.approx(measured, abs=0.01)
    assert not np.array_equal(estimates, experiment.estimates)
