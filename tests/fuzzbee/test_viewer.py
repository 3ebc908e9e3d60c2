"""The viewer as it is: Rerun's own process, its page in a real browser, its files."""

import io
import os
import re
import signal
import socket
import sys
import time
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pytest

from drivers.events import VehicleId
from fuzzbee.cli import main
from service.records import Departed, Message, Peer, Published, StatusRecord
from tests.fuzzbee import browser
from tests.fuzzbee.processes import started
from tests.service.records import UNIX_US, record

pytest.importorskip("rerun", reason="the extra viewer is not installed")

from estimator.profile import load_profile
from fuzzbee.viewer import layout
from fuzzbee.viewer import process as viewer_process
from fuzzbee.viewer.layout import LINES, MOST_VEHICLES
from fuzzbee.viewer.page import Page
from fuzzbee.viewer.stream import ViewerOptions, ViewerStream
from fuzzbee.viewer.viewer import ViewerSink
from tests.fuzzbee.rrd import listing, rows

ONE, TWO = VehicleId(1, 1), VehicleId(2, 1)
LOG = Path(__file__).parents[1] / "data" / "sitl_copter_flips.tlog"
PAPER = load_profile("paper")


def attitudes(vehicle, count, period_us, yaw_from=0.0, yaw_step=1.0):
    for n in range(count):
        turned = record(yaw_deg=(yaw_from + n * yaw_step) % 360.0)
        yield Published(vehicle, at_time(turned, n * period_us))


def at_time(attitude, after_us):
    return msgspec.structs.replace(attitude, time_unix_us=UNIX_US + after_us)


def test_a_file_holds_every_curve_and_shape(tmp_path):
    file = tmp_path / "flight.rrd"
    sink = ViewerSink(ViewerOptions(rrd=str(file)), PAPER)
    sink.handle([Message("before the first attitude")])
    for number, output in enumerate(attitudes(ONE, 200, 10_000)):
        sink.handle([output, Peer(ONE, "autopilot", output.record.q_ned_frd)])
        if number == 100:
            sink.handle(
                [Message("half-way"), Published(ONE, STATUS), Peer(TWO, "sim", (1, 0, 0, 0))]
            )
    sink.close()
    text = listing(file)
    for entity in (
        "/1/horizon/frame",
        "/1/horizon/world",
        "/1/horizon/words",
        "/1/horizon/figures",
        "/1/bodies",
        "/1/bodies/compass",
        *(f"/1/{curve}" for curve in LINES),
        "/1/state",
        "/messages",
    ):
        assert f"{entity} " in text or f"{entity}/" in text, entity
    assert "/2/" not in text  # somebody else's attitude makes no vehicle appear


def test_every_curve_has_an_axis_of_its_own_and_no_legend_over_it(tmp_path):
    file = tmp_path / "axes.rrd"
    sink = ViewerSink(ViewerOptions(rrd=str(file)), PAPER)
    sink.handle(list(attitudes(ONE, 2, 100_000)))
    sink.close()
    text = listing(file)
    for part in ("ScalarAxis", "PlotLegend"):
        views = set(re.findall(rf"/view/([0-9a-f-]+)/{part}", text))
        assert len(views) == len(LINES), part


def test_curves_come_in_batches_with_every_point_and_gaps_where_angles_wrap(tmp_path):
    """20 s at 10 points a second; the heading passes north once."""
    sink = Recorded(ViewerOptions(rrd=str(tmp_path / "curves.rrd")), PAPER)
    for output in attitudes(ONE, 2000, 10_000, yaw_from=-100, yaw_step=0.1):
        sink.handle([output])
    sink.close()
    headings = sink.points["/1/heading"]
    assert sum(len(values) for _, values in headings) == pytest.approx(200, abs=2)
    assert len(headings) == pytest.approx(5, abs=1)  # batches of 4 s
    ours = [values[0] for _, batch in headings for values in batch]
    assert sum(np.isnan(ours)) == 1
    assert max(np.abs(np.diff(np.array(ours)[~np.isnan(ours)]))) > 180.0


def test_what_stays_the_same_is_not_sent_again(tmp_path):
    """10 s of a vehicle that stands still: all at the start, and again every 5 s."""
    file = tmp_path / "still.rrd"
    sink = ViewerSink(ViewerOptions(rrd=str(file)), PAPER)
    for output in attitudes(ONE, 1000, 10_000, yaw_step=0.0):
        sink.handle([output])
    sink.close()
    for layer in ("world", "words", "figures"):
        assert rows(file, f"/1/horizon/{layer}") == 2, layer


