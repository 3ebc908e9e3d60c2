"""What goes into files and results, column by column, of data in which no two numbers are alike."""

from math import degrees, radians
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.events import VehicleId
from estimator.estimator import Estimator
from estimator.geometry.frames import from_euler_rad
from estimator.profile import load_profile
from estimator.types import Attitude
from fuzzbee.angle_curves import draw_angles
from fuzzbee.attitudes import attitudes_of_rows
from fuzzbee.column_store import PackedAttitudes
from fuzzbee.replays.comparison import Beside, Comparison
from fuzzbee.replays.exports import COLUMNS, rows
from fuzzbee.replays.trace import VehicleTrace
from fuzzbee.run_options import RunOptions
from fuzzbee.run_report import summary
from service.evictions import EvictedCounts, Evictions
from service.imu_stream import ImuChoice
from service.vehicle import Vehicle

ONE = VehicleId(1, 1)


def attitude(time_us, yaw_deg):
    return Attitude(
        time_us=time_us,
        q_ned_frd=from_euler_rad(radians(10.0), radians(-20.0), radians(yaw_deg)),
        rate_rad_s=(0.11, 0.12, 0.13),
        gyro_bias_rad_s=(0.021, 0.022, 0.023),
        error=0.31,
        error_rate_1_s=0.32,
        gain=3.3,
        confidence_gravity=0.41,
        confidence_magnetic=0.42,
        sigma_inclination_rad=radians(1.5),
        sigma_heading_rad=radians(2.5),
        heading_reference="magnetic",
    )


def test_every_column_of_a_replay_holds_its_own_number():
    trace = VehicleTrace(ONE)
    trace.attitudes = PackedAttitudes([attitude(7_000_000, 30.0), attitude(7_250_000, 40.0)])
    truth = np.array([from_euler_rad(radians(11.0), radians(-22.0), radians(33.0))] * 2)
    errors = np.radians([[9.0, 8.0, 7.0], [9.0, 8.0, 7.0]])
    compared = Comparison("sim", [Beside(truth, np.array([False, True]), errors)])
    first, second = (dict(zip(COLUMNS, row, strict=True)) for row in rows(trace, compared))
    assert first["time_s"] == 0.0
    assert second["time_s"] == pytest.approx(0.25)
    assert second["time_unix_s"] is None
    expected = {
        "roll_deg": 10.0,
        "pitch_deg": -20.0,
        "yaw_deg": 40.0,
        "rate_x_rad_s": 0.11,
        "rate_y_rad_s": 0.12,
        "rate_z_rad_s": 0.13,
        "bias_x_rad_s": 0.021,
        "bias_y_rad_s": 0.022,
        "bias_z_rad_s": 0.023,
        "error": 0.31,
        "error_rate_1_s": 0.32,
        "gain": 3.3,
        "confidence_gravity": 0.41,
        "confidence_magnetic": 0.42,
        "sigma_inclination_deg": 1.5,
        "sigma_heading_deg": 2.5,
        "reference_roll_deg": 11.0,
        "reference_pitch_deg": -22.0,
        "reference_yaw_deg": 33.0,
        "error_total_deg": 9.0,
        "error_heading_deg": 8.0,
        "error_inclination_deg": 7.0,
    }
    assert {name: second[name] for name in expected} == pytest.approx(expected)
    assert second["heading_reference"] == "magnetic"
    assert [second[f"q_{x}"] for x in "wxyz"] == list(trace.attitudes[1].q_ned_frd)
    assert [second[f"reference_q_{x}"] for x in "wxyz"] == truth[1].tolist()
    beside = [name for name in COLUMNS if name.startswith(("reference", "error_t", "error_h"))]
    assert {first[name] for name in beside} == {None}


