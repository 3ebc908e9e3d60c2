"""Figures of replays: what is drawn, what is shaded, what is named, on paper and in a browser."""

import base64
import json
import re

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from fuzzbee.replays.plot import Thinned
from tests.fuzzbee import browser
from tests.fuzzbee.recording import DATA, FLIPS, SLOW, TAKEOFF, WITH_TRUTH, rewritten, table

Figure = pytest.importorskip("matplotlib.figure", reason="an extra is not installed").Figure
pytest.importorskip("plotly", reason="an extra is not installed")


@pytest.fixture
def page(replayed, tmp_path):
    """The curves of a replay's page by panel and name, with their y, and its layout."""

    def values(y):
        if isinstance(y, dict):
            return np.frombuffer(base64.b64decode(y["bdata"]), y["dtype"])
        return np.array(y, float)

    def draw(*arguments):
        replayed(*arguments, "--plot", tmp_path / "a.html")
        text = (tmp_path / "a.html").read_text("utf-8")
        begin = text.index("[", text.rindex("Plotly.newPlot("))
        data, end = json.JSONDecoder().raw_decode(text, begin)
        layout, _ = json.JSONDecoder().raw_decode(text, text.index("{", end))
        return {(t["yaxis"], t["name"]): values(t["y"]) for t in data if "name" in t}, layout

    return draw


@pytest.fixture
def drawn(monkeypatch):
    """The figures that are written."""
    figures, save = [], Figure.savefig

    def keep(figure, *arguments, **options):
        figures.append(figure)
        save(figure, *arguments, **options)

    monkeypatch.setattr(Figure, "savefig", keep)
    return figures


def legends_apart(figure):
    """How many legends: every one's box ends where axes begin, and all is within the page."""
    legends = [ax.get_legend() for ax in figure.axes if ax.get_legend() is not None]
    for legend in legends:
        box = legend.get_window_extent().padded(-1.0)  # they may touch
        assert not any(box.overlaps(ax.get_window_extent()) for ax in figure.axes)
        titles = [ax._left_title for ax in figure.axes if ax._left_title.get_text()]
        assert not any(box.overlaps(title.get_window_extent()) for title in titles)
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
    return len(legends)


def test_curves_are_the_reports_figures_and_legends_are_apart(replayed, page, tmp_path, drawn):
    report = replayed(SLOW, "--plot", tmp_path / "a.png")
    curves, layout = page(SLOW)
    assert legends_apart(drawn[0]) == 5
    lines = {line.get_label(): line.get_ydata() for line in drawn[0].axes[3].lines}
    reported = {"error": report["error_deg"], "autopilot's error": report["peers"]["autopilot"]}
    for name, errors in reported.items():
        assert np.array_equal(lines[name], curves["y4", name], equal_nan=True)
        rms = np.sqrt(np.nanmean(np.square(lines[name])))
        assert rms == pytest.approx(errors["inclination_rms"])
    on_paper = [text.get_text() for ax in drawn[0].axes for text in ax.texts]
    assert on_paper == [each["text"] for each in layout["annotations"]]
    replayed("sim:", "--seeds", "300-302", "--plot", tmp_path / "a.png")
    assert (legends_apart(drawn[1]), len(drawn[1].axes)) == (2, 7)


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf", "html"])
@pytest.mark.parametrize("what", [(SLOW,), ("sim:", "--profile", "adaptive", "--seeds", "300-301")])
def test_the_same_figure_twice_is_the_same_bytes(replayed, tmp_path, suffix, what):
    first, second = (tmp_path / f"{name}.{suffix}" for name in "ab")
    for file in (first, second):
        replayed(*what, "--plot", file)
    assert first.stat().st_size > 10_000
    assert first.read_bytes() == second.read_bytes()


def disturbed(path):
    """50 s at 20 Hz with clipping, a magnet and a hole; the truth is known for the first 35 s."""
    rng, rows = np.random.default_rng(2), []
    for k in range(1000):
        t, noise = k / 20.0, 0.002 * rng.standard_normal(3)
        gyr = (30.0, 0.0, 0.0) if 10.0 <= t < 10.3 else noise
        mag = np.array((0.2, 0.6, -0.4) if 20.0 <= t < 26.0 else (0.2, 0.0, 0.4)) + noise
        truth = (1, 0, 0, 0) if t < 35.0 else ("",) * 4
        rows.append(None if 40.0 <= t < 45.0 else (*gyr, 0.0, 0.0, -1.0, *mag, *truth))
    columns = (*(f"m{axis}_gauss" for axis in "xyz"), *"wxyz")
    table(path, 20.0, rows, columns).with_suffix(".toml").write_text(WITH_TRUTH)
    return path


