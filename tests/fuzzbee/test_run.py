"""``fuzzbee run`` from its arguments to its result."""

import json
import signal
import socket
import time
from collections import Counter
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from drivers.events import VehicleId
from drivers.simulation.source import SimSource
from estimator.estimator import Estimator
from estimator.profile import load_profile
from fuzzbee.cli import main
from fuzzbee.run import RunOptions
from fuzzbee.run_report import recording_word, summary
from service.stream_state import ImuChoice
from service.vehicle import Vehicle
from tests.fuzzbee.processes import UDP, default_session, free_endpoint, free_port, shell, started
from tests.fuzzbee.recording import TAKEOFF
from tests.fuzzbee.services import await_line
from tests.programs import can_mount
from tests.service.sessions import plain_listener


def test_json_is_one_object_about_the_run(capfd):
    assert main(["run", "--no-zenoh", "--seconds", "1", "--rate", "50", "--json"]) == 0
    out, err = capfd.readouterr()
    result = json.loads(out)
    assert (result["source"], result["profile"]) == ("sim:", "paper")
    vehicle = result["vehicles"]["1"]
    assert (vehicle["state"], vehicle["imu_message"]) == ("running", "RAW_IMU")
    assert vehicle["imu_rate_hz"] == pytest.approx(100.0, rel=0.01)
    assert vehicle["attitudes"] > 20  # a busy computer has more time for them, or less
    assert "running" in err
    assert "the paper's" in result["truth"]["1"]["worst_when"]


def test_a_fixed_gain_is_what_is_published(capfd):
    session = default_session()
    with started("run", "--gain", "7", *session) as service:
        assert main(["watch", "--json", "-n", "5", "--seconds", "60", *session]) == 0
        service.send_signal(signal.SIGTERM)
        assert service.wait(60) == 0
    records = [json.loads(line) for line in capfd.readouterr().out.splitlines()]
    assert [record["gain"] for record in records] == [7.0] * 5


@contextmanager
def taken_port(kind=UDP):
    with socket.socket(socket.AF_INET, kind) as taken:
        taken.bind(("127.0.0.1", 0))
        if kind == socket.SOCK_STREAM:
            taken.listen()
        yield taken.getsockname()[1]


@pytest.mark.parametrize(
    ("kind", "line"),
    [
        (UDP, "run --no-zenoh udpin:127.0.0.1:{port}"),
        (socket.SOCK_STREAM, "run --no-zenoh tcpin:127.0.0.1:{port}"),
        (UDP, "sim --to udpin:127.0.0.1:{port}"),
        (socket.SOCK_STREAM, "run -l tcp/127.0.0.1:{port}"),
    ],
)
def test_a_taken_port_is_status_2(kind, line, capfd):
    with taken_port(kind) as port:
        *verb, address = line.format(port=port).split()
        assert main([*verb, address]) == 2
    output = capfd.readouterr().err
    assert address in output
    assert "in use" in output
    # what to do about it, where it is a link's
    assert (f"sport = :{port} names the program" in output) == (not address.startswith("tcp/"))


@contextmanager
def flying():
    """Where a service hears the vehicle that flies."""
    port = free_port(UDP)
    with started("sim", "--to", f"udpout:127.0.0.1:{port}") as vehicle:
        vehicle.stderr.readline()  # it sends
        yield f"udpin:127.0.0.1:{port}"


ALONE = ("--profile", "paper", "--json", "--no-zenoh")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_end_it_quietly_with_everything_closed(number, tmp_path):
    record = tmp_path / "flight.tlog"
    options = ("--profile", "paper", "--json", "--record", str(record), "--truth")
    with flying() as at, started("run", at, *options, *default_session()) as service:
        await_line(service, "vehicle 1: running")
        time.sleep(1.0)
        service.send_signal(number)
        out, err = service.communicate(timeout=60)
    assert service.returncode == 0
    assert not [word for word in ("Traceback", "FATAL") if word in err]
    result = json.loads(out)
    assert result["vehicles"]["1"]["attitudes"] > 0
    assert result["truth"]["1"]["worst_deg"] > 0
    assert main(["run", "--no-zenoh", str(record), "--profile", "paper", "--speed", "5"]) == 0


def test_ros_nodes_receive_the_vehicle(capfd, monkeypatch):
    from rosbags.typesys import Stores, get_typestore

    types, got, endpoint = get_typestore(Stores.ROS2_JAZZY), [], free_endpoint()
    monkeypatch.setenv("ROS_DOMAIN_ID", "5")
    with plain_listener(endpoint) as session:
        session.declare_subscriber("5/fuzzbee/vehicle_1/imu/**", got.append)
        assert main(["run", "--ros", "--seconds", "2", "-e", endpoint, "--json"]) == 0
    messages = [types.deserialize_cdr(x.payload.to_bytes(), "sensor_msgs/msg/Imu") for x in got]
    assert len(messages) > 100
    assert messages[0].linear_acceleration.z != 0.0


def test_a_disk_that_fills_up_costs_the_rest_of_the_recording_only(tmp_path, replayed):
    """A limit of 40 kB for a file; what was written before is what replay reads."""
    folder = tmp_path / "logs"
    with flying() as at:
        command = ("run", at, "--seconds", "6", *ALONE, "--record", folder)
        done = shell('ulimit -f 40; "$@"', *command, status=1)
    assert done.stderr.count("the estimate goes on") == 1
    assert json.loads(done.stdout)["recording"] == "failed"
    assert json.loads(done.stdout)["vehicles"]["1"]["samples"] > 400
    (recorded,) = folder.iterdir()
    assert 30_000 < recorded.stat().st_size <= 40 * 1024
    assert 50 < replayed(recorded)["imu"]["samples"] < 300


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs Linux's full device")
def test_a_disk_that_is_full_from_the_start_costs_the_recording_only():
    with flying() as at:
        command = ("run", at, "--seconds", "5", *ALONE, "--record", "/dev/full")
        done = shell('"$@"', *command, status=1)
    said = "cannot record to /dev/full: No space left on device; the estimate goes on"
    assert [each for each in done.stderr.splitlines() if "record" in each] == [said]
    result = json.loads(done.stdout)
    assert result["recording"] == "failed"
    assert result["vehicles"]["1"]["samples"] > 300
    assert result["lost"] == result["malformed"] == 0


