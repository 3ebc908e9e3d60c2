"""``fuzzbee check``: one line a log, the worst first, and an exit status for scripts."""

import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

import pytest
from pymavlink import mavutil

from fuzzbee.check import _files
from fuzzbee.cli import main
from tests.fuzzbee.services import descendants, is_alive
from tests.fuzzbee.tlogs import rewritten

DATA = Path(__file__).parent.parent / "data"
GOOD = DATA / "sitl_copter_takeoff.tlog"
ROLL_OFF_RAD = 0.6


def with_wrong_attitudes(log, made):
    """A telemetry log's copy in which every ATTITUDE has another roll."""

    def change(_, message):
        if message.get_type() != "ATTITUDE":
            return None
        message.roll += ROLL_OFF_RAD
        return [message]

    rewritten(log, made, change)


def check(capsys, *arguments):
    status = main(["check", *map(str, arguments)])
    out, err = capsys.readouterr()
    return status, out, err


def test_a_good_log(capsys):
    status, out, _ = check(capsys, GOOD)
    assert status == 0
    assert "no difference" in out


@pytest.fixture
def season(tmp_path):
    """A folder with a good flight, one whose autopilot is wrong, and a file that is no log."""
    shutil.copy(GOOD, tmp_path / "good.tlog")
    with_wrong_attitudes(GOOD, tmp_path / "wrong.tlog")
    (tmp_path / "broken.tlog").write_bytes(b"not a log" * 100)
    return tmp_path


def test_a_season_of_flights_begins_with_the_worst(capsys, season):
    status, out, err = check(capsys, season)
    lines = out.splitlines()
    assert status == 1
    assert len(lines) == 3
    assert "wrong.tlog: differs" in lines[0]
    assert "the autopilot's is likely wrong" in lines[0]
    (broken,) = (line for line in lines[1:] if "broken.tlog: not checked" in line)
    assert broken.count("broken.tlog") == 1
    assert err == ""


def test_as_json(capsys, season):
    status, out, _ = check(capsys, season / "wrong.tlog", "--json")
    (log,) = json.loads(out)["logs"]
    assert status == 1
    (first, *_) = log["differences"]
    assert first["inclination_deg"] == pytest.approx(34.4, abs=4.0)
    assert first["wrong"] == "autopilot"


def test_a_log_that_cannot_be_read_is_no_success(capsys, season):
    status, out, err = check(capsys, season / "broken.tlog", "--json")
    assert status == 2
    assert "no MAVLink frame" in json.loads(out)["logs"][0]["fault"]
    assert err.count("\n") == 1


@pytest.mark.parametrize("given", ["missing.tlog", "."])
def test_nothing_to_check(capsys, tmp_path, monkeypatch, given):
    monkeypatch.chdir(tmp_path)
    status, out, err = check(capsys, given)
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1


def test_a_bags_folder_is_one_log(tmp_path):
    """Its parts alone lack what its metadata say, as that they are compressed."""
    bag, flight = tmp_path / "flights" / "bag", tmp_path / "flights" / "flight.tlog"
    bag.mkdir(parents=True)
    for file in (bag / "metadata.yaml", bag / "bag_0.db3", bag / "bag_1.db3", flight):
        file.write_bytes(b"content")
    assert [*_files([tmp_path])] == [bag, flight]
    assert [*_files([bag])] == [bag]


def test_replay_lists_them(capsys, season):
    assert main(["replay", str(season / "wrong.tlog")]) == 0
    assert "autopilot differs" in capsys.readouterr().out


@contextmanager
def heard(peer):
    """What a peer is sent meanwhile; unread, a socket's buffer would soon be full."""
    got, ended = [], threading.Event()

    def listen():
        while (message := peer.recv_match(blocking=True, timeout=0.5)) or not ended.is_set():
            got.extend([message] if message else [])

    listener = threading.Thread(target=listen)
    listener.start()
    try:
        yield got
    finally:
        ended.set()
        listener.join()
        peer.close()


def test_a_run_tells_ground_stations_if_it_is_asked_to(tmp_path):
    """pymavlink's own connection listens, as a ground station does."""
    wrong = tmp_path / "wrong.tlog"
    with_wrong_attitudes(GOOD, wrong)
    peer = mavutil.mavlink_connection("udpin:127.0.0.1:0", dialect="ardupilotmega")
    url = f"udpout:127.0.0.1:{peer.port.getsockname()[1]}"
    options = ["--speed", "20", "--no-zenoh", "--announce", url, "--send-attitude", url]
    with heard(peer) as got:
        assert main(["run", str(wrong), *options]) == 0
    first = next(m for m in got if m.get_type() == "STATUSTEXT")
    assert first.text.startswith("autopilot horizon ")
    assert (first.get_srcComponent(), first.severity) == (191, mavutil.mavlink.MAV_SEVERITY_WARNING)
    # one sender, whose frames are numbered without a gap
    numbers = [m.get_seq() for m in got]
    assert all((b - a) % 256 == 1 for a, b in itertools.pairwise(numbers))


def test_an_interrupt_of_all_processes_ends_them_without_a_word():
    """As at a terminal's end, or by its Ctrl-C: there had been a traceback of each of them."""
    logs = [str(GOOD)] * 8
    process = subprocess.Popen(
        [sys.executable, "-m", "fuzzbee", "check", *logs],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    while not (workers := [p for p in descendants(process.pid) if is_worker(p)]):
        assert process.poll() is None
    os.killpg(process.pid, signal.SIGHUP)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGHUP
    assert said == ""
    assert not any(map(is_alive, workers))


def is_worker(process):
    """One that has begun to import."""
    try:
        is_ours = b"spawn_main" in Path(f"/proc/{process}/cmdline").read_bytes()
        return is_ours and "numpy" in Path(f"/proc/{process}/maps").read_text()
    except OSError:
        return False
