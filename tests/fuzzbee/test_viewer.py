"""The viewer as it is: Rerun's own process, its page in a real browser, its files."""

import io
import os
import re
import signal
import socket
import sys
import time
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from urllib.parse import urlsplit

import msgspec
import numpy as np
import pytest

from drivers.events import VehicleId
from drivers.output_file import NotWholeError
from estimator.geometry.quaternion import conjugate, rotate
from estimator.types import STANDARD_GRAVITY_M_S2, ImuSample
from service.records import Evicted, Message, Published
from tests.fuzzbee import browser
from tests.fuzzbee.processes import descendants, is_loopback, listening, started
from tests.fuzzbee.services import await_line, wait_for
from tests.programs import largest_file
from tests.service.records import UNIX_US, record, status

pytest.importorskip("rerun", reason="the extra viewer is not installed")

from fuzzbee.viewer import process as viewer_process
from fuzzbee.viewer.layout import PLOTS
from fuzzbee.viewer.viewer import MOST_VEHICLES, ViewerSink
from tests.fuzzbee.recording import FLIPS
from tests.fuzzbee.screen import chunks, listing, numbers, rows

ONE, TWO = VehicleId(1, 1), VehicleId(2, 1)


def attitudes(vehicle, count, period_us, yaw_from=0.0, yaw_step=1.0):
    for n in range(count):
        yaw_deg, time_us = (yaw_from + n * yaw_step) % 360.0, UNIX_US + n * period_us
        yield Published(vehicle, record(yaw_deg=yaw_deg, time_unix_us=time_us))


def beside(output, source):
    """The same with an attitude of somebody else's, which agrees."""
    return msgspec.structs.replace(output, peers=((source, output.record.q_ned_frd),))


def drawn(tmp_path, turns, **options):
    """The file that is there after these turns of the loop."""
    file = tmp_path / "flight.rrd"
    sink = ViewerSink(rrd=str(file), **options)
    for outputs in turns:
        sink.handle(outputs)
    sink.close()
    return file


def test_a_file_holds_every_curve_and_body_and_what_was_reported(tmp_path):
    """Before the first attitude there is no time."""
    ours = attitudes(ONE, 200, 10_000)
    turns = [
        [Message("before the first attitude")],
        *([beside(output, "autopilot")] for output in ours),
        [Message("half-way"), Published(ONE, status())],
        [Published(TWO, status("waiting", imu_message=None), time_unix_us=UNIX_US)],
        [Published(ONE, status("lost"), time_unix_us=UNIX_US + 6_000_000)],
    ]
    text = listing(drawn(tmp_path, turns), "-vvv")
    for entity in ("/bodies/1/ours", "/bodies/1/autopilot", "/state/1", "/messages"):
        assert f"{entity} " in text, entity
    for plot, (*_, of_others) in PLOTS.items():
        assert f"/{plot}/1 " in text
        assert (f"/{plot}/1/autopilot " in text) == bool(of_others)
    for line in ("half-way", "vehicle 2: waiting", "vehicle 1: running", "vehicle 1: lost"):
        assert line in text
    assert "before the first" not in text


@pytest.mark.parametrize("live", [False, True])
def test_a_minute_is_some_chunks_with_every_point_and_gaps_where_angles_wrap(tmp_path, live):
    """The heading passes north once. Live there is no index, which memory had to hold."""
    turns = [[each] for each in attitudes(ONE, 3000, 20_000, yaw_from=-100, yaw_step=0.1)]
    file = drawn(tmp_path, turns, live=live)
    assert rows(file, "/heading/1") == pytest.approx(600, abs=2)
    assert rows(file, "/bodies/1/ours") == pytest.approx(600, abs=2)
    assert chunks(file) <= 20
    assert listing(file, "-vvv").count("NaN") > 0
    assert (b"FOOT" in file.read_bytes()[-64:]) != live


