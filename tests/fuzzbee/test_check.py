"""``fuzzbee check``: one line a log, the worst first, an exit status for scripts; the sensors."""

import itertools
import json
import os
import shutil
import signal
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from pymavlink import mavutil

from drivers.mavlink.constants import mavlink
from fuzzbee.cli import main
from tests.fuzzbee.processes import FUZZBEE, begun, descendants, is_alive, started
from tests.fuzzbee.recording import TAKEOFF, G, rewritten, table


def check(capfd, *arguments):
    status = main(["check", *map(str, arguments)])
    out, err = capfd.readouterr()
    return status, out, err


@pytest.fixture(scope="module")
def season(tmp_path_factory):
    """A folder with a good flight, one whose autopilot is wrong, and a file that is no log."""
    folder = tmp_path_factory.mktemp("season")

    def rolled(_, message):
        if message.get_type() != "ATTITUDE":
            return None
        message.roll += 0.6
        return [message]

    shutil.copy(TAKEOFF, folder / "good.tlog")
    rewritten(TAKEOFF, folder / "wrong.tlog", rolled)
    (folder / "broken.tlog").write_bytes(b"not a log" * 100)
    return folder


def test_a_season_of_flights_begins_with_the_worst(capfd, season, printed):
    status, out, err = check(capfd, season)
    lines = out.splitlines()
    assert (status, len(lines), err) == (1, 3, "")
    assert "wrong.tlog: differs" in lines[0]
    assert "the autopilot's is likely wrong" in lines[0]
    (good,) = (line for line in lines if line.startswith(f"{season / 'good.tlog'}: "))
    assert "no difference" in good
    (broken,) = (line for line in lines[1:] if "broken.tlog: not checked" in line)
    assert broken.count("broken.tlog") == 1
    assert check(capfd, TAKEOFF)[0] == 0
    assert "autopilot differs" in printed("replay", season / "wrong.tlog")


def test_as_json(capfd, season):
    status, out, err = check(capfd, season / "wrong.tlog", season / "broken.tlog", "--json")
    wrong, broken = json.loads(out)["logs"]
    assert (status, err.count("\n")) == (1, 1)
    (first, *_) = wrong["differences"]
    assert first["inclination_deg"] == pytest.approx(34.4, abs=4.0)
    assert first["wrong"] == "autopilot"
    assert "no MAVLink frame" in broken["fault"]
    assert check(capfd, season / "broken.tlog")[0] == 2  # no success


def test_it_looks_at_the_part_that_is_asked_for(capfd, season):
    assert "no difference" in check(capfd, season / "wrong.tlog", "--to", "1")[1]
    status, out, _ = check(capfd, season / "wrong.tlog", "--from", "1e4")
    assert status == 2
    assert "the log lasts" in out


def test_a_bags_folder_is_one_log(capfd, tmp_path):
    """Its parts alone lack what its metadata hold, as that they are compressed."""
    bag, flight = tmp_path / "flights" / "bag", tmp_path / "flights" / "flight.tlog"
    bag.mkdir(parents=True)
    for file in (bag / "metadata.yaml", bag / "bag_0.db3", bag / "bag_1.db3", flight):
        file.write_bytes(b"content")
    status, out, _ = check(capfd, tmp_path, bag)
    assert status == 2
    named = sorted(line.partition(": ")[0] for line in out.splitlines())
    assert named == sorted(map(str, (bag, flight, bag)))


def test_a_run_warns_ground_stations_if_it_is_asked_to(season):
    """pymavlink's own connection listens, as a ground station does."""
    peer = mavutil.mavlink_connection("udpin:127.0.0.1:0", dialect="ardupilotmega")
    url = f"udpout:127.0.0.1:{peer.port.getsockname()[1]}"
    options = ["--speed", "20", "--no-zenoh", "--announce", url, "--send-attitude", url]
    got = []
    with closing(peer), started("run", str(season / "wrong.tlog"), *options) as process:
        # a busy computer may be silent in the middle
        while (m := peer.recv_match(blocking=True, timeout=0.5)) or process.poll() is None:
            got += [m] if m else []
        assert process.wait(60) == 0
    first = next(m for m in got if m.get_type() == "STATUSTEXT")
    assert first.text.startswith("autopilot horizon ")
    assert (first.get_srcComponent(), first.severity) == (191, mavutil.mavlink.MAV_SEVERITY_WARNING)
    # one sender, whose frames are numbered without a gap
    numbers = [m.get_seq() for m in got]
    assert all((b - a) % 256 == 1 for a, b in itertools.pairwise(numbers))


def test_an_interrupt_of_all_processes_ends_them_without_a_word():
    """As at a terminal's end, or by its Ctrl-C: there had been a traceback of each of them."""
    process = begun(*FUZZBEE, "check", *[TAKEOFF] * 8, start_new_session=True)
    while not (workers := [p for p in descendants(process.pid) if is_worker(p)]):
        assert process.poll() is None
    os.killpg(process.pid, signal.SIGHUP)
    _, output = process.communicate(timeout=60)
    assert (process.returncode, output) == (128 + signal.SIGHUP, "")
    assert not any(map(is_alive, workers))


