"""CSV, Parquet, MCAP and trajectories of a replay, also of a long log: complete and readable."""

import csv
import json
from contextlib import closing

import numpy as np
import pytest

from drivers.logs import table
from estimator.geometry.frames import swap_ned_enu
from estimator.geometry.metrics import rms
from tests.fuzzbee.recording import DATA, SLOW, frames_of
from tests.programs import run_python

COLUMNS = (
    "time_s time_unix_s q_w q_x q_y q_z roll_deg pitch_deg yaw_deg"
    " rate_x_rad_s rate_y_rad_s rate_z_rad_s bias_x_rad_s bias_y_rad_s bias_z_rad_s"
    " error error_rate_1_s gain confidence_gravity confidence_magnetic"
    " sigma_inclination_deg sigma_heading_deg heading_reference"
    " reference_q_w reference_q_x reference_q_y reference_q_z"
    " reference_roll_deg reference_pitch_deg reference_yaw_deg"
    " error_total_deg error_heading_deg error_inclination_deg"
)


@pytest.fixture
def rows_of(replayed, tmp_path):
    """The report of a replay, and the rows of its CSV."""

    def run(log, *options):
        report = replayed(log, "--csv", tmp_path / "a.csv", *options)
        with (tmp_path / "a.csv").open(newline="") as file:
            return report, list(csv.DictReader(file))

    return run


def column(rows, name):
    return np.array([float(row[name]) for row in rows])


def test_csv_holds_every_sample_with_its_reference(rows_of):
    report, rows = rows_of(SLOW)
    assert " ".join(rows[0]) == COLUMNS
    assert len(rows) == report["imu"]["samples"]
    assert float(rows[-1]["time_s"]) == pytest.approx(report["duration_s"])
    compared = [float(r["error_inclination_deg"]) for r in rows if r["error_inclination_deg"]]
    assert rms(compared) == pytest.approx(report["error_deg"]["inclination_rms"], rel=1e-6)


def test_parquet_has_the_rows_of_the_csv(rows_of, tmp_path, monkeypatch):
    """Written in parts, of which the last is not full. The autopilot's attitude begins late."""
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    monkeypatch.setattr(table, "BLOCK", 250)
    _, rows = rows_of(SLOW, "--reference", "autopilot", "--parquet", tmp_path / "a.parquet")
    found = parquet.read_table(tmp_path / "a.parquet")
    assert " ".join(found.column_names) == COLUMNS
    assert len(found) == len(rows) > 500
    assert len(found) % 250
    for name, values in found.to_pydict().items():
        texts = [row[name] or None for row in rows]
        if name != "heading_reference":  # the text has nine digits
            texts = [text and pytest.approx(float(text), rel=1e-8, abs=1e-12) for text in texts]
        assert values == texts


def test_trajectories_turn_as_the_errors_say(rows_of, tmp_path):
    """East-North-Up to forward-left-up; the reference begins after the first sample."""
    _, every = rows_of(SLOW, "--reference", "autopilot", "--tum", tmp_path / "a.tum")
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
    assert abs(np.dot(ours[lines[-1][0]], swap_ned_enu(q))) == pytest.approx(1.0, abs=1e-8)


def read_mcap(path):
    """(schema, topic, time in ns, data) of every message."""
    reader = pytest.importorskip("mcap.reader", reason="the extra 'mcap' is not installed")
    with path.open("rb") as file:
        messages = reader.make_reader(file).iter_messages()
        return [(schema, channel.topic, m.log_time, m.data) for schema, channel, m in messages]


def stamps_of(path):
    """When each RAW_IMU was received, read by pymavlink."""
    from pymavlink import mavutil

    with closing(mavutil.mavlink_connection(str(path))) as log:
        messages = iter(lambda: log.recv_match(type="RAW_IMU"), None)
        return [message._timestamp for message in messages]


def test_dates_are_those_of_the_log(rows_of):
    """The log's own stamps, carried over to a clock that is steady."""
    stamps, (_, rows) = stamps_of(SLOW), rows_of(SLOW)
    dates, times = column(rows, "time_unix_s"), column(rows, "time_s")
    # no stamp lies before its sample; the recording stamps them 76 ms late at most
    lateness = np.array(stamps[-len(dates) :]) - dates
    assert -1e-3 < lateness.min() < 1e-3
    assert lateness.max() < 0.092
    assert np.all(np.diff(dates) > 0.0)
    # by how much one clock is moved against the other between two samples: 4.7 ms at most
    assert np.abs(np.diff(dates - times)).max() < 5.7e-3


