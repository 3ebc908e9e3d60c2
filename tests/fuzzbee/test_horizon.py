"""The screen of one vehicle: as lines of characters, and in a real terminal over real Zenoh."""

import io
import math
import re

import pytest
from msgspec.structs import replace

from estimator.geometry.frames import from_euler_rad
from estimator.geometry.quaternion import rotate_inverse
from fuzzbee.terminal import PersonConsole, TerminalView
from service.records import Message
from tests.fuzzbee.processes import default_session, started
from tests.fuzzbee.recording import FLIPS
from tests.fuzzbee.screen import terminal, vehicle
from tests.service.records import differing, record

SKY, GROUND, HAZE, LINE = " ", "░", "▒", "█▀▄"
# Nothing has longer figures.
UNKNOWN = replace(record(-170, 88, 0.1, sigma_deg=(180, 180)), heading_reference="magnetic")


def horizon(attitude=None, width=80, height=24, encoding="utf-8", **changes):
    """One vehicle on a terminal without colours; the cells right and down of the middle."""
    shown = vehicle("1", attitude or record(), **changes)
    return terminal(shown, width=width, height=height, one="1", encoding=encoding)


def at(lines, right, down):
    """The character so many cells from the middle of the horizon: below three lines, above four."""
    return f"{lines[3 + (23 - 3 - 4) // 2 + down]:80}"[40 + right]


@pytest.mark.parametrize("roll_deg", [-160.0, -90.0, -45.0, 0.0, 12.0, 60.0, 90.0, 180.0])
@pytest.mark.parametrize("pitch_deg", [-15.0, 0.0, 15.0])
def test_ground_is_where_a_pilot_sees_it(roll_deg, pitch_deg):
    """Down in the body's own axes; a cell is twice as high as wide."""
    q = from_euler_rad(math.radians(roll_deg), math.radians(pitch_deg), 0.0)
    _, right, down = rotate_inverse(q, (0.0, 0.0, 1.0))
    size = math.hypot(right, down)
    lines = horizon(record(roll_deg, pitch_deg, 40.0))
    for far, expected in ((6.0, GROUND), (-6.0, SKY)):
        places = [  # beside the rungs
            (2.0 * (far * right - across * down) / size, (far * down + across * right) / size)
            for across in (-3.5, 3.5)
        ]
        assert expected in {at(lines, *map(round, each)) for each in places}, "\n".join(lines)


@pytest.mark.parametrize(("pitch_deg", "rows"), [(15, 4), (0, 0), (-15, -4), (80, 7), (-80, -7)])
def test_the_line_is_below_the_middle_as_the_nose_is_up_and_never_out_of_sight(pitch_deg, rows):
    lines = horizon(record(pitch_deg=pitch_deg))
    found = [row for row in range(-8, 8) if at(lines, 35, row) in LINE]
    assert sum(found) / len(found) == pytest.approx(rows, abs=1.1)


@pytest.mark.parametrize("sigma_deg", [4.0, 9.0, 20.0])
def test_the_haze_is_as_high_as_sigma(sigma_deg):
    lines = horizon(record(sigma_deg=(sigma_deg, 1.0)))
    column = [at(lines, 35, row) for row in range(-8, 8)]
    high = sum(cell == HAZE or cell in LINE for cell in column)
    assert high == pytest.approx(min(16, 2 * sigma_deg * 16 / 60), abs=1.5)
    assert f"horizon ±{sigma_deg:.1f}°" in "\n".join(lines) or f"±{sigma_deg:.0f}°" in lines[20]


@pytest.mark.parametrize(("roll_deg", "column"), [(0.0, 40), (30.0, 32), (-60.0, 53), (100.0, 25)])
def test_the_scale_of_bank_has_a_pointer_at_the_zenith_s_side(roll_deg, column):
    """Ticks at 0, 10, 20, 30, 45 and 60 degrees on either side, of which it hides one."""
    lines = horizon(record(roll_deg))
    (found,) = [line.index("▼") for line in lines if "▼" in line]
    assert found == pytest.approx(column, abs=1)
    assert sum(line.count("·") for line in lines) >= 10


