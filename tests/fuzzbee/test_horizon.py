"""The screen of one vehicle: as lines of characters, and in a real terminal over real Zenoh."""

import io
import math
import re
from pathlib import Path

import msgspec
import pytest
from rich.console import Console, Group

from estimator.geometry.frames import from_euler_rad
from estimator.geometry.quaternion import rotate_inverse
from fuzzbee.cli import main
from fuzzbee.horizon import Ink, screen
from fuzzbee.table_model import Row
from fuzzbee.terminal import PersonConsole, TerminalView
from service.health import State
from service.records import Message, Published, StatusRecord
from tests.fuzzbee.processes import default_session, free_port, started
from tests.service.records import differing, record

FLIPS = Path(__file__).parents[1] / "data" / "sitl_copter_flips.tlog"
STATUS = StatusRecord("running", "RAW_IMU", 49.8, 0.1, {}, 0, 0, 3)
PLAIN = Ink(colours=0)
SKY, GROUND, HAZE, LINE = " ", "░", "▒", "█▀▄"


def seen(attitude, state=State.RUNNING, status=STATUS, *, is_silent=False):
    """A row of the table model, and the time when it is looked at."""
    now_s = 104.0 if is_silent else 100.0
    said = status and msgspec.structs.replace(status, state=state.value)
    if attitude is not None:
        attitude = msgspec.structs.replace(attitude, state=state.value)
    return Row("1", attitude, said, 100.0, 100.0, status), now_s


def plain(shown, width=80, height=23, ink=PLAIN):
    return [line.plain for line in screen(*shown, width, height, ink)]


def at(lines, right, down, height=23):
    """The character so many cells from the middle of the horizon: below three lines, above four."""
    middle = 3 + (height - 3 - 4) // 2
    return lines[middle + down][40 + right]


@pytest.mark.parametrize("roll_deg", [-160.0, -90.0, -45.0, 0.0, 12.0, 60.0, 90.0, 180.0])
@pytest.mark.parametrize("pitch_deg", [-15.0, 0.0, 15.0])
def test_ground_is_where_a_pilot_sees_it(roll_deg, pitch_deg):
    """Down in the body's own axes; a cell is twice as high as wide."""
    attitude = record(roll_deg, pitch_deg, 40.0)
    q = from_euler_rad(math.radians(roll_deg), math.radians(pitch_deg), 0.0)
    _, right, down = rotate_inverse(q, (0.0, 0.0, 1.0))
    size = math.hypot(right, down)
    lines = plain(seen(attitude))
    for side, expected in ((1, GROUND), (-1, SKY)):
        far = 6.0
        found = {
            at(
                lines,
                round(2.0 * (side * far * right - across * down) / size),
                round((side * far * down + across * right) / size),
            )
            for across in (-3.5, 3.5)  # beside the rungs
        }
        assert expected in found, "\n".join(lines)


@pytest.mark.parametrize(("pitch_deg", "rows"), [(15.0, 4), (0.0, 0), (-15.0, -4), (80.0, 7)])
def test_the_line_is_below_the_middle_as_the_nose_is_up_and_never_out_of_sight(pitch_deg, rows):
    lines = plain(seen(record(pitch_deg=pitch_deg)))
    found = [row for row in range(-8, 8) if at(lines, 35, row) in LINE]
    assert found
    assert sum(found) / len(found) == pytest.approx(rows, abs=1.1)


@pytest.mark.parametrize("sigma_deg", [4.0, 9.0, 20.0])
def test_the_haze_is_as_high_as_sigma(sigma_deg):
    lines = plain(seen(record(sigma_deg=(sigma_deg, 1.0))))
    column = [at(lines, 35, row) for row in range(-8, 8)]
    high = sum(cell == HAZE or cell in LINE for cell in column)
    assert high == pytest.approx(min(16, 2 * sigma_deg * 16 / 60), abs=1.5)
    assert f"horizon ±{sigma_deg:.1f}°" in "\n".join(lines) or f"±{sigma_deg:.0f}°" in lines[-3]


