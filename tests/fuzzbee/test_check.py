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


@pytest.fixture(scope="module")
def season(tmp_path_factory):
    """A folder with a good flight, one whose autopilot is wrong, and a file that is no log."""
    folder = tmp_path_factory.mktemp("season")
    shutil.copy(GOOD, folder / "good.tlog")
    with_wrong_attitudes(GOOD, folder / "wrong.tlog")
    (folder / "broken.tlog").write_bytes(b"not a log" * 100)
    return folder


def test_a_season_of_flights_begins_with_the_worst(capsys, season):
    status, out, err = check(capsys, season)
    lines = out.splitlines()
    assert (status, len(lines), err) == (1, 3, "")
    assert "wrong.tlog: differs" in lines[0]
    assert "the autopilot's is likely wrong" in lines[0]
    (good,) = (line for line in lines if line.startswith(f"{season / 'good.tlog'}: "))
    assert "no difference" in good
    (broken,) = (line for line in lines[1:] if "broken.tlog: not checked" in line)
    assert broken.count("broken.tlog") == 1
    assert check(capsys, GOOD)[0] == 0


def test_as_json(capsys, season):
    status, out, err = check(capsys, season / "wrong.tlog", season / "broken.tlog", "--json")
    wrong, broken = json.loads(out)["logs"]
    assert (status, err.count("\n")) == (1, 1)
    (first, *_) = wrong["differences"]
    assert first["inclination_deg"] == pytest.approx(34.4, abs=4.0)
    assert first["wrong"] == "autopilot"
    assert "no MAVLink frame" in broken["fault"]
    assert check(capsys, season / "broken.tlog")[0] == 2  # no success


@pytest.mark.parametrize("given", ["missing.tlog", "."])
def test_nothing_to_check(capsys, tmp_path, monkeypatch, given):
    monkeypatch.chdir(tmp_path)
    status, out, err = check(capsys, given)
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1


def test_a_bags_folder_is_one_log(capsys, tmp_path):
    """Its parts alone lack what its metadata hold, as that they are compressed."""
    bag, flight = tmp_path / "flights" / "bag", tmp_path / "flights" / "flight.tlog"
    bag.mkdir(parents=True)
    for file in (bag / "metadata.yaml", bag / "bag_0.db3", bag / "bag_1.db3", flight):
        file.write_bytes(b"content")
    status, out, _ = check(capsys, tmp_path, bag)
    assert status == 2
    named = sorted(line.partition(": ")[0] for line in out.splitlines())
    assert named == sorted(map(str, (bag, flight, bag)))


def test_replay_lists_them(capsys, season):
    assert main(["replay", str(season / "wrong.tlog")]) == 0
    assert "autopilot differs" in capsys.readouterr().out


@contextmanager
def received(peer):
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


def test_a_run_warns_ground_stations_if_it_is_asked_to(season):
    """pymavlink's own connection listens, as a ground station does."""
    peer = mavutil.mavlink_connection("udpin:127.0.0.1:0", dialect="ardupilotmega")
    url = f"udpout:127.0.0.1:{peer.port.getsockname()[1]}"
    options = ["--speed", "20", "--no-zenoh", "--announce", url, "--send-attitude", url]
    with received(peer) as got:
        assert main(["run", str(season / "wrong.tlog"), *options]) == 0
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
    _, output = process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGHUP
    assert output == ""
    assert not any(map(is_alive, workers))


def is_worker(process):
    """One that has begun to import."""
    try:
        is_ours = b"spawn_main" in Path(f"/proc/{process}/cmdline").read_bytes()
        return is_ours and "numpy" in Path(f"/proc/{process}/maps").read_text()
    except OSError:
        return False
