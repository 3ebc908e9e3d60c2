"""A page of metrics, read by Prometheus' own parser."""

import urllib.request
from contextlib import closing

import pytest

from drivers.events import VehicleId
from estimator.errors import InputError
from service.pipeline import MOST_QUIET_HZ
from service.records import Evicted, Message, Published, vehicle_name
from tests.service.records import differing, record, status

pytest.importorskip("prometheus_client", reason="the extra metrics is not installed")
from prometheus_client.parser import text_string_to_metric_families

from fuzzbee.metrics import MetricsSink


@pytest.fixture
def sink():
    with closing(MetricsSink(0)) as made:
        yield made


def scrape(sink):
    """{(name, labels): value}, read by Prometheus' own parser."""
    with urllib.request.urlopen(f"http://127.0.0.1:{sink.port}/metrics", timeout=60) as answer:
        families = text_string_to_metric_families(answer.read().decode())
    return {
        (sample.name, tuple(sorted(sample.labels.items()))): sample.value
        for family in families
        for sample in family.samples
    }


def test_a_scrape_has_the_latest_of_each_vehicle(sink):
    one, other = VehicleId(1, 1), VehicleId(2, 154)
    counted = status(imu_rate_hz=99.5, rejected={"stuck": 3}, overruns=4, dropped=5)
    sink.handle([Message("hello"), Published(one, record(10, 20, 30)), Published(one, counted)])
    sink.handle([Published(one, record(11, 21, 31, sequence=41)), Published(other, status("lost"))])
    got, vehicle = scrape(sink), (("vehicle", "1"),)
    exact = {"gain": 3.0, "attitudes_total": 42, "imu_rate_hertz": 99.5}
    angles = {"roll": 11.0, "heading": 31.0, "heading_sigma": 5.0}
    for name, value in exact.items():
        assert got[f"fuzzbee_{name}", vehicle] == value, name
    for name, value in angles.items():
        assert got[f"fuzzbee_{name}_degrees", vehicle] == pytest.approx(value), name
    assert got["fuzzbee_imu_age_seconds", vehicle] >= 0.005
    assert got["fuzzbee_rejected_total", (("reason", "stuck"), ("vehicle", "1"))] == 3
    assert got["fuzzbee_state", (("state", "running"), ("vehicle", "1"))] == 1.0
    assert got["fuzzbee_state", (("state", "lost"), ("vehicle", "2-154"))] == 1.0
    assert got["fuzzbee_overruns_total", ()] == 4
    assert got["fuzzbee_dropped_total", ()] == 5


def test_before_the_first_vehicle_there_is_a_page_and_a_taken_port_is_named(sink):
    assert scrape(sink)["fuzzbee_overruns_total", ()] == 0
    with pytest.raises(InputError, match=str(sink.port)):
        MetricsSink(sink.port)


def test_a_lost_vehicle_has_an_age_but_no_attitude_and_one_that_is_forgotten_nothing(sink):
    lost, forgotten = VehicleId(1, 1), VehicleId(2, 1)
    for vehicle in (lost, forgotten):
        sink.handle([Published(vehicle, record()), Published(vehicle, status("lost"))])
    sink.handle([Evicted(forgotten)])
    got = scrape(sink)
    assert ("fuzzbee_imu_age_seconds", (("vehicle", "1"),)) in got
    assert ("fuzzbee_roll_degrees", (("vehicle", "1"),)) not in got
    assert {dict(labels).get("vehicle") for _, labels in got} == {None, "1"}


def test_the_autopilot_s_attitude_beside_ours(sink):
    sink.handle([Published(VehicleId(1, 1), differing("heading", 25.0))])
    sink.handle([Published(VehicleId(2, 1), status())])
    got, vehicle = scrape(sink), ("vehicle", "1")
    assert got["fuzzbee_autopilot", (vehicle, ("verdict", "differs"))] == 1.0
    assert got["fuzzbee_autopilot", (vehicle, ("verdict", "agrees"))] == 0.0
    assert got["fuzzbee_autopilot_heading_degrees", (vehicle,)] == 25.0
    assert not [key for key in got if "autopilot" in key[0] and ("vehicle", "2") in key[1]]


def test_of_thousands_that_are_lost_the_last_are_reported_of(sink):
    gone = [VehicleId(1 + k % 250, 2 + k // 250) for k in range(1000)]
    there = VehicleId(1, 1)
    sink.handle([Published(there, record()), Published(there, status())])
    for each in gone:
        sink.handle([Published(each, record()), Published(each, status("lost"))])
    back = gone[3]
    sink.handle([Published(back, status())])
    reported = {dict(labels).get("vehicle") for _, labels in scrape(sink)} - {None}
    assert reported == {"1", vehicle_name(back), *map(vehicle_name, gone[-MOST_QUIET_HZ:])}