def restamped(made, change):
    """A copy of the log whose stamps are ``change(stamp_us, share of the frames before it)``."""
    frames = frames_of(SLOW)
    stamps = (change(us, number / len(frames)) for number, (us, _) in enumerate(frames))
    parts = [us.to_bytes(8, "big") + data for us, (_, data) in zip(stamps, frames, strict=True)]
    made.write_bytes(b"".join(parts))
    return made


@pytest.mark.parametrize("stamp_us", [None, 1 << 62, (1 << 31) * 10**6])
def test_stamps_that_are_no_dates_are_none(rows_of, tmp_path, stamp_us):
    """PX4's clock before the first fix counts from its start; ROS has 31 bits for the seconds."""
    log = SLOW.with_name("px4_hover.ulg")
    if stamp_us is not None:
        log = restamped(tmp_path / "late.tlog", lambda _, share: stamp_us + round(1e7 * share))
    _, rows = rows_of(log, "--mcap", tmp_path / "a.mcap")
    assert {row["time_unix_s"] for row in rows} == {""}
    assert read_mcap(tmp_path / "a.mcap")[0][2] == 0


def test_mcap_has_the_rows_and_the_types_that_viewers_draw(replayed, tmp_path):
    """Each message decoded by the schema in the file itself, with rosbags; axes as ROS has them."""
    rosbags = pytest.importorskip("rosbags.typesys")
    report = replayed(SLOW, "--mcap", tmp_path / "a.mcap")
    messages = read_mcap(tmp_path / "a.mcap")
    by_topic = {topic: [] for _, topic, _, _ in messages}
    for _, topic, time, data in messages:
        by_topic[topic].append((time, data))
    attitudes = [(time, json.loads(data)) for time, data in by_topic["/attitude"]]
    assert len(attitudes) == report["imu"]["samples"]
    assert " ".join(attitudes[0][1]) == COLUMNS.partition(" reference_q_w")[0]
    assert attitudes[-1][0] == pytest.approx(1e9 * attitudes[-1][1]["time_unix_s"], abs=1000)
    assert "/reference" in by_topic
    with (tmp_path / "a.mcap").open("rb") as file:
        chunks = pytest.importorskip("mcap.reader").make_reader(file).get_summary().chunk_indexes
    assert {chunk.compression for chunk in chunks} == {"zstd"}
    schema, *_ = next(each for each in messages if each[1] == "/imu")
    assert (schema.name, schema.encoding) == ("sensor_msgs/msg/Imu", "ros2msg")
    types = rosbags.get_typestore(rosbags.Stores.EMPTY)
    types.register(rosbags.get_types_from_msg(schema.data.decode(), schema.name))
    standard = rosbags.get_typestore(rosbags.Stores.ROS2_JAZZY)
    assert types.hash_rihs01(schema.name) == standard.hash_rihs01(schema.name)
    imus = [(time, types.deserialize_cdr(data, schema.name)) for time, data in by_topic["/imu"]]
    poses = [json.loads(data) for _, data in by_topic["/tf"]]
    ours = [pose for pose in poses if pose["child_frame_id"] == "base_link"]
    assert {pose["child_frame_id"] for pose in poses} == {"base_link", "reference"}
    assert len(ours) == len(imus) > 100
    for pose, (time_ns, imu) in zip(ours, imus, strict=True):
        stamp, q = pose["timestamp"], imu.orientation
        assert 10**9 * stamp["sec"] + stamp["nsec"] == time_ns
        assert pose["rotation"] == pytest.approx({"x": q.x, "y": q.y, "z": q.z, "w": q.w})
    # hovering level: up is up, and the accelerometer feels the ground's push
    level = imus[len(imus) // 2][1]
    assert level.orientation.x**2 + level.orientation.y**2 < 0.02
    assert level.linear_acceleration.z == pytest.approx(9.8, abs=1.0)


def test_csv_of_the_experiment_gives_its_cost_and_its_settling(rows_of):
    """Every sample of every seed: the reported figures come out of the file again."""
    report, rows = rows_of("sim:", "--seeds", "300-302")
    assert {*rows[0]} - {*COLUMNS.split()} == {"seed"}
    assert len(rows) == report["imu"]["samples"]
    e = column(rows, "error").reshape(3, -1)
    J = 0.3 * e[:, :101].sum(axis=1) + e[:, 400:1401].sum(axis=1)
    assert J.tolist() == pytest.approx(report["cost_per_seed"], rel=1e-6)
    assert np.median(np.argmax(e < 0.01, axis=1)) / 100.0 == pytest.approx(report["settling_s"])
    total = np.radians(column(rows, "error_total_deg"))
    assert np.sin(total / 2.0) ** 2 == pytest.approx(e.ravel(), abs=1e-8)
    assert np.mean(column(rows, "gain")) == pytest.approx(report["mean_gain"], rel=1e-6)


def test_a_reboot_moves_the_dates_at_once_and_a_clock_that_is_set_never_back(rows_of, tmp_path):
    log = DATA / "copter_reboot.tlog"
    dates = column(rows_of(log)[1], "time_unix_s")
    stamps = np.array([-np.inf, *stamps_of(log), np.inf])
    after = stamps[np.searchsorted(stamps, dates)] - dates
    assert after.max() < 1.0  # a radio holds it back for 0.64 s at most
    log = restamped(tmp_path / "back.tlog", lambda us, share: us - 2_000_000 * (share > 0.5))
    dates = column(rows_of(log)[1], "time_unix_s")
    assert len(dates) > 500
    assert np.diff(dates).min() == 0.0


# --- logs of more samples than are held in memory: the same figures and files


@pytest.fixture
def written(replayed, tmp_path):
    """The figures, and what was written."""

    def run(log, *options):
        files = [f"--{kind}={tmp_path}/flight.{kind}" for kind in ("csv", "tum", "mcap")]
        figures = replayed(DATA / log, *files, *options)
        del figures["wall_s"]
        return figures, {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    return run


def close(some, others):
    """Whether two reports are the same but for the order of their sums."""
    if isinstance(some, dict):
        return some.keys() == others.keys() and all(close(some[k], others[k]) for k in some)
    return some == pytest.approx(others, rel=1e-12) if isinstance(some, float) else some == others


@pytest.mark.parametrize(
    ("log", "options"),
    [
        ("sitl_copter_4hz.tlog", ("--skip", "20")),
        ("sub_bluerov.tlog", ("--start-wrong", "170")),
        ("sub_on_its_side.tlog", ("--smooth",)),
    ],
)
def test_a_replay_in_small_parts_is_the_same(written, monkeypatch, log, options):
    whole = written(log, *options)
    for name, rows in (("BLOCK", 70), ("WAITING", 70), ("IN_MEMORY", 90)):
        monkeypatch.setattr(table, name, rows)
    parts = written(log, *options)
    assert close(whole[0], parts[0])
    assert whole[1] == parts[1]


LONG = """
import sys
from pathlib import Path
import numpy as np
from drivers.events import ReferenceAttitude, VehicleId
from drivers.logs.open import open_log
from estimator.estimator import Estimator
from estimator.profile import load_profile
from estimator.types import IDENTITY, Attitude, ImuSample
from fuzzbee.replays.score import compare, score
from fuzzbee.replays.trace import VehicleTrace
from service.vehicle import Vehicle

def most_kb():
    line = next(each for each in open("/proc/self/status") if each.startswith("VmHWM"))
    return int(line.split()[1])  # of this program alone, unlike ru_maxrss

trace, n = VehicleTrace(VehicleId(1, 1)), 1_440_000
trace.log = open_log(Path(sys.argv[1]))
trace.vehicle = Vehicle(trace.address, Estimator(load_profile("imu")))
before_kb = most_kb()  # libraries without bytecode take 60 MB more to import
for k in range(0, n, 10_000):
    rows = np.random.default_rng(k).normal(0.0, 1e-4, (10_000, 25)).tolist()
    for us, row in enumerate(rows, k):
        us, vectors = 2_500 * us, [tuple(row[i : i + 3]) for i in range(0, 15, 3)]
        attitude = Attitude(us, (1.0, *row[15:18]), *vectors[:2], *row[18:], "true")
        trace.take(us, us, attitude, ImuSample(us, *vectors[2:], True), True)
    us = 2_500 * k
    trace.references["sim"].add(ReferenceAttitude(trace.address, us, us, "sim", "SIM", IDENTITY))
compare(trace, None)
report = score(trace, 0.0)
print(report.imu.samples, most_kb() - before_kb)
"""


def test_an_hour_at_400_hz_takes_no_more_memory_than_its_columns_one_by_one():
    samples, taken_kb = map(int, run_python("-c", LONG, str(SLOW), timeout_s=900).stdout.split())
    assert samples == 1_440_000
    assert taken_kb < 186_000
