"""Signed and unsigned vehicles at once, allowed systems: real processes on loopback."""

import json
import os
import socket
import subprocess
import sys

import pytest

from estimator.errors import InputError
from fuzzbee.cli import main
from fuzzbee.security import parse_system_ids
from tests.fuzzbee.processes import free_port, started


@pytest.fixture
def key(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    path = tmp_path / "key"
    path.write_text("correct horse battery staple")
    return path


def run_service(port, *options, seconds=6):
    done = subprocess.run(
        [
            *(sys.executable, "-m", "fuzzbee", "run", f"udpin:127.0.0.1:{port}", "--json"),
            *("--no-zenoh", "--profile", "paper", "--rate", "20", "--seconds", str(seconds)),
            *options,
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), done.stderr


def test_beside_a_signed_vehicle_an_unsigned_one_is_refused_and_counted(key, tmp_path):
    port, log = free_port(socket.SOCK_DGRAM), tmp_path / "flight.tlog"
    to = f"udpout:127.0.0.1:{port}"
    other = tmp_path / "other key"
    other.write_text("wrong")
    with (
        started("sim", "--to", to, "--signing-key-file", str(key)),
        started("sim", "--to", to, "--vehicles", "2"),  # an unsigned 1 and an unsigned 2
        started("sim", "--to", to, "--signing-key-file", str(other)),
    ):
        result, said = run_service(port, "--signing-key-file", str(key), "--record", str(log))
    assert list(result["vehicles"]) == ["1"]
    assert result["vehicles"]["1"]["state"] == "running"
    assert result["vehicles"]["1"]["samples"] > 100
    assert result["refused"]["unsigned"] > 200
    assert result["refused"]["wrong_signature"] > 100
    assert "without a signature" in said
    state = (tmp_path / "state" / "fuzzbee" / "signing.json").read_text()
    secret = key.read_text()
    for text in (said, json.dumps(result), state, log.read_bytes().decode("latin-1")):
        assert secret not in text


def test_frames_of_before_a_restart_are_refused_after_it(key, tmp_path):
    port, log = free_port(socket.SOCK_DGRAM), tmp_path / "flight.tlog"
    to = f"udpout:127.0.0.1:{port}"
    with started("sim", "--to", to, "--signing-key-file", str(key), "--rate", "20"):
        before, _ = run_service(
            port, "--signing-key-file", str(key), "--record", str(log), seconds=3
        )
    assert before["vehicles"]["1"]["samples"] > 20
    with subprocess.Popen(
        [sys.executable, "-c", REPLAY, str(log), str(port)], env=dict(os.environ)
    ) as replay:
        try:
            after, _ = run_service(port, "--signing-key-file", str(key), seconds=3)
        finally:
            replay.kill()
    assert after["vehicles"] == {}
    assert after["refused"]["replayed"] > 20


REPLAY = """
import socket, sys, time
from pathlib import Path
from drivers.frames import FrameReader
data, frames, at = Path(sys.argv[1]).read_bytes(), [], 0
reader = FrameReader()
while at < len(data):  # stamp, frame, stamp, frame
    size = data[at + 9] + 12 + (13 if data[at + 10] & 1 else 0)
    frames.append(data[at + 8 : at + 8 + size])
    at += 8 + size
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
    while True:
        for frame in frames:
            sender.sendto(frame, ("127.0.0.1", int(sys.argv[2])))
            time.sleep(0.005)
"""


def test_only_allowed_systems_appear():
    port = free_port(socket.SOCK_DGRAM)
    with started("sim", "--to", f"udpout:127.0.0.1:{port}", "--vehicles", "3"):
        result, _ = run_service(port, "--allow-system-ids", "1,3", seconds=3)
    assert sorted(result["vehicles"]) == ["1", "3"]  # in the order of their appearance
    assert result["refused"]["system_not_allowed"] > 50


def test_lists_of_system_ids():
    assert parse_system_ids("1,2,10-12") == {1, 2, 10, 11, 12}
    for text in ("", "0", "256", "3-1", "a", "1,,2", "-1", "1-"):
        with pytest.raises(InputError, match="--allow-system-ids"):
            parse_system_ids(text)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["sim:", "--allow-system-ids", "1"], "--allow-system-ids is for a MAVLink link"),
        (["udpout:127.0.0.1:9", "--signing-key-file", "/no/such/key"], "cannot read the key file"),
    ],
)
def test_what_cannot_work_is_refused_at_the_start(arguments, said, capfd):
    assert main(["run", "--no-zenoh", *arguments]) == 2
    assert said in capfd.readouterr().err
