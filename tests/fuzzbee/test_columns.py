"""What goes into files and results, column by column, of data in which no two numbers are alike."""

from collections import Counter
from types import SimpleNamespace

from drivers.events import VehicleId
from estimator.estimator import Estimator
from estimator.profile import load_profile
from fuzzbee.run import RunOptions
from fuzzbee.run_report import summary
from service.stream_state import ImuChoice
from service.vehicle import Vehicle

ONE = VehicleId(1, 1)


def test_the_result_of_a_run_names_what_was_counted_in_its_units():
    vehicle = Vehicle(ONE, Estimator(load_profile("imu")))
    vehicle.imu.samples, vehicle.imu._shed, vehicle.publishing.attitudes = 31, 32, 33
    vehicle.imu.worst_gap_us, vehicle.imu.median_period_us = 250_000, 1e6 / 49.87654
    vehicle.imu.choice, vehicle.rejected["late"] = ImuChoice("RAW_IMU"), 35
    departed = Counter(vehicles=51, samples=52, shed=53, rejected=54, attitudes=55)
    runner = SimpleNamespace(ticks=41, overruns=42, dropped=43, source=SimpleNamespace(lost=71))
    refused = {"signature": 61, "id": 62}
    pipeline = SimpleNamespace(
        malformed=72,
        refused_frames=refused,
        departed=departed,
        scores=None,
        vehicles=(vehicle,),
        systems={3, 1},
    )
    result = summary(RunOptions(), "imu", 7.0, runner, pipeline, "")
    assert result["heard"] == [1, 3]
    expected = {"ticks": 41, "overruns": 42, "dropped": 43, "lost": 71, "malformed": 72}
    assert {name: result[name] for name in expected} == expected
    assert result["departed"] == departed
    assert list(result["refused"].items()) == [("id", 62), ("signature", 61)]
    vehicle = result["vehicles"]["1"]
    assert (vehicle["worst_gap_s"], vehicle["imu_rate_hz"]) == (0.25, 49.877)
    assert (vehicle["samples"], vehicle["shed"], vehicle["attitudes"]) == (31, 32, 33)
    assert (vehicle["imu_message"], vehicle["rejected"]) == ("RAW_IMU", {"late": 35})