def bands_of(layout):
    """Spans by name; all are in all panels, and the gain's names them."""
    shapes = [shape for shape in layout["shapes"] if "fillcolor" in shape]
    assert len(shapes) % 8 == 0
    names = {each["fillcolor"]: each["name"] for each in shapes if each.get("showlegend")}
    found = {}
    for each in shapes:
        if each["yref"].startswith("y6"):
            found.setdefault(names[each["fillcolor"]], []).append((each["x0"], each["x1"]))
    return found


def test_each_band_is_where_it_was(page, tmp_path):
    found = bands_of(page(disturbed(tmp_path / "a.csv"), "--start-wrong", 90)[1])
    assert found["gap"] == [pytest.approx((39.95, 45.0))]
    assert found["gyroscope at its end"] == [pytest.approx((10.0, 10.3), abs=0.11)]
    ((begin, end),) = found["low field confidence"]
    assert begin == pytest.approx(20.0, abs=0.5)
    assert 26.0 <= end < 36.0  # it is accepted again slowly
    ((begin, end),) = found["wrong start"]
    assert begin < 1.0
    assert begin < end < 10.0
    found = bands_of(page(SLOW)[1])
    assert found == {"no velocity": [pytest.approx((0.0, 2.3), abs=0.4)]}


def test_errors_that_are_cut_off_are_reported(replayed, tmp_path, drawn):
    replayed(SLOW, "--plot", tmp_path / "whole.png")
    replayed(disturbed(tmp_path / "a.csv"), "--start-wrong", 170, "--plot", tmp_path / "a.png")
    panels = [ax for figure in drawn for ax in figure.axes[3:5]]
    peaks = [max(np.nanmax(line.get_ydata()) for line in ax.lines) for ax in panels]
    is_cut = [peak > ax.get_ylim()[1] for ax, peak in zip(panels, peaks, strict=True)]
    assert set(is_cut) == {True, False}
    for ax, peak, cut in zip(panels, peaks, is_cut, strict=True):
        reported = [text.get_text() for text in ax.texts if text.get_text()]
        assert reported == ([f"cut off: up to {peak:.0f}°"] if cut else [])


def svg_texts(path):
    """The words in a figure, which the SVG spells out in comments."""
    return set(re.findall(r"<!-- (.+?) -->", path.read_text("utf-8")))


def test_curves_have_their_names_and_a_title_its_lines(replayed, tmp_path):
    name = "a_long_name_" * 12 + "of_a_flight"
    (tmp_path / f"{name}.tlog").write_bytes(SLOW.read_bytes())
    replayed(tmp_path / f"{name}.tlog", "--plot", tmp_path / "a.svg")
    texts = svg_texts(tmp_path / "a.svg")
    assert {"truth", "autopilot", "estimate", "autopilot's error", "error", "sigma"} <= texts
    lines = [text for text in texts if "a_long_name_" in text]
    assert len(lines) > 1
    assert max(map(len, lines)) <= 84
    replayed(DATA / "sub_bluerov.tlog", "--plot", tmp_path / "a.svg")
    texts = svg_texts(tmp_path / "a.svg")
    assert {"autopilot", "estimate", "difference"} <= texts
    assert not {"truth", "error", "autopilot's error"} & texts


def test_where_nothing_is_to_compare_a_figure_has_a_line(replayed, page, tmp_path, drawn):
    rows = [(0.001, 0, 1e-6 * (k % 7), 0, 0, -1) for k in range(100)]
    alone = table(tmp_path / "alone.csv", 50.0, rows)  # a log without a reference
    replayed(alone, "--plot", tmp_path / "a.png")
    replayed(alone, SLOW, "--plot", tmp_path / "b.png")
    single, several = (figure.axes for figure in drawn)
    assert [line.get_label() for ax in single[3:5] for line in ax.lines] == []
    labels = [ax.get_ylabel() for ax in single[3:5]]
    assert labels == ["inclination\nsigma in °", "heading\nsigma in °"]
    reported = [text.get_text() for ax in several[:2] for text in ax.texts]
    assert reported == ["nothing to compare with"] * 2
    texts = [each["text"] for each in page(alone, SLOW)[1]["annotations"]]
    assert texts.count("nothing to compare with") == 2


