import io

import msgspec
import pytest
from rich.console import Console

from drivers.events import VehicleId
from fuzzbee.table_model import Row, TableModel
from fuzzbee.terminal import TerminalView
from fuzzbee.vehicle_table import Look, lines, summary, table
from service.records import AttitudeRecord, Confidence, Message, Published, Sigma, StatusRecord
from tests.service.records import differing

STATUS = StatusRecord("running", "RAW_IMU", 100.0, 0.01, {}, 0, 0, 0)


def attitude(state="running", yaw=359.97, reference="true", gain=42.0):
    return AttitudeRecord(
        1, 0, 0, (1.0, 0.0, 0.0, 0.0), (-12.34, 5.0, yaw), (0.0,) * 3, (0.0,) * 3, 0.0123, 0.0,
        gain, Confidence(1.0, 1.0), Sigma(1.0, 2.0), reference, state, 4.0, 0,
    )  # fmt: skip


def row(name="1", state="running", heard_s=10.0, **kwargs):
    return Row(name, attitude(state, **kwargs), STATUS, heard_s, heard_s)


def drawn(rows, width, height, now_s=10.0):
    console = Console(file=io.StringIO(), width=width, height=height, force_terminal=False)
    console.print(table(rows, now_s, width, height, Look("title")))
    return console.file.getvalue()


@pytest.mark.parametrize("width", [80, 100, 200])
def test_a_vehicle_fits_a_line_and_nothing_is_cut(width):
    text = drawn([row("255-190", "degraded", gain=101.0)], width, 24)
    assert "…" not in text
    for part in (
        "255-190",
        "degraded",
        "-12.3°",
        "+5.0°",
        "000.0° ↑",
        "±1.0°",
        "±2.0°",
        "101.0",
        "4 ms",
    ):
        assert part in text
    assert all(len(line.rstrip()) <= width for line in text.splitlines())


@pytest.mark.parametrize("width", [50, 56, 63, 70, 76])
def test_in_a_narrow_window_columns_are_left_out_not_cut(width):
    text = drawn([row("255-190", "degraded", gain=101.0)], width, 24)
    assert "…" not in text
    for part in ("255-190", "degraded", "-12.3°", "+5.0°", "000.0° ↑", "4 ms"):
        assert part in text
    assert ("101.0" in text) == (width >= 76)
    assert ("±1.0°" in text) == (width >= 62)


@pytest.mark.parametrize(("width", "across"), [(80, 1), (120, 2), (180, 3)])
def test_fifty_vehicles_stand_side_by_side_where_there_is_room(width, across):
    rows = [row(str(n), "degraded", gain=101.0) for n in range(1, 51)]
    text = drawn(rows, width, 50 if across == 2 else 24)
    assert text.count("heading") == across
    assert max(len(line.rstrip()) for line in text.splitlines()) <= width
    assert text.count("degraded") == (1 + 20 if across == 1 else 50)  # with the summary
    assert text.count("…") == (across == 1)  # nothing is cut


@pytest.mark.parametrize("height", [6, 24, 60])
def test_fifty_vehicles_fit_the_screen_with_the_troubled_ones_first(height):
    rows = [row(str(n), "degraded" if n == 49 else "running") for n in range(1, 51)]
    text = drawn(rows, 80, height)
    assert len(text.rstrip().splitlines()) <= height - 1
    assert "degraded" in text
    if height < 50:
        assert "more" in text


def test_a_lost_vehicle_shows_no_stale_attitude():
    lost = Row("1", attitude(), StatusRecord("lost", "RAW_IMU", 0, 9.0, {}, 0, 0, 9), 10.0, 16.0)
    assert "-12.3" not in drawn([lost], 100, 24, now_s=16.0)
    assert lines([lost], 16.0) == ["    1  lost     "]


def test_a_service_that_went_away_is_told_and_its_attitude_not_shown():
    assert "silent" in lines([row(heard_s=10.0)], 14.0)[0]
    assert "roll" not in lines([row(heard_s=10.0)], 14.0)[0]
    text = drawn([row(heard_s=10.0)], 100, 24, now_s=310.0)
    assert "silent" in text
    assert "-12.3" not in text
    assert "5 min" in text


def test_a_heading_that_refers_to_nothing_is_in_brackets():
    assert "heading (123.0)" in lines([row(yaw=123.0, reference="none")], 10.0)[0]


def test_many_vehicles_share_a_line():
    rows = [row(str(n), "lost" if n < 3 else "running") for n in range(20)]
    rows = [r._replace(attitude=None, status=STATUS) if n >= 3 else r for n, r in enumerate(rows)]
    assert lines(rows, 10.0) == [summary(rows, "vehicles")]
    assert summary(rows, "vehicles") == "20 vehicles: 3 lost, 17 running"


def test_rows_are_in_the_order_of_numbers():
    model = TableModel()
    for name in ("10", "2", "1-154", "1"):
        model.update(name, STATUS, 0.0)
    assert [r.name for r in model.rows()] == ["1", "1-154", "2", "10"]


def test_without_a_terminal_there_is_a_line_a_second():
    out, messages = io.StringIO(), io.StringIO()
    now = [0.0]
    view = TerminalView(
        Console(file=out, width=40), Console(file=messages, width=40), "t", lambda: now[0]
    )
    for tick in range(300):
        now[0] = tick * 0.01
        view.handle([Published(VehicleId(1, 1), attitude())])
    view.handle([Message("something [bold] to say")])
    view.close()
    assert len(out.getvalue().splitlines()) == 3
    assert "\x1b" not in out.getvalue()
    assert messages.getvalue() == "something [bold] to say\n"


