"""Signed and unsigned vehicles at once, keys, and what is listened on: real processes."""

import json
import os
import signal
import socket
from contextlib import closing, contextmanager, suppress
from itertools import count, cycle, product
from pathlib import Path

import pytest

from drivers.mavlink.encoder import signing_key
from fuzzbee.cli import main
from tests.fuzzbee.processes import (
    UDP,
    default_session,
    free_endpoint,
    free_port,
    is_loopback,
    listening,
    shell,
    started,
)
from tests.fuzzbee.recording import frames_of
from tests.fuzzbee.services import only, repeated
from tests.service.sessions import plain_client, wait_for

os.environ["MAVLINK20"] = "1"  # read by pymavlink when it is imported
from pymavlink import mavutil

KEY_FILE, NOWHERE = "--signing-key-file", "udpout:127.0.0.1:9"


def key_file(path, phrase):
    path.write_text(phrase)
    path.chmod(0o600)
    return path


@pytest.fixture
def key(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return key_file(tmp_path / "key", "correct horse battery staple")


@pytest.fixture
def port():
    return free_port(UDP)


def flying(port, *options):
    return started("sim", "--to", f"udpout:127.0.0.1:{port}", *map(str, options))


def run_service(port, *options, seconds=2.5):
    settings = ("--json", "--no-zenoh", "--profile", "paper", "--rate", "20")
    source = f"udpin:127.0.0.1:{port}"
    done = shell('"$@"', "run", source, *settings, "--seconds", seconds, *options)
    return json.loads(done.stdout), done.stderr


def test_beside_a_signed_vehicle_an_unsigned_one_is_refused_and_counted(key, port, tmp_path):
    other = key_file(tmp_path / "other key", "wrong")
    with (
        flying(port, KEY_FILE, key),
        flying(port, "--vehicles", 2),  # an unsigned 1 and an unsigned 2
        flying(port, KEY_FILE, other),
    ):
        result, output = run_service(port, KEY_FILE, key)
    ((name, vehicle),) = result["vehicles"].items()
    assert (name, vehicle["state"]) == ("1", "running")
    assert vehicle["samples"] > 100
    # as in its status: who claims to be it
    assert min(vehicle["rejected"][reason] for reason in ("unsigned", "wrong_signature")) > 100
    assert result["refused"]["unsigned"] > 200
    assert result["refused"]["wrong_signature"] > 100
    assert "without a signature" in output


@contextmanager
def peer(port, key):
    """A vehicle of pymavlink: its check of signatures, and the messages that it was asked for."""
    address, us = f"udpout:127.0.0.1:{port}", {"source_system": 1, "source_component": 1}
    link = mavutil.mavlink_connection(address, dialect="ardupilotmega", **us)
    link.setup_signing(key, allow_unsigned_callback=lambda *_: False)
    asked, numbers = [], count()

    def fly():
        number = next(numbers)
        if number % 50 == 0:
            link.mav.heartbeat_send(2, 3, 0, 0, 4)
        noise = number % 3
        link.mav.raw_imu_send(10_000 * number, noise, 0, -1000, 0, noise, 1, 200, 0, 400)
        with suppress(ConnectionRefusedError):  # nobody listens yet
            message = link.recv_match(type="COMMAND_LONG", blocking=False)
            if message is not None and message.command == 511:
                asked.append(int(message.param1))

    with closing(link), repeated(fly, 0.01):
        yield link.mav.signing, asked


def test_a_signed_vehicle_accepts_our_requests_also_after_a_restart(key, port):
    counts, stamps = [], []
    with peer(port, signing_key(key.read_bytes())) as (signing, asked):
        for _ in range(2):
            result, _ = run_service(port, KEY_FILE, key, "--request-rate", "200", seconds=2)
            assert result["vehicles"]["1"]["samples"] > 50
            assert result["vehicles"]["1"]["state"] == "running"
            counts.append(len(asked))
            stamps.append(signing.stream_timestamps[0, 1, 191])
    assert 0 < counts[0] < counts[1]
    assert set(asked) == {27}  # RAW_IMU
    assert stamps[0] < stamps[1]
    assert signing.badsig_count == 0
    assert signing.goodsig_count > 4


def test_secrets_are_in_no_argument_log_recording_status_or_error(key, port, tmp_path):
    log, endpoint, arguments = tmp_path / "f.tlog", free_endpoint(), []
    secret, digest = key.read_bytes(), signing_key(key.read_bytes())
    command = ("run", f"udpin:127.0.0.1:{port}", "-v", "--json", "--record", str(log))
    with (
        flying(port, KEY_FILE, key) as vehicle,
        flying(port, "--vehicles", 2),
        started(*command, *only(endpoint), KEY_FILE, str(key)) as service,
    ):
        with plain_client(endpoint, 60.0) as client:
            seen = []
            client.declare_subscriber("**", lambda sample: seen.append(sample.payload.to_bytes()))
            wait_for(lambda: any(b"unsigned" in each for each in seen), 60.0)
            wait_for(lambda: log.stat().st_size > 1000, 60.0)  # before it is stopped
        for process, file in product((vehicle, service), ("cmdline", "environ")):
            arguments.append(Path(f"/proc/{process.pid}/{file}").read_bytes())
        service.send_signal(signal.SIGINT)
        result, output = service.communicate()
    state = (tmp_path / "state" / "fuzzbee" / "signing.json").read_bytes()
    for text in [result.encode(), output.encode(), state, log.read_bytes(), *arguments, *seen]:
        assert secret not in text
        assert digest not in text
        assert digest.hex().encode() not in text.lower()


def test_frames_of_before_a_restart_are_refused_after_it(key, port, tmp_path):
    log = tmp_path / "flight.tlog"
    with flying(port, KEY_FILE, key, "--rate", 20):
        before, _ = run_service(port, KEY_FILE, key, "--record", log, seconds=2)
    assert before["vehicles"]["1"]["samples"] > 20
    frames = cycle(frame for _, frame in frames_of(log))
    with (
        socket.socket(socket.AF_INET, UDP) as sender,
        repeated(lambda: sender.sendto(next(frames), ("127.0.0.1", port)), 0.005),
    ):
        after, _ = run_service(port, KEY_FILE, key, seconds=2)
    assert after["vehicles"] == {}
    assert after["refused"]["replayed"] > 20


@pytest.mark.parametrize("verb", [("run", NOWHERE), ("sim", "--to", NOWHERE)])
@pytest.mark.parametrize(
    ("content", "mode", "output"),
    [
        *((b"s3cret phrase", m, "others may read the key file ") for m in (0o644, 0o604, 0o620)),
        *((content, 0o600, "the key file ") for content in (b"", b" \n", b"s3cret" * 1000)),
        (None, 0o600, "cannot read the key file "),
    ],
)
def test_a_bad_key_file_is_refused_and_not_shown(verb, content, mode, output, tmp_path, refused):
    path = tmp_path / "key"
    if content is not None:
        path.write_bytes(content)
        path.chmod(mode)
    command = [*verb, "--seconds", "0.1", KEY_FILE, str(path)]
    line = refused(*command)
    assert line.startswith(f"fuzzbee: {output}")
    assert "s3cret" not in line
    if mode != 0o600:
        assert main([*command, "--insecure-key-file"]) != 2


@pytest.mark.parametrize(("phrase", "warns"), [("1234567", True), ("12345678", False)])
def test_a_short_pass_phrase_warns(key, phrase, warns, capfd):
    key.write_text(phrase)
    command = ["sim", "--to", NOWHERE, "--seconds", "0.1"]
    assert main([*command, KEY_FILE, str(key)]) == 0
    output = capfd.readouterr().err
    assert ("easily guessed" in output) == warns
    assert phrase not in output


def settled(process, condition):
    """The sockets once ``condition`` holds for them."""
    found = []

    def is_settled():
        assert process.poll() is None
        found[:] = listening(process.pid)
        return condition(found)

    wait_for(is_settled)
    return found


@pytest.mark.parametrize("verb", ["run", "watch"])
def test_run_and_watch_listen_on_loopback_only(verb, port):
    tcp, metrics = free_port(), free_port()
    command, ports = [verb, "--json", *default_session(tcp)], {tcp}
    if verb == "run":
        command += [
            f"udpin:127.0.0.1:{port}",
            "--profile",
            "paper",
            "--ros",
            f"--metrics={metrics}",
        ]
        ports |= {port, metrics}
    with started(*command) as process:
        found = settled(process, lambda seen: ports <= {port for _, port in seen})
        assert all(is_loopback(host) for host, _ in found), found


@pytest.mark.parametrize(("kind", "of"), [("udpin", [UDP]), ("tcpin", [])])
def test_sim_listens_where_it_is_reported_only(kind, of):
    port = free_port(*of)
    with started("sim", "--to", f"{kind}:127.0.0.1:{port}") as process:
        assert {*settled(process, bool)} == {("127.0.0.1", port)}