def is_worker(process):
    """One that has begun to import."""
    try:
        is_ours = b"spawn_main" in Path(f"/proc/{process}/cmdline").read_bytes()
        return is_ours and "numpy" in Path(f"/proc/{process}/maps").read_text()
    except OSError:
        return False


RATE_HZ, SECONDS = 400.0, 40.0
TONE_HZ, CORNER_HZ = 40.0, 5.0


def shaken(folder, amplitude_m_s2, rate_hz=RATE_HZ, clip_rad_s=np.inf, tone_hz=TONE_HZ):
    """A vehicle at rest that shakes along its y axis, and turns for a moment."""
    t = np.arange(0.0, SECONDS, 1.0 / rate_hz)
    rng = np.random.default_rng(3)
    gyr, acc = 0.01 * rng.normal(size=(len(t), 3)), 0.05 * rng.normal(size=(len(t), 3))
    acc[:, 2] -= G
    acc[:, 1] += amplitude_m_s2 * np.sin(2.0 * np.pi * tone_hz * t)
    gyr[:, 2] += 8.0 * np.sin(2.0 * np.pi * 0.5 * t) * (t > 20.0) * (t < 24.0)
    rows = np.column_stack([gyr.clip(-clip_rad_s, clip_rad_s), acc / G]).round(7)
    return table(folder / "shaken.csv", rate_hz, rows.tolist())


@pytest.fixture
def checked(reported):
    def one_log(*arguments):
        (log,) = reported("check", *arguments)["logs"]
        return log

    return one_log


@pytest.mark.parametrize(
    ("amplitude", "tone_hz", "verdict", "ripple"),
    [
        (5.0, TONE_HZ, "usual", 0.08),
        (55.0, TONE_HZ, "high", 0.08),
        (120.0, TONE_HZ, "too high", 0.08),
        (20.0, 8.0, "usual", 0.15),  # near the corner a tone counts less
    ],
)
def test_vibration_is_a_high_passed_tone(tmp_path, checked, amplitude, tone_hz, verdict, ripple):
    """A tone's root mean square behind a first-order high-pass is known; 2 Hz leave a ripple."""
    found = checked(shaken(tmp_path, amplitude, tone_hz=tone_hz))["vibration"]
    wanted = amplitude / np.sqrt(2.0) * tone_hz / np.hypot(tone_hz, CORNER_HZ)
    assert found["m_s2"][1] == pytest.approx(wanted, rel=ripple)
    assert found["m_s2"][0] < 0.1
    assert found["verdict"] == verdict


def test_the_line_names_limits_and_clipping_and_a_slow_stream_has_none(tmp_path, capfd, checked):
    assert checked(shaken(tmp_path, 5.0, rate_hz=10.0))["vibration"] is None
    path = shaken(tmp_path, 55.0, clip_rad_s=5.0)
    assert checked(path)["clipped"]["gyroscope"] > 10
    status, line, _ = check(capfd, path)
    assert (status, line.count("\n")) == (0, 1)
    for words in ("vibration high, ", "usual: under 30, a problem: over 60", "gyroscope clipped "):
        assert words in line


def with_vibration(folder, autopilot=3, restarts=False):
    """A flight whose autopilot measures vibration, and clips ten times a second."""

    def change(seconds, message):
        if message.get_type() == "VIBRATION":
            return []
        if message.get_type() == "HEARTBEAT":
            message.autopilot = autopilot
            return [message]
        if message.get_type() != "RAW_IMU":
            return None
        since = seconds - 5.0 if restarts and seconds > 5.0 else seconds
        clips = 7 + int(10.0 * since)
        return [message, mavlink().MAVLink_vibration_message(0, 12.0, 40.0, 5.0, clips, 2, 0)]

    return rewritten(TAKEOFF, folder / "flight.tlog", change)


def test_what_the_autopilot_has_measured_stands_beside_it(tmp_path, capfd, checked):
    path = with_vibration(tmp_path)
    found = checked(path)["autopilot_vibration"]
    assert found["m_s2"] == [12.0, 40.0, 5.0]
    assert (found["message"], found["imu"], found["verdict"]) == ("VIBRATION", 0, "high")
    seconds = found["clipped"]["0"] / 10.0
    assert found["clipped"] == {"0": pytest.approx(10.0 * seconds), "1": 0, "2": 0}
    assert seconds > 20.0
    _, line, _ = check(capfd, path)
    assert "the autopilot's VIBRATION high, 40.0 m/s² (usual: under 30, a problem" in line
    assert f"VIBRATION counts: {found['clipped']['0']} by IMU 1 (usual: under 100)" in line
    part = checked(path, "--from", "4", "--to", "8")["autopilot_vibration"]
    assert part["clipped"]["0"] == pytest.approx(40, abs=4)


def test_a_restart_sets_the_count_of_clipping_back_and_px4_has_other_units(tmp_path, checked):
    steady, restarted, px4 = (
        checked(with_vibration(tmp_path, **options))["autopilot_vibration"]
        for options in ({}, {"restarts": True}, {"autopilot": 12})
    )
    assert restarted["clipped"]["0"] == pytest.approx(steady["clipped"]["0"] + 7, abs=1)
    assert (px4["m_s2"], px4["verdict"]) == (None, None)
    assert px4["clipped"]["0"] > 100