def test_four_pictures_a_second_and_digits_half_as_often(tmp_path):
    file = tmp_path / "moving.rrd"
    sink = ViewerSink(ViewerOptions(rrd=str(file)), PAPER)
    for n in range(1000):
        moved = record(roll_deg=0.05 * n, yaw_deg=0.3 * n)
        sink.handle([Published(ONE, at_time(moved, n * 10_000))])
    sink.close()
    assert rows(file, "/1/horizon/world") == pytest.approx(40, abs=1)
    assert rows(file, "/1/horizon/figures") == pytest.approx(20, abs=1)
    assert rows(file, "/1/bodies") == pytest.approx(20, abs=1)


def test_a_lost_vehicle_is_drawn_although_it_has_no_attitude(tmp_path):
    """And one that has been heard but has never had any IMU data."""
    sink = Recorded(ViewerOptions(rrd=str(tmp_path / "lost.rrd")), PAPER)
    sink.handle([Published(TWO, WAITING, time_unix_us=UNIX_US)])
    assert sink.scenes[-1].attitude is None
    sink.handle(list(attitudes(ONE, 1, 10_000)))
    assert sink.scenes[-1].attitude is not None
    lost = msgspec.structs.replace(STATUS, state="lost")
    sink.handle([Published(ONE, lost, time_unix_us=UNIX_US + 6_000_000)])
    assert sink.scenes[-1].attitude is None
    sink.close()


def test_the_page_of_a_vehicle_that_is_forgotten_is_free(tmp_path):
    """Many more than there are pages, one after the other."""
    sink = Recorded(ViewerOptions(rrd=str(tmp_path / "day.rrd")), PAPER)
    for number in range(1, 3 * MOST_VEHICLES):
        sink.handle(list(attitudes(VehicleId(number, 1), 20, 100_000)))
        sink.handle([Departed(VehicleId(number, 1))])
    sink.handle(list(attitudes(VehicleId(200, 1), 20, 100_000)))
    assert list(sink._pages) == [VehicleId(200, 1)]
    sink.close()
    assert sink.pages[-1] == 1


def test_a_fleet_that_appears_gets_its_pages_at_once(tmp_path):
    """One page for the first vehicle, then one arrangement for all; at the end nothing waits."""
    sink = Recorded(ViewerOptions(rrd=str(tmp_path / "pages.rrd")), PAPER)
    streams = [attitudes(VehicleId(n, 1), 30, 100_000) for n in range(1, 6)]
    for turn in zip(*streams, strict=True):
        sink.handle(turn)
    assert sink.pages == [1, 5]
    sink.handle(list(attitudes(VehicleId(6, 1), 1, 100_000)))
    sink.close()
    assert sink.pages == [1, 5, 6]


def test_arranging_the_pages_leaves_no_thread_behind(tmp_path):
    """The library's own way left two behind, and 2 MB, each time: 8 more at the fifth.

    Its own may begin a moment after the first.
    """
    stream = ViewerStream(ViewerOptions(rrd=str(tmp_path / "many.rrd")), layout.blueprint)
    threads = []
    for number in range(1, 6):
        stream.show(layout.blueprint([str(number)]))
        threads.append(len(list(Path("/proc/self/task").iterdir())))
    stream.close()
    assert max(threads) <= threads[0] + 1


@pytest.mark.parametrize("live", [False, True])
def test_a_file_has_an_index_that_memory_has_to_hold_only_where_it_is_short(tmp_path, live):
    """Live it had been 100 MB an hour."""
    file = tmp_path / "flight.rrd"
    sink = ViewerSink(ViewerOptions(rrd=str(file), live=live), PAPER)
    sink.handle(list(attitudes(ONE, 100, 10_000)))
    sink.close()
    assert (b"FOOT" in file.read_bytes()[-64:]) != live
    assert rows(file, "/1/horizon/world") > 0


def test_vehicles_that_come_and_go_are_arranged_ever_later(tmp_path):
    """Each arrangement takes 0.4 MB of a file."""
    sink = Recorded(ViewerOptions(rrd=str(tmp_path / "hours.rrd")), PAPER)
    for second in range(60):
        there = VehicleId(1 + second, 1), VehicleId(2 + second, 1)
        sink.handle([Published(each, at_time(record(), second * 1_000_000)) for each in there])
        sink.handle([Departed(there[0])])
    sink.close()
    assert 5 < len(sink.pages) < 15


