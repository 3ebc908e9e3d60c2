"""The paper's experiment by the live service's own way gives the experiment's numbers."""

import numpy as np
import pytest

from drivers.events import Imu
from drivers.mavlink.encoder import FrameEncoder, raw_imu
from drivers.simulation.simulated_vehicle import SimulatedVehicle
from drivers.simulation.source import SimSource
from estimator.estimator import Estimator
from estimator.filter import kernel
from estimator.geometry.metrics import COST_SAMPLES, paper_cost
from estimator.geometry.quaternion import normalized_distance
from estimator.live.settings import settings_of
from service.pipeline import Pipeline
from tests.service.flight_rig import ONE, PAPER, START_US, Wire
from tuning.paper_experiment import run_experiment

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