def test_what_is_measured_is_drawn_in_ned_as_it_points(tmp_path):
    """A vehicle that stands still, banked by 30 deg: gravity points down, the field north."""
    banked = record(roll_deg=30.0)
    acc = rotate(conjugate(banked.q_ned_frd), (0.0, 0.0, -STANDARD_GRAVITY_M_S2))
    field = rotate(conjugate(banked.q_ned_frd), (0.5, 0.0, 0.0))
    sample = ImuSample(0, (0.0, 0.0, 0.0), acc, field, has_mag=True)
    file = drawn(tmp_path, [[Published(ONE, banked, sample)]])
    assert numbers(file, "/bodies/1/gravity")[0] == pytest.approx([0.0, 0.0, 1.0], abs=1e-6)
    assert numbers(file, "/bodies/1/field")[0] == pytest.approx([1.0, 0.0, 0.0], abs=1e-6)


@pytest.mark.parametrize(
    ("turn_rad_s", "live", "off_deg"), [(0.5, True, 10.0), (2.0, True, None), (2.0, False, 10.0)]
)
def test_how_far_others_are_off_is_left_out_where_time_decides(tmp_path, turn_rad_s, live, off_deg):
    """Live, in a fast turn, two messages are further apart than their attitudes; not in a log."""
    times_us, rate_rad_s = (UNIX_US, UNIX_US + 500_000), (0.0, 0.0, turn_rad_s)
    first, ours = (record(10.0, rate_rad_s=rate_rad_s, time_unix_us=us) for us in times_us)
    other = ("sim", (1.0, 0.0, 0.0, 0.0))
    turns = [[Published(ONE, first)], [Published(ONE, ours, peers=(other,))]]
    off = numbers(drawn(tmp_path, turns, live=live), "/sigma/1/sim")
    assert off == ([] if off_deg is None else [[pytest.approx(off_deg)]])


def test_an_attitude_of_somebody_elses_is_compared_with_ours_of_its_time(tmp_path):
    """In a turn, by a slow stream."""
    rate_deg_s, turns = np.degrees(0.5), []
    for n in range(100):
        then = {"rate_rad_s": (0.5, 0.0, 0.0), "time_unix_us": UNIX_US + n * 50_000}
        output = Published(ONE, record(rate_deg_s * 0.05 * n, 30.0, 90.0, **then))
        turns.append([beside(output, "sim") if n % 10 == 0 else output])
    differences = numbers(drawn(tmp_path, turns), "/sigma/1/sim")
    assert len(differences) == 10
    assert np.max(differences) < 0.01


def test_only_so_many_vehicles_are_drawn_as_can_be_read(tmp_path):
    """At a time: the place of one that is forgotten is free."""
    vehicles = range(1, 3 * MOST_VEHICLES)
    turns = [list(attitudes(VehicleId(number, 1), 2, 10_000)) for number in vehicles]
    text = listing(drawn(tmp_path, turns), "-vvv")
    assert f"/tilt/{MOST_VEHICLES} " in text
    assert f"/tilt/{MOST_VEHICLES + 1} " not in text
    assert text.count("only the first") == 1
    turns = [[*turn, Evicted(VehicleId(n, 1))] for n, turn in zip(vehicles, turns, strict=True)]
    text = listing(drawn(tmp_path, turns), "-vvv")
    assert f"/tilt/{vehicles[-1]} " in text
    assert "only the first" not in text


def test_a_file_that_has_no_room_for_its_end_is_not_whole(tmp_path):
    file = tmp_path / "flight.rrd"
    sink = ViewerSink(rrd=str(file))
    sink.handle([*attitudes(ONE, 100, 100_000)])
    sink.flush(10.0)
    size = file.stat().st_size + 100
    with largest_file(size), pytest.raises(NotWholeError, match="is not whole"):
        sink.close()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="Linux's way to name a screen")
def test_without_a_screen_or_a_writable_file_it_is_refused(monkeypatch, tmp_path, refused):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    assert "--view web" in refused("run", "--no-zenoh", "--view")
    assert "--rrd" in refused("run", "--no-zenoh", "--seconds", "1", "--rrd", tmp_path)


def test_a_log_is_replayed_into_a_file(tmp_path, replayed):
    file = tmp_path / "flips.rrd"
    replayed(FLIPS, "--rrd", file)
    text = listing(file)
    assert "/bodies/1/ours" in text
    assert "/bodies/1/gravity" in text