@pytest.mark.parametrize(
    ("rate_rad_s", "live", "off_deg"),
    [((0.0, 0.0, 0.5), True, 10.0), ((0.0, 0.0, 2.0), True, None), ((0.0, 0.0, 2.0), False, 10.0)],
)
def test_how_far_others_are_off_is_left_out_where_time_would_decide(
    tmp_path, rate_rad_s, live, off_deg
):
    """Live, in a fast turn, two messages are further apart than their attitudes; not in a log."""
    sink = Recorded(ViewerOptions(rrd=str(tmp_path / "off.rrd"), live=live), PAPER)
    ours = msgspec.structs.replace(record(roll_deg=10.0), rate_rad_s=rate_rad_s)
    sink.handle([Published(ONE, ours)])
    sink.handle([Peer(ONE, "sim", (1.0, 0.0, 0.0, 0.0)), Published(ONE, at_time(ours, 500_000))])
    ((_, turn_deg),) = sink.scenes[-1].peers
    sink.close()
    assert np.isnan(turn_deg) if off_deg is None else turn_deg == pytest.approx(off_deg)


def test_an_attitude_of_somebody_elses_turns_on_until_the_next_comes(tmp_path):
    """A stream of 2 Hz in a turn of 0.5 rad/s: without it, up to 14 deg off by age alone."""
    sink = Recorded(ViewerOptions(rrd=str(tmp_path / "slow.rrd")), PAPER)
    rate_deg_s = np.degrees(0.5)
    for n in range(100):
        ours = record(rate_deg_s * 0.05 * n, 30.0, 90.0, rate_rad_s=(0.5, 0.0, 0.0))
        turn = [Published(ONE, at_time(ours, n * 50_000))]
        if n % 10 == 0:
            turn.insert(0, Peer(ONE, "sim", ours.q_ned_frd))
        sink.handle(turn)
    sink.close()
    turns = [turn for scene in sink.scenes[2:] for _, turn in scene.peers]
    assert len(turns) > 10
    assert max(turns) < 0.01


def test_only_so_many_vehicles_are_drawn_as_can_be_read(tmp_path):
    file = tmp_path / "fleet.rrd"
    sink = Recorded(ViewerOptions(rrd=str(file)), PAPER)
    for number in range(1, 20):
        sink.handle(list(attitudes(VehicleId(number, 1), 2, 10_000)))
    sink.close()
    text = listing(file)
    assert f"/{MOST_VEHICLES}/horizon" in text
    assert f"/{MOST_VEHICLES + 1}/horizon" not in text
    assert [text for text in sink.said if "only the first" in text] == [
        f"only the first {MOST_VEHICLES} vehicles are drawn"
    ]


STATUS = StatusRecord("running", "RAW_IMU", 100.0, 0.01, {}, 0, 0, 0)


WAITING = StatusRecord("waiting", None, 0.0, 0.0, {}, 0, 0, 0)


@pytest.fixture
def drawn(monkeypatch):
    """What pictures were drawn of, one after the other."""
    draw, arguments = Page._draw, []

    def counted(*given):
        arguments.append(given)
        draw(*given)

    monkeypatch.setattr(Page, "_draw", counted)
    return arguments


class Recorded(ViewerSink):
    """Keeps what it sends."""

    def __init__(self, *arguments):
        self.scenes, self.said, self.points, self.pages = [], [], {}, []
        super().__init__(*arguments)
        send = self.stream.curves

        def curves(path, column, values):
            self.points.setdefault(path, []).append((column, list(values)))
            send(path, column, values)

        self.stream.curves = curves

    def _show_pages(self):
        self.pages.append(len(self._pages))
        super()._show_pages()

    def _page(self, vehicle):
        is_new = vehicle not in self._pages
        page = super()._page(vehicle)
        if is_new and page is not None:
            draw = page._draw_scene

            def recorded(scene, now_us):
                self.scenes.append(scene)
                draw(scene, now_us)

            page._draw_scene = recorded
        return page

    def _say(self, text):
        self.said.append(text)
        super()._say(text)


@pytest.mark.parametrize(("vehicles", "expected_hz"), [(1, 4), (2, 6), (9, 6), (50, 6)])
def test_it_draws_a_bounded_number_however_much_comes(tmp_path, drawn, vehicles, expected_hz):
    sink = ViewerSink(ViewerOptions(rrd=str(tmp_path / "many.rrd")), PAPER)
    streams = [attitudes(VehicleId(n + 1, 1), 200, 10_000) for n in range(vehicles)]
    for outputs in zip(*streams, strict=True):
        sink.handle(outputs)
    sink.close()
    # two seconds; the first record of each vehicle comes on top
    assert len(drawn) == pytest.approx(2 * expected_hz, abs=max(2, 1.5 * min(vehicles, 9)))


def test_a_file_that_cannot_be_written_is_status_2(tmp_path, capfd):
    assert main(["run", "--no-zenoh", "--seconds", "1", "--rrd", str(tmp_path)]) == 2
    assert "--rrd" in capfd.readouterr().err
    assert main(["run", "--no-zenoh", "--view", "elsewhere"]) == 2


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="Linux's way to name a screen")
def test_without_a_screen_a_window_is_refused(monkeypatch, capfd):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    assert main(["run", "--no-zenoh", "--view"]) == 2
    assert "--view web" in capfd.readouterr().err