def test_a_source_that_fails_ends_the_service_with_all_that_there_is_to_say(monkeypatch, capfd):
    """As a reader's thread that has died: status 1, so that a supervisor starts it again."""
    drain, calls = SimSource.drain, []

    def fail(self, timeout_s):
        calls.append(timeout_s)
        if len(calls) > 100:
            raise MemoryError("no memory")
        return drain(self, timeout_s)

    monkeypatch.setattr(SimSource, "drain", fail)
    assert main(["run", "--no-zenoh", "--json"]) == 1
    out, err = capfd.readouterr()
    assert json.loads(out)["vehicles"]["1"]["samples"] > 10
    assert err.splitlines()[-1] == "fuzzbee: MemoryError: no memory"


def test_its_own_vehicle_is_given_a_profile_and_one_that_is_not_wanted_is_named(capfd):
    with flying() as at:
        command = ("run", at, "--no-zenoh", "--seconds", "5")
        assert main([*command, "--json"]) == 0
        out, err = capfd.readouterr()
        assert "profile paper" in err
        assert json.loads(out)["profile"] == "paper"
        assert main([*command, "--system-id", "42"]) == 1
    assert "no vehicle but system id 1 was heard" in capfd.readouterr().err


@pytest.mark.parametrize("is_older", [False, True])
@pytest.mark.parametrize("name", ["flight.tlog", "flights/"])
def test_a_taken_port_leaves_no_recording_and_an_older_one_as_it_is(tmp_path, name, is_older):
    if is_older:
        (tmp_path / name).mkdir() if name.endswith("/") else (tmp_path / name).touch()
    before = [*tmp_path.rglob("*")]
    with taken_port() as port:
        command = ["run", f"udpin:127.0.0.1:{port}", "--no-zenoh", "--record"]
        assert main([*command, f"{tmp_path}/{name}"]) == 2
    assert [*tmp_path.rglob("*")] == before


@pytest.mark.parametrize(("parts", "word"), [("", ""), ("11", "whole"), ("10", "failed")])
def test_a_recording_is_whole_if_each_of_its_parts_is(parts, word):
    things = [SimpleNamespace(is_whole=part == "1") for part in parts]
    assert recording_word([object(), *things]) == word


def test_the_result_of_a_run_names_what_was_counted_in_its_units():
    """No two numbers are alike."""
    vehicle = Vehicle(VehicleId(1, 1), Estimator(load_profile("imu")))
    vehicle.imu.samples, vehicle.publishing.attitudes = 31, 33
    vehicle.imu._shed = Counter(RAW_IMU=32)
    vehicle.imu.worst_gap_us, vehicle.imu.median_period_us = 250_000, 1e6 / 49.87654
    vehicle.imu.choice, vehicle.rejected["late"] = ImuChoice("RAW_IMU"), 35
    evicted = Counter(vehicles=51, samples=52, shed=53, rejected=54, attitudes=55)
    runner = SimpleNamespace(ticks=41, overruns=42, dropped=43, recording=str)
    runner.source = SimpleNamespace(lost=71)
    pipeline = SimpleNamespace(malformed=72, evicted=evicted, scores=None, vehicles=(vehicle,))
    pipeline.refused_frames, pipeline.systems = {"signature": 61, "id": 62}, {3, 1}
    options = RunOptions(source="sim:", profile=None, rate_hz=100.0)
    result = summary(options, "imu", 7.0, runner, pipeline)
    assert result["heard"] == [1, 3]
    expected = {"ticks": 41, "overruns": 42, "dropped": 43, "lost": 71, "malformed": 72}
    assert {name: result[name] for name in expected} == expected
    assert result["departed"] == evicted
    assert list(result["refused"].items()) == [("id", 62), ("signature", 61)]
    vehicle = result["vehicles"]["1"]
    assert (vehicle["worst_gap_s"], vehicle["imu_rate_hz"]) == (0.25, 49.877)
    assert (vehicle["samples"], vehicle["shed"], vehicle["attitudes"]) == (31, 32, 33)
    assert (vehicle["imu_message"], vehicle["rejected"]) == ("RAW_IMU", {"late": 35})


def run_in(mount, *arguments):
    """A command in a namespace of its own, in which /dev/shm is another one."""
    if not can_mount("mount -t tmpfs none /dev/shm"):
        pytest.skip("no namespaces of one's own here")
    script = f'mount -t tmpfs {mount} none /dev/shm && exec "$@"'
    return shell(f"unshare -rm sh -c '{script}' sh \"$@\"", *arguments)


@pytest.mark.parametrize("mount", ["-o ro", "-o size=4k"])
def test_where_the_system_gives_no_shared_memory_a_run_goes_on_with_a_line(mount):
    done = run_in(mount, "run", "sim:", "--seconds", "2", "--json", *default_session())
    assert json.loads(done.stdout)["vehicles"]["1"]["attitudes"] > 0
    assert done.stderr.count("no shared memory, going on without") == 1


def test_without_shared_memory_logs_are_checked_one_after_the_other():
    assert run_in("-o ro", "check", str(TAKEOFF), str(TAKEOFF)).stdout.count("no difference") == 2
