"""Several vehicles on one link, without a socket."""

import numpy as np
import pytest

from drivers.simulation.autopilot import VehicleOptions
from drivers.simulation.fleet import Fleet
from drivers.simulation.simulated_vehicle import simulate
from estimator.errors import InputError
from tests.drivers.simulation.conversation import SECOND, UNIX_US, interval, of_type, parsed


def test_vehicles_are_told_apart_and_spread():
    fleet = Fleet(VehicleOptions(seed=10, rate_hz=10.0), 5)
    sent = []
    for now_us in range(0, 2 * SECOND, 1000):
        fleet.send_due(now_us, UNIX_US, lambda data, now=now_us: sent.append((now, data)))
    for system_id in range(1, 6):
        mine = [m for _, data in sent for m in parsed(data) if m.get_srcSystem() == system_id]
        raw = of_type(mine, "RAW_IMU")
        expected = simulate(10 + system_id - 1, len(raw), rate_hz=10.0)
        gyro = np.array([m.zgyro for m in raw])
        assert np.abs(gyro - 1000 * expected.gyr_rad_s[:, 2]).max() <= 1.0
    times = [now for now, data in sent if of_type(parsed(data), "RAW_IMU")]
    assert len(times) == len(set(times)) == 100


def test_after_a_stall_the_fleet_goes_on_with_the_present():
    fleet = Fleet(VehicleOptions(), 2)
    sent = []
    fleet.send_due(5000, UNIX_US, sent.append)
    sent.clear()
    fleet.send_due(100 * SECOND, UNIX_US, sent.append)
    fleet.send_due(100 * SECOND + 5000, UNIX_US, sent.append)
    raw = of_type(parsed(b"".join(sent)), "RAW_IMU")
    assert [(m.get_srcSystem(), m.time_usec) for m in raw] == [(1, 10**8), (2, 10**8)]


def test_a_fleet_answers_each_peer_s_half_frames():
    fleet = Fleet(VehicleOptions(rate_hz=2.0), 3)
    request = bytes(interval(27, 10_000, target=(2, 1)).get_msgbuf())
    answers = []
    fleet.receive("a", request[:10], UNIX_US, answers.append)
    fleet.receive("b", request, UNIX_US, answers.append)
    assert len(answers) == 1
    fleet.receive("a", request[10:], UNIX_US, answers.append)
    acks = parsed(b"".join(answers))
    assert [(m.get_type(), m.get_srcSystem()) for m in acks] == 2 * [("COMMAND_ACK", 2)]
    fleet.receive("a", b"", UNIX_US, answers.append)


@pytest.mark.parametrize(
    "options",
    [{"rate_hz": 0}, {"rate_hz": float("nan")}, {"rate_hz": 1e5}, {"drop": 1.5}, {"drop": -0.1},
     {"motion": "x"}, {"seed": -1}],
)  # fmt: skip
def test_bad_options(options):
    with pytest.raises(InputError):
        Fleet(VehicleOptions(**options), 1)
    with pytest.raises(InputError):
        Fleet(VehicleOptions(), 0)