def test_a_log_is_replayed_into_a_file(tmp_path, capfd):
    file = tmp_path / "flips.rrd"
    assert main(["replay", str(LOG), "--rrd", str(file), "--json"]) == 0
    text = listing(file)
    assert "/1/horizon/world" in text
    assert "/1/bodies" in text


def page_of(process):
    said = []
    for line in process.stderr:
        said.append(line)
        if found := re.search(r"http://\S+", line):
            return found[0]
    pytest.fail(f"no page was named: {said}")


def port_of(url):
    return int(re.search(r":(\d+)", url)[1])


def is_open(port):
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def wait_until_closed(port):
    end_s = time.monotonic() + 10.0
    while is_open(port) and time.monotonic() < end_s:
        time.sleep(0.05)
    assert not is_open(port)


def test_a_viewer_that_is_closed_is_told_once_and_drawn_no_more(drawn):
    sink = ViewerSink(ViewerOptions(view="web"), PAPER)
    try:
        first, *rest = attitudes(ONE, 3, 100_000)
        sink.handle([first])
        sink.stream.process._process.kill()
        sink.stream.process._process.wait()
        with pytest.raises(ConnectionError, match="closed"):
            sink.handle(rest)
        sink.handle(rest)
        assert len(drawn) == 1
    finally:
        sink.close()


def test_a_port_that_another_took_meanwhile_is_given_up(monkeypatch):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        ports = [taken.getsockname()[1]]
        free = viewer_process._free_port
        monkeypatch.setattr(
            viewer_process, "_free_port", lambda wanted: ports.pop() if ports else free(wanted)
        )
        process = viewer_process.ViewerProcess(web=True)
        try:
            assert not ports
            assert is_open(port_of(process.page))
        finally:
            process.close()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the kernel's help is Linux's")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_the_viewer_ends_with_us_and_listens_on_loopback_only(number):
    with started("run", "--no-zenoh", "--json", "--view", "web") as process:
        port = port_of(page_of(process))
        assert is_open(port)
        listening = (
            Path("/proc/net/tcp").read_text().splitlines()
            + Path("/proc/net/tcp6").read_text().splitlines()
        )
        local = [line.split()[1] for line in listening if " 0A " in line]  # listening
        hosts = [address for address in local if address.endswith(f":{port:04X}")]
        assert hosts
        assert all(host.startswith("0100007F") for host in hosts)
        process.send_signal(number)
        status = process.wait(60)
        assert status == (-9 if number == signal.SIGKILL else 0), process.stderr.read()
        wait_until_closed(port)


@pytest.mark.slow
@pytest.mark.skipif(browser.program() is None, reason="no Chromium")
def test_the_page_shows_the_attitude_moving(tmp_path):
    """Screenshots go to FUZZBEE_SCREENSHOTS, for whoever wants to look."""
    image = pytest.importorskip("PIL.Image")
    folder = Path(os.environ.get("FUZZBEE_SCREENSHOTS", tmp_path))
    with started("run", "--no-zenoh", "--json", "--view", "web", "--rate", "20") as service:
        with browser.page(page_of(service), tmp_path / "profile") as page:
            shots = []
            end_s = time.monotonic() + 60.0
            while len(shots) < 3 and time.monotonic() < end_s:
                time.sleep(1.0)
                data = page.screenshot()
                picture = image.open(io.BytesIO(data)).convert("RGB")
                if bluish(attitude_view(picture)) > 100:  # ours is drawn
                    (folder / f"viewer-{len(shots)}.png").write_bytes(data)
                    shots.append(attitude_view(picture))
        service.send_signal(signal.SIGINT)
        assert service.wait(60) == 0
    assert len(shots) == 3
    for before, after in pairwise(shots):
        assert changed(before, after) > 200  # pixels: the vehicle turns


def attitude_view(picture):
    """The upper left part of the page, without its title: (height, width, RGB)."""
    pixels = np.asarray(picture).astype(int)
    height, width, _ = pixels.shape
    return pixels[60 : int(0.55 * height), 10 : int(0.38 * width)]


def bluish(pixels):
    return np.sum(pixels[..., 2] > 1.4 * np.maximum(pixels[..., 0], 1))


def changed(one, other):
    return np.sum(np.abs(one - other).max(axis=-1) > 40)


def test_no_usage_figures_are_sent_or_kept(tmp_path, monkeypatch):
    """Rerun keeps them in its folder for data, and sends them with its next start."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    viewer_process.ViewerProcess(web=True).close()
    assert not list(tmp_path.rglob("*.json"))