def test_the_tape_shows_how_uncertain_the_heading_is():
    lines = plain(seen(record(yaw_deg=200.0, sigma_deg=(1.0, 15.0))))
    assert lines[2].count("━") + lines[2].count("▲") == 1 + 2 * round(15.0 / 2.5)
    assert lines[2].index("▲") == 40
    assert " 200° " in lines[1]
    assert lines[1].index("S ") < 40 < lines[1].index("SW")


def test_a_heading_that_refers_to_nothing_names_no_direction():
    relative = msgspec.structs.replace(record(yaw_deg=90.0), heading_reference="none")
    lines = plain(seen(relative))
    assert "(090°)" in lines[1]
    assert not set("NESW") & set(lines[1])
    assert "no north" in "\n".join(lines[-4:])
    assert "CARE" in lines[0]
    assert "E" in plain(seen(record(yaw_deg=90.0)))[1] or "090°" in lines[1]


@pytest.mark.parametrize(
    ("shown", "words"),
    [
        (seen(None, State.LOST), ("lost", "NO ATTITUDE", "IMU silent")),
        (seen(None, State.WAITING), ("waiting", "NO ATTITUDE", "waiting for IMU data")),
        (seen(record(), is_silent=True), ("silent", "NO ATTITUDE", "the service is silent")),
    ],
)
def test_without_a_valid_attitude_there_is_a_cross_and_no_number(shown, words):
    lines = plain(shown)
    text = "\n".join(lines)
    for word in words:
        assert word in text
    assert text.count("╳") > 8
    assert GROUND not in text
    assert not re.search(r"(roll|pitch) [+-]\d", text)


@pytest.mark.parametrize(
    ("shown", "word"),
    [
        (seen(record(sigma_deg=(0.5, 2.0))), "TRUST"),
        (seen(record(sigma_deg=(5.0, 2.0))), "CARE"),
        (seen(record(sigma_deg=(25.0, 2.0))), "DO NOT TRUST"),
        (
            seen(record(), status=msgspec.structs.replace(STATUS, warnings=("bias_at_limit",))),
            "DO NOT TRUST",
        ),
        (seen(record(), status=msgspec.structs.replace(STATUS, overloaded=True)), "TRUST"),
    ],
)
def test_one_word_sums_up(shown, word):
    assert re.search(rf"  {word}  ", plain(shown)[0])


@pytest.mark.parametrize(("width", "height"), [(40, 12), (80, 23), (81, 24), (200, 60)])
@pytest.mark.parametrize("ink", [Ink(), Ink(16), Ink(0), Ink(0, unicode=False)])
@pytest.mark.parametrize(
    "attitude",
    [record(12.0, -5.0, 359.9), record(170.0, 88.0, 0.1, sigma_deg=(180.0, 180.0)), None],
)
def test_it_fills_the_window_and_no_more(attitude, ink, width, height):
    state = State.RUNNING if attitude else State.LOST
    lines = plain(seen(attitude, state), width, height, ink)
    assert len(lines) == height
    assert all(len(line) <= width for line in lines)
    if not ink.unicode:
        assert set("".join(lines)) <= set(map(chr, range(32, 127))) | {"°", "±"}


def test_nothing_is_said_by_colour_alone():
    """Without colours the characters tell sky, ground, haze and line apart."""
    text = "\n".join(plain(seen(record(10.0, 0.0, 0.0, sigma_deg=(6.0, 1.0)))))
    for character in (GROUND, HAZE, "▀"):
        assert character in text