def test_mode_and_arming_stand_in_the_lower_left():
    for state in ("running", "lost"):
        lines = horizon(state=state, mode="LOITER", armed=False)
        assert "LOITER  disarmed" in lines[18], "\n".join(lines)
    assert "armed" not in "".join(horizon())


def test_rungs_of_the_ladder_have_signs_and_the_first_row_is_left_to_the_scale_of_bank():
    shown = {pitch_deg: horizon(record(pitch_deg=float(pitch_deg))) for pitch_deg in range(-60, 61)}
    assert all(rung in "\n".join(shown[-5]) for rung in ("─10─", "─-20─"))
    assert not [pitch_deg for pitch_deg, lines in shown.items() if "─" in lines[3]]


@pytest.mark.parametrize(("sigma_deg", "cells"), [(0.3, 1), (15.0, 6), (180.0, 39)])
def test_the_tape_shows_how_uncertain_the_heading_is(sigma_deg, cells):
    """At least beside the mark, which would hide a small one."""
    lines = horizon(record(yaw_deg=200.0, sigma_deg=(1.0, sigma_deg)))
    assert lines[2][40 - cells : 41 + cells] == "━" * cells + "▲" + "━" * cells
    assert lines[2][:40].strip() == "━" * min(40, round(max(2.5, sigma_deg) / 2.5))
    assert lines[2].index("▲") == 40
    assert " 200° " in lines[1]
    assert lines[1].index("S ") < 40 < lines[1].index("SW")


def test_a_heading_that_refers_to_nothing_names_no_direction():
    lines = horizon(replace(record(yaw_deg=90.0), heading_reference="none"))
    assert "(090°)" in lines[1]
    assert not set("NESW") & set(lines[1])
    assert "no north" in "\n".join(lines[-4:])
    assert "CARE" in lines[0]


@pytest.mark.parametrize(
    ("state", "after_s", "word", "reason"),
    [
        ("lost", 0.0, "lost", "IMU silent"),
        ("waiting", 0.0, "waiting", "waiting for IMU data"),
        ("running", 4.0, "silent", "the service is silent"),
    ],
)
def test_without_a_valid_attitude_there_is_a_cross_and_no_number(state, after_s, word, reason):
    text = "\n".join(terminal(vehicle(state=state), one="1", after_s=after_s))
    assert all(each in text for each in (word, "NO ATTITUDE", reason))
    assert text.count("╳") > 8
    assert GROUND not in text
    assert not re.search(r"(roll|pitch) [+-]\d", text)


@pytest.mark.parametrize(("width", "height"), [(40, 13), (80, 24), (81, 25), (200, 61)])
@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
@pytest.mark.parametrize("attitude", [record(12, -5, 359.9), UNKNOWN, None])
def test_it_fills_the_window_in_the_terminal_s_own_letters(attitude, encoding, width, height):
    state = "running" if attitude else "lost"
    lines = horizon(attitude, width, height, encoding, state=state, mode="AUTO", armed=True)
    assert lines[0].startswith(" vehicle 1")
    assert "heading" in lines[height - 5]
    assert lines[height - 1] == ""
    if encoding == "latin-1":
        assert set("".join(lines)) <= set(map(chr, range(32, 127))) | {"°", "±"}


def written(monkeypatch, **environment):
    """What a console of this environment writes, its control sequences included."""
    for name in ("NO_COLOR", "COLORTERM", "TTY_COMPATIBLE"):
        monkeypatch.delenv(name, raising=False)
    # FORCE_COLOR: what is written into is no terminal
    for name, value in {"TERM": "xterm-256color", "FORCE_COLOR": "1", **environment}.items():
        monkeypatch.setenv(name, value)
    console = PersonConsole()
    out = console.file = io.StringIO()
    view = TerminalView(console, console, "title", now_s=lambda: 0.0, one="1")
    for output in [*vehicle("1", record(12.0)), Message("a word")]:
        view.handle([output])
    view.close()
    return out.getvalue()