def test_of_many_points_the_peaks_are_drawn_and_no_line_across_a_gap():
    """Of 30,000 samples every other is drawn, the first behind the gap with the largest."""
    time_s = np.arange(30_000) * 0.01
    time_s[20_001:] += 5.0
    points = Thinned(time_s)
    at = np.flatnonzero(np.isnan(points.every(time_s)))
    assert points.time_s[at] == pytest.approx([0.5 * (time_s[20_000] + time_s[20_001])])
    assert np.all(np.diff(points.time_s) > 0.0)
    assert np.array_equal(np.delete(points.every(time_s), at), time_s[::2])
    assert np.nanmax(points.largest(time_s[:, None])) == time_s[-1]
    assert np.isnan(points.largest(np.full((30_000, 2), np.nan))).all()


def test_an_angle_is_cut_at_the_sample_behind_its_wrap(page):
    curves, _ = page(FLIPS)
    for panel in ("y", "y2", "y3"):
        assert np.nanmax(np.abs(np.diff(curves[panel, "estimate"]))) < 180.0
    assert np.isnan(curves["y", "estimate"]).sum() == 2  # two rolls, right round


BEATS = {0.5: (0, False), 3.0: (0, True), 5.0: (5, True), 8.0: (6, False)}  # mode, armed or not
TEXTS = {6.0: (4, b"EKF variance"), 6.5: (6, b"mission begins")}  # the latter for information
SENT = {
    s: dialect.MAVLink_heartbeat_message(2, 3, 1 + 128 * armed, mode, 4, 3)
    for s, (mode, armed) in BEATS.items()
} | {s: dialect.MAVLink_statustext_message(*words) for s, words in TEXTS.items()}


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ((), ["STABILIZE", "armed", "LOITER", "EKF variance", "RTL", "disarmed"]),
        (("--from", "7"), ["LOITER", "RTL", "disarmed"]),  # begins with the mode that it is in
    ],
)
def test_modes_arming_and_warnings_are_named(page, tmp_path, options, expected):
    waiting = sorted(SENT.items(), key=lambda each: each[0])

    def change(seconds, message):
        due = [words for at_s, words in waiting if at_s <= seconds]
        del waiting[: len(due)]
        kept = [] if message.get_type() == "HEARTBEAT" else [message]
        return [*due, *kept] if due or not kept else None

    _, layout = page(rewritten(TAKEOFF, tmp_path / "sent.tlog", change), *options)
    named = [(each["x"], each["text"]) for each in layout["annotations"] if each["xref"] == "x"]
    assert sorted(name for _, name in named) == sorted(expected)
    assert [x for x, _ in named] == sorted(x for x, _ in named)


@pytest.mark.skipif(browser.program() is None, reason="there is no Chromium")
def test_the_panels_of_a_page_zoom_together_without_a_network(page, tmp_path):
    """The mouse is drawn over the second quarter of the third panel."""
    page(SLOW)
    layout = "document.getElementById('fuzzbee')._fullLayout"
    of = f"Object.keys({layout}).filter(k => k.startsWith('xaxis')).map(k => {layout}[k].range)"
    panel = "document.querySelector('.nsewdrag[data-subplot=x3y3]').getBoundingClientRect()"
    options = "document.querySelector('pre').textContent"
    with browser.page("about:blank", tmp_path / "browser") as seen:
        seen.call("Page.navigate", url=(tmp_path / "a.html").as_uri())
        seen.wait_for("document.querySelectorAll('#fuzzbee .main-svg').length > 0")
        end_s = float(seen.value(options).split()[-1])
        box = json.loads(seen.value(f"JSON.stringify({panel})"))
        for kind, part in (("Pressed", 0.25), ("Moved", 0.4), ("Moved", 0.5), ("Released", 0.5)):
            place = {"x": box["x"] + part * box["width"], "y": box["y"] + 0.5 * box["height"]}
            button = {"button": "left", "buttons": 1, "clickCount": 1}
            seen.call("Input.dispatchMouseEvent", type=f"mouse{kind}", **place, **button)
        seen.wait_for(f"!{options}.includes('--from 0.0')")
        ranges = json.loads(seen.value(f"JSON.stringify({of})"))
        assert ranges == [pytest.approx([0.25 * end_s, 0.5 * end_s], rel=0.02)] * 8
        assert seen.value("performance.getEntriesByType('resource').length") == 0
