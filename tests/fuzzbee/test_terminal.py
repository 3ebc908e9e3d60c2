"""The table of vehicles, and the lines that stand for it where there is no terminal."""

import io
import os
import pty
import tty

import pytest
from msgspec.structs import replace
from rich.console import Console

from drivers.events import VehicleId
from fuzzbee.latest import Latest
from fuzzbee.terminal import TerminalView, pressed_keys, terminal_keys
from service.records import Evicted, ImuDifference, Message, Published
from tests.fuzzbee.screen import lines, terminal, vehicle
from tests.service.records import differing, record

MANY = range(1, 51)


@pytest.mark.parametrize(
    ("width", "columns"),
    [
        (50, ()),
        (63, ("±1.0°", "±5.0°")),
        (80, ("±5.0°", "101.0", "49.8")),
        (100, ("101.0", "●LOITER")),
        (120, ("101.0", "●LOITER", "RAW_IMU")),
    ],
)
def test_a_vehicle_fits_a_line_and_columns_without_room_are_left_out_not_cut(width, columns):
    attitude = replace(record(-12.34, 5.0, 359.97), gain=101.0)
    shown = vehicle("255-190", attitude, "degraded", mode="LOITER", armed=True)
    text = "\n".join(terminal(shown, width=width))
    assert "…" not in text
    for part in ("255-190", "degraded", "-12.3°", "+5.0°", "000.0° ↑", "5 ms", *columns):
        assert part in text
    assert ("101.0" in text) == ("101.0" in columns)
    assert ("LOITER" in text) == ("●LOITER" in columns)


def test_an_attitude_that_is_not_valid_any_more_is_not_shown():
    for shown, after_s, word in (
        (vehicle(state="lost"), 0.0, "lost"),
        (vehicle(), 4.0, "silent"),  # the service went away
    ):
        (line,) = lines(shown, after_s=after_s)
        assert line.split() == ["1", word]
        text = "\n".join(terminal(shown, after_s=after_s))
        assert word in text
        assert "-12.3" not in text
    assert "5 min" in "\n".join(terminal(vehicle(), after_s=300.0))


# What is published of a vehicle, how its line ends, and what the terminal shows.
REPORTED = [
    ({"armed": False, "mode": "GUIDED_NOGPS"}, "GUIDED_NOGPS  disarmed", ["○GUIDED_NOG "]),
    ({"armed": True}, "  armed", []),
    (
        {"warnings": ("bias_at_limit", "of another version")},
        "! bias_at_limit  ! of another version",
        ["running!", "! vehicle 2: the gyroscope's bias stands at its limit",
         "! vehicle 2: of another version"],
    ),
    (
        {"status": differing("heading", 25.0)},
        "! autopilot heading 25° off",
        ["running≠", "! vehicle 2: autopilot heading 25° off ours; its own is likely wrong"],
    ),
    (
        {"other_imus": {"SCALED_IMU2": ImuDifference(3.1, 0.1)}},
        "! IMU 2 off by 3.1°",
        ["! vehicle 2: IMU 2 off by 3.1°"],
    ),
]  # fmt: skip


@pytest.mark.parametrize(("given", "end", "words"), REPORTED, ids=[end for _, end, _ in REPORTED])
def test_what_is_reported_stands_below_the_table_and_marks_the_state(given, end, words):
    shown = vehicle("2", **given)
    assert lines(shown)[0].endswith(end)
    text = "\n".join(terminal(vehicle("1"), shown, width=90))
    assert [text.count(each) for each in words] == [1] * len(words)
    assert {each for each in words if "IMU" in each} <= {*text.splitlines()}


def test_of_many_warnings_the_rest_is_counted_and_one_vehicle_has_its_own():
    many = [vehicle(str(n), warnings=("sigma_too_small",)) for n in range(1, 20)]
    assert "! and 17 more warnings" in terminal(*many)
    one = vehicle("2", other_imus={"SCALED_IMU2": ImuDifference(3.1, 0.1)})
    assert "IMU 2 off by 3.1°" in "\n".join(terminal(one, one="2"))


def test_columns_stay_where_they_are_whatever_they_hold():
    """Of the header's line, for every width, from nothing known to the largest numbers."""
    large = replace(record(-179.9, -89.9, 359, sigma_deg=(180, 180)), heading_reference="none")
    status = {"imu_message": "HIGHRES_IMU", "imu_rate_hz": 1000.0, "mode": "GUIDED_NOGPS"}
    shown = (vehicle(state="lost"), vehicle(), vehicle("1", large, **status))
    for width in (50, 60, 80, 100, 120):
        assert len({terminal(each, width=width)[1] for each in shown}) == 1, width


@pytest.mark.parametrize(("width", "height", "across"), [(80, 24, 1), (120, 50, 2), (180, 24, 3)])
def test_fifty_vehicles_stand_side_by_side_where_there_is_room(width, height, across):
    shown = terminal(*(vehicle(str(n), state="degraded") for n in MANY), width=width, height=height)
    text = "\n".join(shown)
    assert text.count("heading") == across
    assert text.count("degraded") == (1 + 19 if across == 1 else 50)  # with the summary
    assert text.count("…") == (across == 1)  # nothing is cut