def test_on_a_terminal_the_table_is_redrawn_in_place():
    out = io.StringIO()
    console = Console(file=out, width=80, height=24, force_terminal=True)
    view = TerminalView(console, console, "title")
    view.handle([Published(VehicleId(3, 1), attitude()), Message("above the table")])
    view.close()
    assert "above the table" in out.getvalue()
    assert "running" in out.getvalue()


def test_nothing_is_left_above_one_vehicle():
    """Of a line that was wrapped while it was waited for."""
    pyte = pytest.importorskip("pyte")
    screen = pyte.Screen(120, 30)
    out = io.StringIO()
    console = Console(file=out, width=120, height=30, force_terminal=True)
    view = TerminalView(console, console, "title", now_s=lambda: 10.0)
    view.one = "3"
    view.say("nothing yet " * 12 + "(waiting; Ctrl-C ends)")
    view.handle([Published(VehicleId(3, 1), attitude()), Published(VehicleId(3, 1), STATUS)])
    view.say("one more line")
    view.refresh()
    view._live.refresh()
    pyte.Stream(screen).feed(out.getvalue().replace("\n", "\r\n"))
    assert screen.display[0].startswith(" vehicle 3  running")
    assert "ends)" not in "".join(screen.display)
    assert screen.display[28].startswith("one more line")
    view.close()


def warned(name, *words):
    return row(name)._replace(status=msgspec.structs.replace(STATUS, warnings=words))


def test_warnings_stand_below_the_table_and_mark_the_state():
    text = drawn([row("1"), warned("2", "bias_at_limit", "of another version")], 80, 24)
    assert "running!" in text
    assert text.count("running!") == 1
    assert "! vehicle 2: the gyroscope's bias stands at its limit" in text
    assert "! vehicle 2: of another version" in text
    assert lines([warned("2", "bias_at_limit")], 10.0)[0].endswith("! bias_at_limit")
    many = drawn([warned(str(n), "sigma_too_small") for n in range(1, 20)], 80, 24)
    assert "! and 17 more warnings" in many
    assert len(many.rstrip().splitlines()) <= 23


def test_columns_stay_where_they_are_whatever_they_hold():
    """Of the header's line, for every width, from nothing known to the largest numbers."""
    empty = Row("1", None, None, 0.0, 10.0)
    large = row("1", "degraded", reference="none", gain=101.0)
    status = msgspec.structs.replace(STATUS, imu_message="HIGHRES_IMU", imu_rate_hz=1000.0)
    record = msgspec.structs.replace(large.attitude, sigma_deg=Sigma(180.0, 180.0))
    large = large._replace(status=status, attitude=record)
    for width in (50, 60, 80, 120):
        heads = {drawn([each], width, 24).splitlines()[1] for each in (empty, row("1"), large)}
        assert len(heads) == 1, width


def test_where_not_all_fit_they_keep_their_order():
    rows = [row(str(n), "lost" if n in (7, 30) else "running") for n in range(1, 51)]
    shown = drawn(rows, 80, 12).splitlines()[2:-1]
    names = [int(line.split()[0]) for line in shown if line[0].isdigit()]
    assert names == sorted(names)
    assert {7, 30} <= set(names)


def test_keys_sort_choose_and_quit():
    from fuzzbee.displays import Table

    display = Table("fuzzbee")
    view = display._view
    for name, state in (("1", "running"), ("2", "degraded"), ("3", "running")):
        view.model.update(name, attitude(state), 10.0)
    assert [r.name for r in view.rows()] == ["1", "2", "3"]
    display.press(["s"])
    assert [r.name for r in view.rows()] == ["2", "1", "3"]
    display.press(["s", "s"])
    assert [r.name for r in view.rows()] == ["1", "2", "3"]
    display.press(["down", "down", "enter"])
    assert view.one == "2"
    display.press(["down"])
    assert view.one == "3"
    display.press(["escape"])
    assert view.one is None
    assert not display.closed
    display.press(["x", "q"])
    assert display.closed


def test_an_overloaded_service_says_what_it_leaves_out():
    def busy(name, shed):
        status = msgspec.structs.replace(STATUS, overloaded=True, shed=shed, published_hz=12.5)
        return row(name)._replace(status=status)

    text = drawn([busy("1", 30), busy("2", 12)], 90, 24)
    assert "! overloaded: 42 samples left out so far, attitudes at 12.5 Hz" in text
    assert "! overloaded" in lines([busy("1", 30)], 10.0)[0]
    assert "overloaded" not in drawn([row("1")], 90, 24)


def test_a_row_keeps_the_status_before_the_latest():
    model = TableModel()
    early, late = (msgspec.structs.replace(STATUS, overruns=n) for n in (3, 7))
    model.update("1", early, 10.0)
    model.update("1", late, 11.0)
    (row,) = model.rows()
    assert (row.before, row.status) == (early, late)


def test_an_autopilot_that_differs_is_marked_in_its_row_and_told_by_how_much():
    shown = row("2")._replace(status=differing("heading", 25.0))
    text = drawn([row("1"), shown], 80, 24)
    assert text.count("running≠") == 1
    assert "! vehicle 2: autopilot heading 25° off ours; its own is likely wrong" in text
    assert lines([shown], 10.0)[0].endswith("! autopilot heading 25° off")
