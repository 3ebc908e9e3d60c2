"""``fuzzbee sim`` as a process, heard by pymavlink and by our own link."""

import json
import signal
import socket
import time
from contextlib import ExitStack, closing, contextmanager

import numpy as np
import pytest
from pymavlink import mavutil

from drivers.endpoint import Endpoint
from drivers.events import Imu
from drivers.mavlink.link import MavlinkLink
from drivers.simulation.simulated_vehicle import SimulatedVehicle, simulate
from fuzzbee.cli import main
from tests.fuzzbee.processes import UDP, free_port, started

HOST = "127.0.0.1"
PATIENCE_S = 60.0


def receive(connection, kind, n):
    """The next ``n`` messages of one type."""
    messages = []
    while len(messages) < n:
        message = connection.recv_match(type=kind, blocking=True, timeout=PATIENCE_S)
        assert message is not None, f"{len(messages)} {kind} only"
        messages.append(message)
    return messages


@contextmanager
def received(*options):
    """A ground station, and the vehicle that sends to it by UDP."""
    port = free_port(UDP)
    ground = mavutil.mavlink_connection(f"udpin:{HOST}:{port}", dialect="ardupilotmega")
    with closing(ground), started("sim", "--to", f"udpout:{HOST}:{port}", *options) as vehicle:
        yield ground, vehicle


def wait_for_imu(link, of):
    """Until there have been samples of these systems."""
    heard, deadline_s = set(), time.monotonic() + PATIENCE_S
    while heard < of:
        assert time.monotonic() < deadline_s
        heard |= {e.vehicle.system_id for e in link.drain(0.1) if isinstance(e, Imu)}
    assert heard == of


def test_udpout_to_pymavlink_until_a_signal():
    with received("--seed", "6", "--rate", "200") as (ground, vehicle):
        raw = receive(ground, "RAW_IMU", 100)
        expected = simulate(6, 100, rate_hz=200.0)
        assert [m.time_usec for m in raw] == expected.time_us.tolist()
        gyro = np.array([(m.xgyro, m.ygyro, m.zgyro) for m in raw])
        assert np.abs(gyro - 1000 * expected.gyr_rad_s).max() < 1.0  # digits are cut off
        beat = receive(ground, "HEARTBEAT", 1)[0]
        assert (beat.type, beat.autopilot) == (2, 3)
        vehicle.send_signal(signal.SIGTERM)
        _, output = vehicle.communicate(timeout=PATIENCE_S)
        assert vehicle.returncode == 0
        assert output.count("\n") == 1
        assert f"udpout:{HOST}:" in output


def test_a_ground_station_gets_its_rate():
    with received("--rate", "10") as (ground, _):
        ground.wait_heartbeat(timeout=PATIENCE_S)
        ground.mav.command_long_send(1, 1, 511, 0, 27, 5000, 0, 0, 0, 0, 0)
        assert receive(ground, "COMMAND_ACK", 1)[0].result == 0
        times = [m.time_usec for m in receive(ground, "RAW_IMU", 60)]
        assert set(np.diff(times)[5:].tolist()) == {5000}


@pytest.mark.parametrize(
    ("to", "from_", "clients"), [("udpin", "udpout", 1), ("tcpin", "tcp", 2), ("tcp", "tcpin", 1)]
)
def test_it_is_received_with_either_side_listening(to, from_, clients):
    """Where it is not the vehicle, that is refused until somebody does."""
    port = free_port(UDP if to == "udpin" else socket.SOCK_STREAM)
    command = ("sim", "--to", f"{to}:{HOST}:{port}", "--vehicles", "3")
    with started(*command) as vehicle, ExitStack() as stack:
        vehicle.stderr.readline()  # bound
        if to == "tcp":
            assert "refused" in vehicle.stderr.readline()
        links = []
        for _ in range(clients):
            links.append(stack.enter_context(MavlinkLink(Endpoint(from_, HOST, port))))
            for link in links:  # a later client displaces none
                wait_for_imu(link, of={1, 2, 3})


def test_seconds_end_it():
    with received("--rate", "50", "--seconds", "2") as (ground, vehicle):
        assert receive(ground, "RAW_IMU", 100)[-1].time_usec == 99 * 20_000
        assert vehicle.wait(PATIENCE_S) == 0
        while (more := ground.recv_match(type="RAW_IMU")) is not None:
            assert more.time_usec <= 2_000_000


def test_a_bounded_run_that_nobody_received_is_a_failure(capfd):
    assert main(["sim", "--to", f"tcp:{HOST}:{free_port()}", "--seconds", "0.5"]) == 1
    assert "nobody was connected in 0.5 s" in capfd.readouterr().err


def test_the_errors_of_its_sensors_are_reported(capsys):
    """And sent: the calibration that it prints makes the field one of constant strength."""
    with socket.socket(socket.AF_INET, UDP) as hearer:
        hearer.bind((HOST, 0))
        to = f"udpout:{HOST}:{hearer.getsockname()[1]}"
        options = ("--motion", "bench", "--imu-errors", "3", "--seconds", "0.1", "--json")
        assert main(["sim", "--to", to, *options]) in (0, 1)
    reported = json.loads(capsys.readouterr().out)["imu_errors"]
    vehicle = SimulatedVehicle(0, 50.0, "bench", noise=0.0, bias=0.0, errors_seed=3)
    read = np.array([next(vehicle).mag_gauss for _ in range(500)])
    field = (read - reported["mag_offset_gauss"]) @ np.array(reported["mag_matrix"]).T
    assert np.ptp(np.linalg.norm(read, axis=1)) > 0.02  # gauss
    assert np.ptp(np.linalg.norm(field, axis=1)) < 1e-4