@pytest.mark.parametrize("height", [7, 12, 24, 60])
def test_where_not_all_fit_the_troubled_are_shown_and_keep_their_order(height):
    bad = {7: "lost", 30: "degraded"}
    shown = terminal(*(vehicle(str(n), state=bad.get(n, "running")) for n in MANY), height=height)
    names = [int(line.split()[0]) for line in shown if line[:1].isdigit()]
    assert names == sorted(names)
    assert {7, 30} & set(names) == ({7, 30} if height > 7 else {7, 30} & set(names[:2]))
    assert any("more" in line for line in shown) == (height < 50)


def test_lines_are_of_one_vehicle_each_in_the_order_of_numbers_or_of_many():
    shown = lines(*(vehicle(name) for name in ("10", "2", "1-154", "1")))
    assert [line.split()[0] for line in shown] == ["1", "1-154", "2", "10"]
    many = [vehicle(str(n), state="lost" if n < 3 else "running") for n in range(20)]
    assert lines(*many) == ["20 vehicles: 3 lost, 17 running"]
    relative = replace(record(yaw_deg=123.0), heading_reference="none")
    assert "heading (123.0)" in lines(vehicle("1", relative))[0]


def test_without_a_terminal_there_is_a_line_a_second():
    out, messages, now_s = io.StringIO(), io.StringIO(), [0.0]
    consoles = (Console(file=file, width=40) for file in (out, messages))
    view = TerminalView(*consoles, "t", lambda: now_s[0])
    for tick in range(300):
        now_s[0] = tick * 0.01
        view.handle([Published(VehicleId(1, 1), record())])
    view.handle([Message("something [bold] to read")])
    view.close()
    assert len(out.getvalue().splitlines()) == 3
    assert "\x1b" not in out.getvalue()
    assert messages.getvalue() == "something [bold] to read\n"


def test_messages_stand_above_the_table_and_at_the_foot_of_one_vehicle():
    """Of a line that was wrapped before, nothing is left above."""
    output = [Message("nothing yet " * 12 + "(Ctrl-C ends)"), Message("one more line")]
    assert "one more line" in terminal(output[1:], vehicle("3"))[0]
    shown = terminal(output, vehicle("3"), one="3", height=25)
    assert shown[0].startswith(" vehicle 3  running")
    assert shown[23] == "one more line"
    assert "ends)" not in "".join(shown)


def test_an_overloaded_service_reports_what_it_leaves_out():
    one = vehicle("1", shed=30, overloaded=True, published_hz=12.5)
    two = vehicle("2", shed=12, overloaded=True, published_hz=50.0)
    assert "! overloaded: 42 samples left out so far, attitudes at 12.5 Hz" in terminal(one, two)
    assert "! overloaded" in lines(one, two)[0]


UNSURE, WARNED = {"attitude": record(sigma_deg=(9.0, 9.0))}, {"warnings": ("bias_at_limit",)}


@pytest.mark.parametrize(
    ("second", "third", "keys", "names"),
    [
        ({"state": "degraded"}, UNSURE, "", "123"),
        ({"state": "degraded"}, UNSURE, "s", "213"),  # those that need attention first
        ({"state": "degraded"}, UNSURE, "ss", "312"),  # the greatest sigma
        ({"state": "degraded"}, UNSURE, "sss", "123"),
        (WARNED, {"state": "degraded"}, "s", "321"),  # of two in one state the warned one
    ],
)
def test_keys_sort(second, third, keys, names):
    shown = vehicle("1"), vehicle("2", **second), vehicle("3", **third)
    assert "".join(line[:1] for line in terminal(*shown, keys=[*keys])[2:5]) == names


@pytest.mark.parametrize(
    ("keys", "alone"),
    [("down down enter", "2"), ("down down enter j", "3"), ("enter up", "3"), ("enter escape", "")],
)
def test_keys_choose_who_is_shown_alone(keys, alone):
    top = terminal(*(vehicle(name) for name in "123"), keys=keys.split())[0]
    assert top.startswith(f" vehicle {alone}  running" if alone else "title")


def test_who_is_evicted_or_was_silent_for_longest_where_there_is_no_place_goes(monkeypatch):
    assert lines([*vehicle("2"), *vehicle("1"), Evicted(VehicleId(1, 1))]) == lines(vehicle("2"))
    monkeypatch.setattr("fuzzbee.latest.SLOTS", 2)
    model = Latest()
    for now_s, name in enumerate(("1", "2", "1", "3")):
        model.update(name, record(), now_s)
    assert [row.name for row in model.rows()] == ["1", "3"]


def test_keys_are_letters_and_arrows_and_without_a_terminal_there_are_none():
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    assert pressed_keys(theirs) == []
    os.write(ours, b"qs\x1b[A\x1b[B\r\x1b")
    assert pressed_keys(theirs) == ["q", "s", "up", "down", "enter", "escape"]
    os.close(ours)
    assert pressed_keys(theirs) == []  # the terminal is gone
    os.close(theirs)
    with terminal_keys() as keys:
        assert keys() == []
