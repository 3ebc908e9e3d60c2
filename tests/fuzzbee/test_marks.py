"""Modes, arming and the autopilot's warnings on a replay's figure."""

from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from fuzzbee.cli import main
from tests.drivers.logs.test_dataflash import Writer
from tests.fuzzbee.tlogs import rewritten

TAKEOFF = Path(__file__).parent.parent / "data" / "sitl_copter_takeoff.tlog"
MODES = {0: "STABILIZE", 5: "LOITER", 6: "RTL"}  # of ArduCopter


def said_at(log, made, words):
    """A telemetry log's copy with what the autopilot says at seconds of the stamps: messages."""
    waiting = sorted(words.items())

    def change(seconds, message):
        due = [words for at_s, words in waiting if at_s <= seconds]
        del waiting[: len(due)]
        kept = [] if message.get_type() == "HEARTBEAT" else [message]
        return [*due, *kept] if due or not kept else None

    return rewritten(log, made, change)


def beat(mode, *, is_armed):
    return dialect.MAVLink_heartbeat_message(2, 3, 1 + 128 * is_armed, mode, 4, 3)


def text(severity, words):
    return dialect.MAVLink_statustext_message(severity, words.encode())


def page_of(log, folder, *options):
    page = folder / "flight.html"
    assert main(["replay", str(log), "--plot", str(page), "--json", *options]) == 0
    return page.read_text()


def test_modes_arming_and_warnings_are_named(tmp_path, capsys):
    pytest.importorskip("plotly")
    words = {
        0.5: beat(0, is_armed=False),
        3.0: beat(0, is_armed=True),
        5.0: beat(5, is_armed=True),
        6.0: text(4, "EKF variance"),
        6.5: text(6, "mission begins"),  # for information
        8.0: beat(6, is_armed=False),
    }
    page = page_of(said_at(TAKEOFF, tmp_path / "said.tlog", words), tmp_path)
    for name in ("STABILIZE", "LOITER", "RTL", "armed", "disarmed", "EKF variance"):
        assert f'"text":"{name}"' in page
    assert "mission begins" not in page


def test_a_window_begins_with_the_mode_that_the_vehicle_is_in(tmp_path, capsys):
    pytest.importorskip("plotly")
    words = {0.5: beat(0, is_armed=True), 3.0: beat(5, is_armed=True), 8.0: beat(6, is_armed=True)}
    log = said_at(TAKEOFF, tmp_path / "said.tlog", words)
    page = page_of(log, tmp_path, "--from", "5")
    assert '"text":"LOITER"' in page
    assert '"text":"STABILIZE"' not in page


def test_a_dataflash_log_has_modes(tmp_path, capsys):
    pytest.importorskip("plotly")
    writer = Writer()
    writer.format("MSG", "QZ", "TimeUS,Message")
    writer.format("MODE", "QBB", "TimeUS,Mode,ModeNum")
    writer.format("IMU", "QffffffB", "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,I")
    writer.write("MSG", 10_000_000, "ArduCopter V4.5.0")
    for k in range(400):
        us = 10_000_000 + 10_000 * k
        if k in (100, 200):
            writer.write("MODE", us, 5 if k == 100 else 6, 5 if k == 100 else 6)
        writer.write("IMU", us, 0.01 * (k % 7), 0.01, 0.0, 0.1, 0.02 * (k % 5), -9.8, 0)
    page = page_of(writer.save(tmp_path), tmp_path)
    assert '"text":"LOITER"' in page
    assert '"text":"RTL"' in page
