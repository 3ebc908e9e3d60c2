"""``fuzzbee sim`` as a process, heard by pymavlink and by our own link."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import typer
from pymavlink import mavutil

import fuzzbee
from drivers.endpoint import Endpoint
from drivers.events import Imu
from drivers.mavlink.encoder import signing_key
from drivers.mavlink.link import MavlinkLink
from drivers.simulation.simulated_vehicle import simulate
from estimator.errors import InputError
from fuzzbee.sim import parse_magnet, sim

HOST = "127.0.0.1"
PATIENCE_S = 20.0
ROOT = Path(fuzzbee.__file__).parents[1]
PROGRAM = "import typer; from fuzzbee.sim import sim; typer.run(sim)"


@contextlib.contextmanager
def process(*options):
    """The simulated vehicle; whatever the test leaves is killed."""
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *options], cwd=ROOT, stderr=subprocess.PIPE, text=True
    ) as started:
        try:
            yield started
        finally:
            started.kill()


def free_port(kind):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind((HOST, 0))
        return probe.getsockname()[1]


def receive(connection, kind, n):
    """The next ``n`` messages of one type."""
    messages = []
    while len(messages) < n:
        message = connection.recv_match(type=kind, blocking=True, timeout=PATIENCE_S)
        assert message is not None, f"{len(messages)} {kind} only"
        messages.append(message)
    return messages


@contextlib.contextmanager
def pymavlink_at(address):
    connection = mavutil.mavlink_connection(address, dialect="ardupilotmega")
    try:
        yield connection
    finally:
        connection.close()


def udp_in():
    port = free_port(socket.SOCK_DGRAM)
    return port, pymavlink_at(f"udpin:{HOST}:{port}")


def test_udpout_to_pymavlink_until_a_signal():
    port, connection = udp_in()
    with connection as ground, process(
        "--to", f"udpout:{HOST}:{port}", "--seed", "6", "--rate", "200"
    ) as vehicle:  # fmt: skip
        raw = receive(ground, "RAW_IMU", 100)
        assert raw[0].time_usec == 0
        expected = simulate(6, 100, rate_hz=200.0)
        assert [m.time_usec for m in raw] == expected.time_us.tolist()
        gyro = np.array([(m.xgyro, m.ygyro, m.zgyro) for m in raw])
        assert np.abs(gyro - 1000 * expected.gyr_rad_s).max() < 1.0  # digits are cut off
        beat = receive(ground, "HEARTBEAT", 1)[0]
        assert (beat.type, beat.autopilot) == (2, 3)
        vehicle.send_signal(signal.SIGTERM)
        _, said = vehicle.communicate(timeout=PATIENCE_S)
        assert vehicle.returncode == 0
        assert said.count("\n") == 1
        assert f"udpout:{HOST}:{port}" in said


def test_a_ground_station_gets_parameters_and_its_rate():
    port, connection = udp_in()
    with connection as ground, process("--to", f"udpout:{HOST}:{port}", "--rate", "10"):
        ground.wait_heartbeat(timeout=PATIENCE_S)
        ground.mav.param_request_list_send(1, 1)
        first = receive(ground, "PARAM_VALUE", 1)[0]
        names = {m.param_id for m in receive(ground, "PARAM_VALUE", first.param_count - 1)}
        assert {"AHRS_TRIM_Y", "COMPASS_OFS_X"} <= names
        ground.mav.command_long_send(1, 1, 511, 0, 27, 5000, 0, 0, 0, 0, 0)
        assert receive(ground, "COMMAND_ACK", 1)[0].result == 0
        times = [m.time_usec for m in receive(ground, "RAW_IMU", 60)]
        assert set(np.diff(times)[5:].tolist()) == {5000}


def test_the_truth_follows_its_sample():
    port, connection = udp_in()
    with connection as ground, process("--to", f"udpout:{HOST}:{port}", "--motion", "turn"):
        messages = receive(ground, ["RAW_IMU", "SIM_STATE", "ATTITUDE"], 150)
    kinds = [m.get_type() for m in messages]
    assert kinds == 50 * ["RAW_IMU", "SIM_STATE", "ATTITUDE"]
    yaw = [m.yaw for m in messages[1::3]]
    times = [m.time_usec * 1e-6 for m in messages[::3]]
    np.testing.assert_allclose(yaw, 0.5 * np.array(times), atol=1e-6)


def test_udpin_answers_whoever_speaks_first():
    port = free_port(socket.SOCK_DGRAM)
    with process("--to", f"udpin:{HOST}:{port}") as vehicle:
        vehicle.stderr.readline()  # bound
        with MavlinkLink(Endpoint("udpout", HOST, port)) as link:
            wait_for_imu(link)


def test_tcpin_serves_two_clients():
    port = free_port(socket.SOCK_STREAM)
    with process("--to", f"tcpin:{HOST}:{port}", "--vehicles", "3") as vehicle:
        vehicle.stderr.readline()
        with pymavlink_at(f"tcp:{HOST}:{port}") as ground, MavlinkLink(
            Endpoint("tcp", HOST, port)
        ) as link:  # fmt: skip
            assert {m.get_srcSystem() for m in receive(ground, "RAW_IMU", 100)} == {1, 2, 3}
            wait_for_imu(link)


def test_tcp_connects_as_soon_as_somebody_listens():
    port = free_port(socket.SOCK_STREAM)
    with process("--to", f"tcp:{HOST}:{port}") as vehicle:
        vehicle.stderr.readline()
        assert "refused" in vehicle.stderr.readline()
        with MavlinkLink(Endpoint("tcpin", HOST, port)) as link:
            wait_for_imu(link)


def wait_for_imu(link, n=20):
    imus, deadline = [], time.monotonic() + PATIENCE_S
    while len(imus) < n:
        assert time.monotonic() < deadline
        imus += [event for event in link.drain(0.1) if isinstance(event, Imu)]
    return imus


def test_seconds_end_it_and_the_schedule_does_not_drift():
    port, connection = udp_in()
    options = ("--to", f"udpout:{HOST}:{port}", "--rate", "50", "--seconds", "2")
    with connection as ground, process(*options) as vehicle:
        times = [m.time_usec for m in receive(ground, "RAW_IMU", 100)]
        assert times == [20_000 * k for k in range(100)]
        assert vehicle.wait(PATIENCE_S) == 0
        while (more := ground.recv_match(type="RAW_IMU")) is not None:
            assert more.time_usec <= 2_000_000


def test_signed_frames(tmp_path):
    key_file = tmp_path / "key"
    key_file.write_text("open sesame\n")
    key_file.chmod(0o600)
    port, connection = udp_in()
    options = ("--to", f"udpout:{HOST}:{port}", "--signing-key-file", str(key_file))
    with connection as ground, process(*options):
        ground.setup_signing(signing_key(b"open sesame"), sign_outgoing=False)
        receive(ground, "RAW_IMU", 50)
        assert ground.mav.signing.goodsig_count >= 50
        assert ground.mav.signing.badsig_count == 0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"to": "udpout:127.0.0.1"}, "no port"),
        ({"to": "sim:"}, "--to sim:"),
        ({"to": "/dev/ttyUSB0:57600"}, "udpout, udpin, tcp, tcpin"),
        ({"rate": 0.0}, "rate"),
        ({"rate": float("nan")}, "rate"),
        ({"vehicles": 0}, "number of vehicles"),
        ({"vehicles": 1001}, "1000"),
        ({"seconds": 0.0}, "--seconds"),
        ({"motion": "loop"}, "paper, rest, turn"),
        ({"noise": -1.0}, "noise"),
        ({"magnet": "5"}, "5:8"),
        ({"magnet": "8:5"}, "later"),
        ({"drop": 2.0}, "drop"),
        ({"seed": -1}, "seed"),
        ({"signing_key_file": Path("no/such/key")}, "no/such/key"),
        ({"signing_key_file": Path(os.devnull)}, "empty"),
    ],
)
def test_bad_options_are_refused(options, said):
    with pytest.raises(InputError, match=said) as caught:
        sim(**{"to": "udpout:127.0.0.1:14550"} | options)
    assert "\n" not in str(caught.value)


def test_a_taken_port_is_refused():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as owner:
        owner.bind((HOST, 0))
        with pytest.raises(InputError, match="in use"):
            sim(to=f"udpin:{HOST}:{owner.getsockname()[1]}")


def test_help_names_every_link():
    from typer.testing import CliRunner

    app = typer.Typer()
    app.command()(sim)
    text = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "200"}).output
    for part in ("udpout:", "udpin:", "tcp:", "tcpin:", "--magnet", "--signing-key-file"):
        assert part in text


def test_magnet_times():
    assert parse_magnet("5:8.5") == (5.0, 8.5)


def test_a_bounded_run_that_nobody_heard_is_a_failure(capsys):
    port = free_port(socket.SOCK_STREAM)
    assert sim(to=f"tcp:{HOST}:{port}", seconds=0.5) == 1
    assert "nobody was connected in 0.5 s" in capsys.readouterr().err