def written(monkeypatch, shown, **environment):
    for name in ("NO_COLOR", "COLORTERM", "TTY_COMPATIBLE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("FORCE_COLOR", "1")  # what is written into is no terminal
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    console = PersonConsole()
    out = console.file = io.StringIO()
    view = TerminalView(console, console, "title", now_s=lambda: 0.0)
    view.one = "1"
    for output in shown:
        view.handle([output])
    view.close()
    return out.getvalue()


def outputs():
    from drivers.events import VehicleId

    return [Published(VehicleId(1, 1), r) for r in (record(12.0), STATUS)] + [Message("a word")]


def test_no_color_leaves_no_style_at_all(monkeypatch):
    styled = re.compile(r"\x1b\[[0-9;]*m")
    assert styled.search(written(monkeypatch, outputs()))
    bare = written(monkeypatch, outputs(), NO_COLOR="1")
    assert "roll" in bare
    assert not styled.search(bare)


def test_a_dumb_terminal_gets_lines(monkeypatch):
    text = written(monkeypatch, outputs(), TERM="dumb")
    assert "\x1b" not in text
    assert re.search(r"1  running\s+roll\s+\+12\.0", text)


def test_colours_are_as_many_as_the_terminal_has():
    lines = screen(*seen(record(10.0, sigma_deg=(6.0, 1.0))), 80, 23, Ink(16))
    console = Console(file=io.StringIO(), force_terminal=True, color_system="standard", width=80)
    console.print(Group(*lines))
    assert "\x1b[48" not in console.file.getvalue()
    assert "\x1b[44m" in console.file.getvalue() or ";44m" in console.file.getvalue()


@pytest.mark.parametrize("name", ["copter", "1-", "*", "1/2", "1000", "0", "256", "1-300"])
def test_a_name_that_is_no_vehicle_is_status_2(name, capfd):
    assert main(["watch", name, *default_session(free_port())]) == 2
    assert "should be a vehicle" in capfd.readouterr().err


def test_a_flight_in_a_real_terminal():
    """80x24, a smaller window, a larger one, all vehicles, the end."""
    emulator = pytest.importorskip("tests.fuzzbee.emulator", reason="pyte is not installed")
    session = default_session(free_port())
    with (
        started("run", str(FLIPS), *session),
        emulator.terminal("watch", "1", *session) as terminal,
    ):
        # it may have to compile first
        terminal.wait_for(lambda lines: any("TRUST" in line for line in lines), 180.0)
        terminal.wait_for(lambda lines: any("horizon ±" in line for line in lines))
        for columns, rows in ((80, 24), (60, 16), (100, 30)):
            terminal.resize(columns, rows)
            terminal.wait_for(lambda lines, n=columns: is_whole(lines, n), 10.0)
        # a real terminal breaks up what was drawn: it must be wiped out
        assert terminal.written.count(b"\x1b[2J") == 3  # and once for one vehicle
        terminal.press("\x1b")
        terminal.wait_for(lambda lines: any("tilt ±" in line for line in lines), 10.0)
        terminal.press("q")
        terminal.read(5.0)
        assert terminal.process.wait(60) == 0


def is_whole(lines, columns):
    """One bar, one row of figures and one tape: nothing is left of another size."""
    text = "\n".join(lines)
    bars = [line for line in lines if "vehicle 1" in line]
    return (
        len(bars) == 1
        and text.count("pitch") == 1
        and text.count("▲") == 1
        and abs(text.split("\n")[lines.index(bars[0]) + 2].index("▲") - columns // 2) <= 1
    )


@pytest.mark.parametrize(("ink", "mark"), [(PLAIN, "◆"), (Ink(0, unicode=False), "A")])
def test_an_autopilot_that_differs_is_marked_where_it_says_that_horizon_and_heading_are(ink, mark):
    """A dotted line with its own roll and pitch, or a mark on the tape; and by how much."""
    tilted = seen(record(), status=differing("inclination", 28.0, roll_deg=-20.0, pitch_deg=10.0))
    lines = plain(tilted, ink=ink)
    down = {
        x: n for n, line in enumerate(lines[3:]) for x, letter in enumerate(line) if letter == mark
    }
    assert len(down) > 10
    left, right = min(down), max(down)
    # rows are as high as two cells are wide
    slope = 2.0 * (down[right] - down[left]) / (right - left)
    assert math.degrees(math.atan(slope)) == pytest.approx(20.0, abs=2.0)
    assert "autopilot horizon 28° off" in lines[-2]
    turned = plain(seen(record(), status=differing("heading", 25.0)), ink=ink)
    assert turned[2].index(mark) - 40 == 10
    assert "autopilot heading 25° off" in turned[-2]
    assert mark not in "".join(plain(seen(record()), ink=ink)[2:-4])
