"""CSV, MCAP and figures of a replay: complete, readable, and the same twice."""

import csv
import json
import re
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from drivers.mavlink.framing import frame_end
from estimator.geometry.frames import enu_flu_from_ned_frd
from fuzzbee.cli import main
from fuzzbee.replays import parquet_file
from fuzzbee.replays.exports import ATTITUDE_COLUMNS, COLUMNS
from fuzzbee.replays.simulation_files import COLUMNS as SIMULATION_COLUMNS
from fuzzbee.replays.thinned import Thinned, largest

LOG = Path(__file__).parent.parent / "data" / "sitl_copter_4hz.tlog"


def replay(capsys, *arguments):
    status = main(["replay", *map(str, arguments)])
    out, err = capsys.readouterr()
    return status, out, err


def test_csv_holds_every_sample_with_its_reference(capsys, tmp_path):
    _, out, _ = replay(capsys, LOG, "--csv", tmp_path / "a.csv", "--json")
    report = json.loads(out)
    with (tmp_path / "a.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == COLUMNS
    assert len(rows) == report["imu"]["samples"]
    assert float(rows[-1]["time_s"]) == pytest.approx(report["duration_s"])
    compared = [float(r["error_inclination_deg"]) for r in rows if r["error_inclination_deg"]]
    squares = sum(e * e for e in compared) / len(compared)
    assert squares**0.5 == pytest.approx(report["error_deg"]["inclination_rms"], rel=1e-6)


def test_parquet_has_the_rows_of_the_csv(capsys, tmp_path, monkeypatch):
    """Written in parts, of which the last is not full."""
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    monkeypatch.setattr(parquet_file, "ROWS_AT_ONCE", 250)
    files = ("--csv", tmp_path / "a.csv", "--parquet", tmp_path / "a.parquet")
    replay(capsys, LOG, *files, "--json")
    with (tmp_path / "a.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    table = parquet.read_table(tmp_path / "a.parquet").to_pylist()
    assert tuple(table[0]) == COLUMNS
    assert len(table) == len(rows)
    assert len(table) > 500
    assert len(table) % 250
    for ours, text in zip(table[::50], rows[::50], strict=True):
        for name, value in ours.items():
            told = text[name] or None
            is_text = name == "heading_reference" or told is None
            # the text has nine digits
            assert value == (told if is_text else pytest.approx(float(told), rel=1e-8, abs=1e-12))


def test_trajectories_turn_as_the_errors_say(capsys, tmp_path):
    """East-North-Up to forward-left-up, beside the reference; between both lies the error.

    The autopilot's attitude begins after the first sample.
    """
    files = ("--csv", tmp_path / "a.csv", "--tum", tmp_path / "a.tum")
    replay(capsys, LOG, "--reference", "autopilot", *files, "--json")
    with (tmp_path / "a.csv").open(newline="") as file:
        every = list(csv.DictReader(file))
    rows = [row for row in every if row["error_total_deg"]]
    estimates, lines = (np.loadtxt(tmp_path / name) for name in ("a.tum", "a.reference.tum"))
    ours = {t: (w, x, y, z) for t, *_, x, y, z, w in estimates}
    assert len(estimates) == len(every) > len(rows) == len(lines) > 100
    assert not estimates[:, 1:4].any()
    assert not lines[:, 1:4].any()
    for (t, *_, x, y, z, w), row in zip(lines, rows, strict=True):
        assert t == pytest.approx(float(row["time_unix_s"]), abs=1e-5)
        error = 2 * np.degrees(np.arccos(min(1.0, abs(np.dot(ours[t], (w, x, y, z))))))
        assert error == pytest.approx(float(row["error_total_deg"]), abs=0.01)
    q = tuple(float(rows[-1][f"q_{axis}"]) for axis in "wxyz")
    assert abs(np.dot(ours[lines[-1][0]], enu_flu_from_ned_frd(q))) == pytest.approx(1.0, abs=1e-8)


def read_mcap(path):
    """(schema, topic, time in ns, data) of every message."""
    reader = pytest.importorskip("mcap.reader", reason="the extra 'mcap' is not installed")
    with path.open("rb") as file:
        return [
            (schema, channel.topic, message.log_time, message.data)
            for schema, channel, message in reader.make_reader(file).iter_messages()
        ]


def test_mcap_holds_the_same_and_is_read_by_the_library(capsys, tmp_path):
    _, out, _ = replay(capsys, LOG, "--mcap", tmp_path / "a.mcap", "--json")
    messages = read_mcap(tmp_path / "a.mcap")
    attitudes = [
        (time, json.loads(data)) for _, topic, time, data in messages if topic == "/attitude"
    ]
    assert len(attitudes) == json.loads(out)["imu"]["samples"]
    assert set(attitudes[0][1]) == set(ATTITUDE_COLUMNS)
    assert attitudes[-1][0] == pytest.approx(1e9 * attitudes[-1][1]["time_unix_s"], abs=1000)
    assert any(topic == "/reference" for _, topic, _, _ in messages)


def test_dates_are_those_of_the_log(capsys, tmp_path):
    """The log's own stamps, read by pymavlink, carried over to a clock that is steady."""
    from pymavlink import mavutil

    with closing(mavutil.mavlink_connection(str(LOG))) as log:
        messages = iter(lambda: log.recv_match(type="RAW_IMU"), None)
        stamps = [message._timestamp for message in messages]
    replay(capsys, LOG, "--csv", tmp_path / "a.csv", "--json")
    with (tmp_path / "a.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    dates = np.array([float(row["time_unix_s"]) for row in rows])
    times = np.array([float(row["time_s"]) for row in rows])
    # no stamp lies before its sample; the recording stamps them 76 ms late at most
    lateness = np.array(stamps[-len(dates) :]) - dates
    assert -1e-3 < lateness.min() < 1e-3
    assert lateness.max() < 0.092
    assert np.all(np.diff(dates) > 0.0)
    # by how much one clock is moved against the other between two samples: 4.7 ms at most
    assert np.abs(np.diff(dates - times)).max() < 5.7e-3


def test_a_log_without_dates_has_none(capsys, tmp_path):
    """PX4's clock of a clip that begins before the first fix counts from its start."""
    hover = LOG.with_name("px4_hover.ulg")
    replay(capsys, hover, "--csv", tmp_path / "a.csv", "--mcap", tmp_path / "a.mcap", "--json")
    with (tmp_path / "a.csv").open(newline="") as file:
        assert {row["time_unix_s"] for row in csv.DictReader(file)} == {""}
    assert read_mcap(tmp_path / "a.mcap")[0][2] == 0


@pytest.mark.parametrize("stamp_us", [1 << 62, (1 << 31) * 10**6])
def test_stamps_after_any_date_are_no_dates(capsys, tmp_path, stamp_us):
    """ROS and Foxglove have 31 bits for the seconds."""
    log, data, at = tmp_path / "late.tlog", bytearray(LOG.read_bytes()), 0
    while at + 8 < len(data):
        begin, at = at, frame_end(data, at + 8)
        data[begin : begin + 8] = (stamp_us + 100 * begin).to_bytes(8, "big")
    log.write_bytes(data)
    replay(capsys, log, "--csv", tmp_path / "a.csv", "--mcap", tmp_path / "a.mcap", "--json")
    with (tmp_path / "a.csv").open(newline="") as file:
        assert {row["time_unix_s"] for row in csv.DictReader(file)} == {""}
    assert read_mcap(tmp_path / "a.mcap")[0][2] == 0


def test_mcap_has_the_types_that_viewers_draw(capsys, tmp_path):
    """Each message decoded by the schema in the file itself, with rosbags; axes as ROS has them."""
    rosbags = pytest.importorskip("rosbags.typesys")
    replay(capsys, LOG, "--mcap", tmp_path / "a.mcap", "--json")
    messages = read_mcap(tmp_path / "a.mcap")
    schema, *_ = next(each for each in messages if each[1] == "/imu")
    assert (schema.name, schema.encoding) == ("sensor_msgs/msg/Imu", "ros2msg")
    types = rosbags.get_typestore(rosbags.Stores.EMPTY)
    types.register(rosbags.get_types_from_msg(schema.data.decode(), schema.name))
    standard = rosbags.get_typestore(rosbags.Stores.ROS2_JAZZY)
    assert types.hash_rihs01(schema.name) == standard.hash_rihs01(schema.name)
    imus = [
        (time, types.deserialize_cdr(data, schema.name))
        for _, topic, time, data in messages
        if topic == "/imu"
    ]
    poses = [json.loads(data) for _, topic, _, data in messages if topic == "/tf"]
    ours = [pose for pose in poses if pose["child_frame_id"] == "base_link"]
    assert {pose["child_frame_id"] for pose in poses} == {"base_link", "reference"}
    assert len(ours) == len(imus) > 100
    for pose, (time_ns, imu) in zip(ours, imus, strict=True):
        stamp, q = pose["timestamp"], imu.orientation
        assert 10**9 * stamp["sec"] + stamp["nsec"] == time_ns
        assert pose["rotation"] == {"x": q.x, "y": q.y, "z": q.z, "w": q.w}
    # hovering level: up is up, and the accelerometer feels the ground's push
    level = imus[len(imus) // 2][1]
    assert level.orientation.x**2 + level.orientation.y**2 < 0.02
    assert level.linear_acceleration.z == pytest.approx(9.8, abs=1.0)


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_the_same_replay_twice_gives_the_same_bytes(capsys, tmp_path, suffix):
    for module in ("mcap", "matplotlib"):
        pytest.importorskip(module, reason="an extra is not installed")
    for name in "ab":
        files = {each: tmp_path / f"{name}.{each}" for each in ("csv", "mcap", suffix)}
        options = ("--csv", files["csv"], "--mcap", files["mcap"], "--plot", files[suffix])
        assert replay(capsys, LOG, *options, "--json")[0] == 0
    for each in files:
        first, second = ((tmp_path / f"{name}.{each}").read_bytes() for name in "ab")
        assert len(first) > 1000
        assert first == second


def test_csv_of_the_experiment_gives_its_cost_and_its_settling(capsys, tmp_path):
    """Every sample of every seed: the reported figures come out of the file again."""
    file = tmp_path / "a.csv"
    _, out, _ = replay(capsys, "sim:", "--seeds", "300-302", "--csv", file, "--json")
    report = json.loads(out)
    with file.open(newline="") as lines:
        rows = list(csv.DictReader(lines))
    assert tuple(rows[0]) == SIMULATION_COLUMNS
    assert len(rows) == report["imu"]["samples"]
    e = np.array([float(row["error"]) for row in rows]).reshape(3, -1)
    J = 0.3 * e[:, :101].sum(axis=1) + e[:, 400:1401].sum(axis=1)
    assert J.tolist() == pytest.approx(report["cost_per_seed"], rel=1e-6)
    assert np.median(np.argmax(e < 0.01, axis=1)) / 100.0 == pytest.approx(report["settling_s"])
    total = np.radians([float(row["error_total_deg"]) for row in rows])
    assert np.sin(total / 2.0) ** 2 == pytest.approx(e.ravel(), abs=1e-8)
    gains = [float(row["gain"]) for row in rows]
    assert np.mean(gains) == pytest.approx(report["mean_gain"], rel=1e-6)


def test_the_papers_figures_are_drawn_the_same_twice(capsys, tmp_path):
    pytest.importorskip("matplotlib", reason="the extra 'plot' is not installed")
    files = [tmp_path / f"{name}.pdf" for name in "ab"]
    for file in files:
        arguments = ("sim:", "--profile", "adaptive", "--seeds", "300-303", "--plot", file)
        assert replay(capsys, *arguments, "--json")[0] == 0
    first, second = (file.read_bytes() for file in files)
    assert len(first) > 10_000
    assert first == second


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ((LOG, LOG, "--csv", "a.csv"), "takes one log"),
        ((LOG, "--plot", "a.jpeg"), ".png, .svg, .pdf"),
        ((LOG, "--csv", "missing/a.csv"), "missing"),
        ((LOG, "--tum", "missing/a.tum"), "missing"),
        ((LOG, "--parquet", "missing/a.parquet"), "missing"),
        (("sim:", "--mcap", "a.mcap"), "is for logs"),
        (("sim:", "--plot", "a.jpeg"), ".png, .svg, .pdf"),
        (("sim:", "--csv", "missing/a.csv"), "missing"),
    ],
)
def test_what_cannot_be_written_is_one_line(capsys, tmp_path, monkeypatch, arguments, expected):
    monkeypatch.chdir(tmp_path)
    status, out, err = replay(capsys, *arguments)
    assert status == 2
    assert out == ""
    assert expected in err
    assert err.count("\n") == 1


@pytest.fixture
def drawn(monkeypatch):
    """The figures that are written."""
    figure_type = pytest.importorskip("matplotlib.figure").Figure
    figures, save = [], figure_type.savefig

    def keep(figure, *arguments, **options):
        figures.append(figure)
        save(figure, *arguments, **options)

    monkeypatch.setattr(figure_type, "savefig", keep)
    return figures


def test_a_plots_curves_are_the_reports_figures_beside_its_legends(capsys, tmp_path, drawn):
    _, out, _ = replay(capsys, LOG, "--plot", tmp_path / "a.png", "--json")
    report = json.loads(out)
    assert legends_apart(drawn[0]) == 5
    lines = {line.get_label(): line for line in drawn[0].axes[3].lines}
    for name, errors in (
        ("error", report["error_deg"]),
        ("autopilot's error", report["peers"]["autopilot"]),
    ):
        rms = np.sqrt(np.nanmean(np.square(lines[name].get_ydata())))
        assert rms == pytest.approx(errors["inclination_rms"])


def test_bands_have_names_and_errors_are_not_cut_off_without_a_word(capsys, tmp_path, drawn):
    """A clip with a hole of 40 s in the stream, and a wrong start that is over soon."""
    log = tmp_path / "hole.csv"
    replay(capsys, LOG, "--plot", tmp_path / "whole.png")
    times = [k * 0.02 + (40.0 if k > 3000 else 0.0) for k in range(6000)]
    heading = "time_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_g,ay_g,az_g,mx_gauss,my_gauss,mz_gauss,w,x,y,z"
    rows = [
        f"{t:.2f},0.001,0,{1e-6 * (k % 7)},0,0,-1,0.2,0,0.4,1,0,0,0" for k, t in enumerate(times)
    ]
    log.write_text("\n".join([heading, *rows]))
    log.with_suffix(".toml").write_text('axes = "frd"\ntruth = { columns = ["w", "x", "y", "z"] }')
    arguments = ("--start-wrong", 170, "--plot", tmp_path / "a.png", "--json")
    assert replay(capsys, log, *arguments)[0] == 0
    whole, holed = drawn
    panels = [ax for figure in (whole, holed) for ax in figure.axes[3:5]]
    peaks = [max(np.nanmax(line.get_ydata()) for line in ax.lines) for ax in panels]
    is_cut = [peak > ax.get_ylim()[1] for ax, peak in zip(panels, peaks, strict=True)]
    assert set(is_cut) == {True, False}
    for ax, peak, cut in zip(panels, peaks, is_cut, strict=True):
        told = [text.get_text() for text in ax.texts]
        assert told == ([f"cut off: errors up to {peak:.0f}°"] if cut else [])
    named = [{t.get_text() for t in figure.axes[5].get_legend().get_texts()} for figure in drawn]
    assert named == [{"no velocity"}, {"wrong start", "gap"}]


def svg_texts(path):
    """The words in a figure, which the SVG spells out where told to."""
    return set(re.findall(r"<!-- (.+?) -->", path.read_text("utf-8")))


def test_a_plot_has_the_autopilots_curve_beside_the_truth_and_the_whole_title(capsys, tmp_path):
    pytest.importorskip("matplotlib", reason="the extra 'plot' is not installed")
    name = "a_long_name_" * 12 + "of_a_flight"
    (tmp_path / f"{name}.tlog").write_bytes(LOG.read_bytes())
    assert replay(capsys, tmp_path / f"{name}.tlog", "--plot", tmp_path / "a.svg", "--json")[0] == 0
    texts = svg_texts(tmp_path / "a.svg")
    assert {"truth", "autopilot", "estimate", "autopilot's error", "error", "sigma"} <= texts
    lines = [text for text in texts if "a_long_name_" in text]
    assert len(lines) > 1
    assert max(map(len, lines)) <= 84


def test_a_plot_without_a_truth_has_no_peer(capsys, tmp_path):
    pytest.importorskip("matplotlib", reason="the extra 'plot' is not installed")
    log = LOG.with_name("sub_bluerov.tlog")
    assert replay(capsys, log, "--plot", tmp_path / "a.svg", "--json")[0] == 0
    texts = svg_texts(tmp_path / "a.svg")
    assert {"autopilot", "estimate", "difference"} <= texts
    assert not {"truth", "error", "autopilot's error"} & texts


@pytest.fixture
def alone(tmp_path):
    """A log without a reference."""
    log = tmp_path / "alone.csv"
    rows = [f"{0.02 * k:.2f},0.001,0,{1e-6 * (k % 7)},0,0,-1" for k in range(100)]
    log.write_text("\n".join(["time_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_g,ay_g,az_g", *rows]))
    return log


def test_a_page_has_the_words_of_its_first_panel_too(capsys, tmp_path, alone):
    pytest.importorskip("plotly", reason="the extra 'page' is not installed")
    assert replay(capsys, alone, LOG, "--plot", tmp_path / "a.html")[0] == 0
    assert (tmp_path / "a.html").read_text("utf-8").count("nothing to compare with") == 2


def test_where_nothing_is_to_compare_a_figure_says_so(capsys, tmp_path, drawn, alone):
    assert replay(capsys, alone, "--plot", tmp_path / "a.png", "--json")[0] == 0
    assert replay(capsys, alone, LOG, "--plot", tmp_path / "b.png", "--json")[0] == 0
    single, several = (figure.axes for figure in drawn)
    assert [line.get_label() for ax in single[3:5] for line in ax.lines] == []
    assert [ax.get_ylabel() for ax in single[3:5]] == [
        "inclination\nsigma in °",
        "heading\nsigma in °",
    ]
    told = [[text.get_text() for text in ax.texts] for ax in several]
    assert told[:2] == [["nothing to compare with"]] * 2
    peaks = [np.nanmax(ax.lines[0].get_ydata()) for ax in several[2:]]
    cut = [bool(peak > ax.get_ylim()[1]) for ax, peak in zip(several[2:], peaks, strict=True)]
    assert any(cut)
    assert told[2:] == [
        [f"cut off: errors up to {p:.0f}°"] * c for p, c in zip(peaks, cut, strict=True)
    ]


def test_no_legend_of_the_papers_figures_lies_on_its_data(capsys, tmp_path, drawn):
    assert replay(capsys, "sim:", "--seeds", "300-302", "--plot", tmp_path / "a.png")[0] == 0
    assert legends_apart(drawn[0]) == 2


def legends_apart(figure):
    """How many legends: every one's box ends where axes begin, and all is within the page."""
    legends = [ax.get_legend() for ax in figure.axes if ax.get_legend() is not None]
    for legend in legends:
        box = legend.get_window_extent().padded(-1.0)  # they may touch
        assert not any(box.overlaps(ax.get_window_extent()) for ax in figure.axes)
        titles = [ax.title for ax in figure.axes] + [ax._left_title for ax in figure.axes]
        drawn = [title.get_window_extent() for title in titles if title.get_text()]
        assert not any(box.overlaps(each) for each in drawn)
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
    return len(legends)


def test_of_many_errors_the_peaks_are_drawn():
    values = np.array([[1.0, np.nan], [9.0, np.nan], [2.0, 3.0], [np.nan, 1.0], [4.0, np.nan]])
    drawn = largest(values, 3)
    assert np.array_equal(drawn, [[9.0, 3.0], [4.0, 1.0]])
    assert np.isnan(largest(np.full((4, 2), np.nan), 3)).all()


def test_no_line_is_drawn_across_a_gap():
    """Of 30,000 samples every other is drawn, the first behind the gap with the largest."""
    time_s = np.arange(30_000) * 0.01
    time_s[20_001:] += 5.0
    points = Thinned(time_s)
    at = np.flatnonzero(np.isnan(points.every(time_s)))
    assert points.time_s[at] == pytest.approx([0.5 * (time_s[20_000] + time_s[20_001])])
    assert np.all(np.diff(points.time_s) > 0.0)
    assert np.array_equal(np.delete(points.every(time_s), at), time_s[::2])
    assert np.nanmax(points.largest(time_s[:, None])) == time_s[-1]


def test_a_figure_is_broken_where_the_log_is(capsys, tmp_path, drawn):
    log, content = tmp_path / "a.tlog", LOG.read_bytes()
    middle = len(content) // 2
    log.write_bytes(content[:middle] + content[middle + 100_000 :])
    assert replay(capsys, log, "--plot", tmp_path / "a.png")[0] == 0
    for ax in drawn[0].axes:
        spans = [(p.get_x(), p.get_x() + p.get_width()) for p in ax.patches]
        ((begin, end),) = {span for span in spans if span[1] - span[0] > 10.0}
        curves = [line for line in ax.lines if line.get_label() != "_mark"]
        assert curves
        for line in curves:
            x, y = (np.asarray(part, float) for part in line.get_data())
            assert np.isnan(y[(x > begin) & (x < end)]).tolist() == [True]