def test_colours_are_as_many_as_the_terminal_has_and_lines_without_one(monkeypatch):
    assert "48;2;" in written(monkeypatch, COLORTERM="truecolor")
    few = written(monkeypatch, TERM="xterm-16color")
    assert "48;" not in few
    assert re.search(r"[\[;]44m", few)
    bare = written(monkeypatch, NO_COLOR="1")
    assert "roll" in bare
    assert not re.search(r"\x1b\[[0-9;]*m", bare)
    assert re.search(r"^    1  running\s+roll\s+\+12\.0", written(monkeypatch, TERM="dumb"))


def test_a_flight_in_a_real_terminal():
    """80x24, a smaller window, a larger one, all vehicles, the end."""
    emulator = pytest.importorskip("tests.fuzzbee.emulator", reason="pyte is not installed")
    session = default_session()
    with started("run", FLIPS, *session), emulator.terminal("watch", "1", *session) as terminal:
        # it may have to compile first
        terminal.wait_for(lambda lines: any("TRUST" in line for line in lines), 180.0)
        terminal.wait_for(lambda lines: any("GUIDED  armed" in line for line in lines))
        for columns, rows in ((80, 24), (60, 16), (100, 30)):
            terminal.resize(columns, rows)
            terminal.wait_for(lambda lines, n=columns: is_whole(lines, n), 10.0)
        # a real terminal breaks up what was drawn: it must be wiped out
        assert terminal.written.count(b"\x1b[2J") == 3  # and once for one vehicle
        terminal.press("x\x1b")  # the one means nothing
        terminal.wait_for(lambda lines: any("●GUIDED" in line for line in lines), 10.0)
        terminal.press("q")
        terminal.read(5.0)
        assert terminal.process.wait(60) == 0


def is_whole(lines, columns):
    """One bar, one row of figures and one tape: nothing is left of another size."""
    text = "\n".join(lines)
    bars = [n for n, line in enumerate(lines) if "vehicle 1" in line]
    if [len(bars), text.count("pitch"), text.count("▲")] != [1, 1, 1]:
        return False
    return abs(text.split("\n")[bars[0] + 2].index("▲") - columns // 2) <= 1


@pytest.mark.parametrize(("encoding", "mark"), [("utf-8", "◆"), ("latin-1", "A")])
def test_an_autopilot_that_differs_is_marked_at_its_own_horizon_and_heading(encoding, mark):
    """A dotted line with its own roll and pitch, or a mark on the tape; and by how much."""
    off = differing("inclination", 28.0, roll_deg=-20.0, pitch_deg=10.0)
    lines = horizon(encoding=encoding, status=off)
    cells = ((x, n, letter) for n, line in enumerate(lines[3:]) for x, letter in enumerate(line))
    down = {x: n for x, n, letter in cells if letter == mark}
    assert len(down) > 10
    left, right = min(down), max(down)
    # rows are as high as two cells are wide
    slope = 2.0 * (down[right] - down[left]) / (right - left)
    assert math.degrees(math.atan(slope)) == pytest.approx(20.0, abs=2.0)
    # 10 of 60 degrees below the middle of sixteen rows, across the line
    assert down[38] == 10
    assert "autopilot horizon 28° off" in lines[21]
    turned = horizon(encoding=encoding, status=differing("heading", 25.0))
    assert turned[2].index(mark) - 40 == 10
    assert "autopilot heading 25° off" in turned[21]
    assert mark not in "".join(horizon(encoding=encoding)[2:-4])


@pytest.mark.parametrize(("encoding", "mark"), [("utf-8", "◇"), ("latin-1", "C")])
@pytest.mark.parametrize(("off_deg", "column"), [(-50, 20), (75, 70), (179, 79), (19, None)])
def test_a_compass_that_disagrees_is_marked_on_the_tape(off_deg, column, encoding, mark):
    tape = horizon(encoding=encoding, compass_off_deg=off_deg)[2]
    assert (tape.index(mark) if mark in tape else None) == column
    shown = vehicle("1", compass_off_deg=off_deg, warnings=("field_impossible",))
    plates = terminal(shown, one="1")[21]
    assert (f"compass {abs(off_deg):.0f}° off" in plates) == (column is not None)
