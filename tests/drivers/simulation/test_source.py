"""The in-process vehicle under a clock that the test moves."""

from types import SimpleNamespace

import numpy as np
import pytest

from drivers.endpoint import Endpoint, parse_endpoint
from drivers.events import BuiltIn, Heartbeat, Imu, LinkUp, Position, ReferenceAttitude, Velocity
from drivers.player import MAX_BEHIND_S
from drivers.simulation.flight import SILENCE_S, flight_truth
from drivers.simulation.simulated_vehicle import (
    FLIGHT_VELOCITY_NOISE_M_S,
    SimulatedVehicle,
    simulate,
)
from drivers.simulation.source import SimSource
from drivers.source import open_live, require_openable
from estimator.errors import InputError
from tests.drivers.logs.writers import of


def source_and_clock(**options):
    clock, vehicle = SimpleNamespace(us=5_000_000), SimulatedVehicle(3, **options)
    return SimSource(vehicle, lambda: clock.us, lambda: 10**15 + clock.us), clock


def test_events_are_the_paper_s_exact_numbers_at_their_times():
    source, clock = source_and_clock()
    expected = simulate(3, 250)
    events = []
    with source:
        start_us = 10**15 + clock.us
        for step in (0, 3_000, 7_000, *(95_000,) * 26, 10_000):
            clock.us += step
            events += source.drain(0)
    imus = of(Imu, events)
    assert len(imus) == 250
    for name in ("time_us", "gyr_rad_s", "acc_m_s2", "mag_gauss"):
        values = np.array([getattr(imu.sample, name) for imu in imus])
        assert np.array_equal(values, getattr(expected, name)), name
    assert all(imu.sample.has_mag and imu.boot_us == imu.sample.time_us for imu in imus)
    assert all(imu.arrival_us == start_us + imu.boot_us for imu in imus)
    truth = of(ReferenceAttitude, events)
    assert np.array_equal([t.q_ned_frd for t in truth], expected.q_ned_frd)
    assert [t.time_us for t in truth] == [imu.sample.time_us for imu in imus]
    assert isinstance(events[0], LinkUp)
    assert [h.arrival_us - start_us for h in of(Heartbeat, events)] == [0, 10**6, 2 * 10**6]
    assert source.dropped == 0


def test_the_vehicle_waits_for_a_computer_that_slept_or_is_too_slow():
    source, clock = source_and_clock(rate_hz=50.0)
    with source:
        start_us = source.now_us()
        source.drain(0)
        clock.us += 60_000_000
        assert source.now_us() - start_us == 20_000  # and no further
        clock.us += 40_000_000
        assert len(of(Imu, source.drain(0))) == 6
        assert source.waited_s == pytest.approx(99.88)
        stamps = []
        for _ in range(20):  # at a third of the pace
            clock.us += 300_000
            stamps += [event.boot_us for event in of(Imu, source.drain(0))]
            assert 0 <= source.now_us() - start_us - stamps[-1] <= 1e6 * MAX_BEHIND_S
    assert [*range(stamps[0], stamps[-1] + 1, 20_000)] == stamps  # nothing is left out
    assert source.dropped == 0
    assert source.flown_s == pytest.approx(1e-6 * stamps[-1], abs=0.02)


def test_in_real_time_it_waits_for_the_next_sample():
    with open_live(Endpoint("sim")) as source:
        imus = []
        while len(imus) < 30:
            imus += of(Imu, source.drain(0.1))
    assert [imu.boot_us for imu in imus[:30]] == [10_000 * k for k in range(30)]
    assert source.drain(10) == []  # closed: no waiting


def test_a_flight_in_process_sends_its_place_and_falls_silent():
    source, clock = source_and_clock(motion="flight", rate_hz=50.0)
    events = []
    with source:
        for _ in range(1000):
            clock.us += 100_000
            events += source.drain(0)
    begin, end = SILENCE_S
    imu_s = np.array([event.boot_us for event in of(Imu, events)]) * 1e-6
    assert np.diff(imu_s).max() == pytest.approx(end - begin + 0.02)
    assert imu_s[np.diff(imu_s).argmax()] == pytest.approx(begin - 0.02)
    velocities = of(Velocity, events)
    assert len(velocities) == len(of(Position, events)) == 992  # 10 Hz but in the silence
    truth = flight_truth(np.array([v.sample.time_us * 1e-6 for v in velocities])).velocity_ned_m_s
    noise = np.array([v.sample.velocity_ned_m_s for v in velocities]) - truth
    assert noise.std() == pytest.approx(FLIGHT_VELOCITY_NOISE_M_S, rel=0.1)
    assert {event.motion for event in of(BuiltIn, events)} == {"flight"}


def test_what_has_no_live_source_and_an_unknown_motion_before_anything_is_opened(tmp_path):
    with pytest.raises(InputError, match=r"'loop'.*paper, rest, turn, flight"):
        require_openable(parse_endpoint("sim:loop"))
    log = tmp_path / "x.tlog"
    log.touch()
    with pytest.raises(InputError, match="log"):
        open_live(parse_endpoint(str(log)))
    with pytest.raises(InputError, match="sim:"):
        open_live(Endpoint("sim"), request_rate_hz=50)