def test_rows_of_an_array_become_the_fields_of_their_names():
    said = np.arange(18.0)[None, :]
    found = attitudes_of_rows(np.array([2_500_000]), said, np.array(["true"]))
    assert found.time_s.tolist() == [2.5]
    assert found.gyro_bias_rad_s.tolist() == [[7.0, 8.0, 9.0]]
    names = ("error", "gain", "confidence_gravity", "confidence_magnetic")
    names += ("sigma_inclination_rad", "sigma_heading_rad")
    assert [getattr(found, name)[0] for name in names] == [10.0, 12.0, 13.0, 14.0, 15.0, 16.0]


def test_the_experiments_samples_are_a_hundredth_of_a_second_apart_from_zero_on():
    from fuzzbee.replays.simulation_files import COLUMNS as SIMULATED
    from fuzzbee.replays.simulation_files import _rows
    from tuning.paper_experiment import run_experiment

    result = run_experiment(load_profile("paper"), 300)
    made = [dict(zip(SIMULATED, row, strict=True)) for row in _rows(300, result)]
    assert [row["time_s"] for row in made] == pytest.approx([0.01 * k for k in range(1501)])
    assert made[9]["seed"] == 300
    assert made[9]["error"] == result.true_error[9]
    assert made[9]["gain"] == result.gains[9]
    assert made[9]["q_x"] == result.estimates[9, 1]
    assert made[9]["reference_q_z"] == result.truth[9, 3]


def test_a_curve_is_cut_at_the_sample_behind_its_wrap():
    figure = pytest.importorskip("matplotlib.figure").Figure()
    axes = figure.subplots(3, 1)
    yaws = (350.0, 358.0, 6.0, 14.0)
    q = np.array([from_euler_rad(0.2, 0.1, radians(yaw)) for yaw in yaws])
    draw_angles(axes, np.arange(4.0), [(q, {}, "estimate")])
    drawn = [ax.lines[0].get_ydata() for ax in axes]
    assert np.isnan(drawn[2]).tolist() == [False, False, True, False]
    np.testing.assert_allclose(drawn[0], degrees(0.2))
    np.testing.assert_allclose(drawn[1], degrees(0.1))


def test_the_result_of_a_run_names_what_was_counted_in_its_units():
    profile = load_profile("imu")
    vehicle = Vehicle(ONE, profile, Estimator(profile))
    vehicle.imu.samples, vehicle.imu._shed, vehicle.publishing.attitudes = 31, 32, 33
    vehicle.imu.worst_gap_us, vehicle.imu._median_us = 250_000, 1e6 / 49.87654
    vehicle.imu.choice, vehicle.rejected["late"] = ImuChoice("RAW_IMU"), 35
    evictions = Evictions()
    evictions.counts = EvictedCounts(51, 52, 53, 54, 55)
    runner = SimpleNamespace(ticks=41, overruns=42, dropped=43, lost=71)
    refused = {"signature": 61, "id": 62}
    pipeline = SimpleNamespace(
        malformed=72,
        refused_frames=refused,
        evictions=evictions,
        vehicles=(vehicle,),
        heard={3, 1},
    )
    result = summary(RunOptions(), "imu", 7.0, runner, pipeline, "")
    assert result["heard"] == [1, 3]
    expected = {"ticks": 41, "overruns": 42, "dropped": 43, "lost": 71, "malformed": 72}
    assert {name: result[name] for name in expected} == expected
    assert result["departed"] == {
        "vehicles": 51,
        "samples": 52,
        "shed": 53,
        "rejected": 54,
        "attitudes": 55,
    }
    assert list(result["refused"].items()) == [("id", 62), ("signature", 61)]
    vehicle = result["vehicles"]["1"]
    assert (vehicle["worst_gap_s"], vehicle["imu_rate_hz"]) == (0.25, 49.877)
    assert (vehicle["samples"], vehicle["shed"], vehicle["attitudes"]) == (31, 32, 33)
    assert (vehicle["imu_message"], vehicle["rejected"]) == ("RAW_IMU", {"late": 35})