def page_of(process):
    return re.search(r"http://\S+", await_line(process, "http://"))[0]


def is_open(port):
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def test_a_viewer_that_is_closed_is_reported_once():
    with closing(ViewerSink(view="web")) as sink:
        first, *rest = attitudes(ONE, 3, 100_000)
        sink.handle([first])
        sink.process._process.kill()
        sink.process._process.wait()
        with pytest.raises(ConnectionError, match="closed"):
            sink.handle(rest)
        sink.handle(rest)
        assert not sink.is_wanted


def test_a_port_that_another_took_is_given_up_and_no_usage_is_counted(monkeypatch, tmp_path):
    """Rerun keeps usage figures in its folder for data, and sends them with its next start."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        ports, free = [taken.getsockname()[1]], viewer_process._free_port
        chosen = lambda wanted: ports.pop() if ports else free(wanted)  # noqa: E731
        monkeypatch.setattr(viewer_process, "_free_port", chosen)
        with closing(viewer_process.ViewerProcess(web=True)) as process:
            assert not ports
            assert is_open(urlsplit(process.page).port)
    assert not list(tmp_path.rglob("*.json"))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the kernel's help is Linux's")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_the_viewer_ends_with_us_and_listens_on_loopback_only(number):
    with started("run", "--no-zenoh", "--json", "--view", "web") as process:
        port = urlsplit(page_of(process)).port
        assert is_open(port)
        found = [place for child in descendants(process.pid) for place in listening(child)]
        assert port in {number for _, number in found}
        assert all(is_loopback(host) for host, _ in found), found
        process.send_signal(number)
        assert process.wait(60) == (-9 if number == signal.SIGKILL else 0), process.stderr.read()
        wait_for(lambda: not is_open(port), 10.0)


@pytest.mark.slow
@pytest.mark.skipif(browser.program() is None, reason="no Chromium")
def test_the_page_shows_the_attitude_moving(tmp_path):
    """Screenshots go to the folder FUZZBEE_SCREENSHOTS."""
    image = pytest.importorskip("PIL.Image")
    folder = Path(os.environ.get("FUZZBEE_SCREENSHOTS", tmp_path))
    with started("run", "--no-zenoh", "--json", "--view", "web", "--rate", "20") as service:
        with browser.page(page_of(service), tmp_path / "profile") as page:
            shots = []
            end_s = time.monotonic() + 60.0
            while len(shots) < 3 and time.monotonic() < end_s:
                time.sleep(1.0)
                data = page.screenshot()
                pixels = np.asarray(image.open(io.BytesIO(data)).convert("RGB")).astype(int)
                height, width, _ = pixels.shape
                view = pixels[60 : int(0.55 * height), 10 : int(0.38 * width)]  # without its title
                if np.sum(view[..., 2] > 1.4 * np.maximum(view[..., 0], 1)) > 100:  # ours is drawn
                    (folder / f"viewer-{len(shots)}.png").write_bytes(data)
                    shots.append(view)
        service.send_signal(signal.SIGINT)
        assert service.wait(60) == 0, service.stderr.read()
    assert len(shots) == 3
    for before, after in pairwise(shots):
        assert np.sum(np.abs(before - after).max(axis=-1) > 40) > 200  # pixels: the vehicle turns


def test_without_the_extra_its_option_is_refused_and_nothing_else(monkeypatch, refused, printed):
    monkeypatch.setattr("fuzzbee.options.find_spec", lambda _: None)
    for option, what in (("--view=web", "the viewer"), ("--metrics=9099", "--metrics")):
        assert f"{what} needs the extra" in refused("run", "--no-zenoh", option)
    printed("run", "--no-zenoh", "--seconds", "0.2", "--json")


def test_points_go_on_though_the_host_s_clock_was_set_back(tmp_path):
    before = Published(ONE, record(time_unix_us=UNIX_US + 10_000_000))
    turns = [[before], *([each] for each in attitudes(ONE, 10, 200_000))]
    assert rows(drawn(tmp_path, turns), "/tilt/1") == 1 + 11  # with the lines' names
