"""Events in, records out: when they are published, of whom, and what is counted."""

import json
import math
import random

import msgspec
import pytest

from drivers import events as given
from drivers.events import Heartbeat, VehicleId
from estimator.errors import InputError
from estimator.live.core import with_attitude
from estimator.profile import load_profile
from service.pipeline import MOST_QUIET_HZ, Pipeline
from service.records import Message, Published, Replaced, StatusRecord
from service.vehicle import Vehicle
from service.vehicle_status import Load
from tests.drivers.mavlink.messages import only
from tests.service.flight_rig import ONE, START_US, attitudes, fed, imu_events, statuses, texts

PAPER = load_profile("paper")


def with_status(outputs):
    """The vehicles whose status is among the outputs."""
    published = only(Published, outputs)
    return [each.vehicle for each in published if isinstance(each.record, StatusRecord)]


def test_a_parameter_that_comes_before_the_first_sample_counts():
    pipeline = Pipeline(PAPER, system_id=1)
    for system in (1, 2):  # the second is unwanted
        address = VehicleId(system, 1)
        pipeline.handle(given.Parameter(address, START_US, "INS_GYRO_FILTER", 4.0))
    (vehicle,) = pipeline.vehicles
    assert vehicle.estimator.snapshot.context.imu_lag_s == pytest.approx(0.05627, abs=1e-5)


def test_frames_that_are_not_let_in_count_for_a_vehicle_that_is_there_and_make_none():
    refused = [given.RefusedFrames(VehicleId(k, 1), 0, "unsigned", 7) for k in (1, 2)]
    pipeline = fed([*imu_events(3), *refused])
    (vehicle,) = pipeline.vehicles
    assert vehicle.rejected == {"unsigned": 7}
    assert pipeline.refused_frames == {"unsigned": 14}


@pytest.mark.parametrize("profile", ["paper", "imu"])
def test_the_tick_schedule_does_not_touch_the_states_at_the_samples(profile):
    events, states = imu_events(400), []
    for ticks_per_sample in (0, 1, 0.1, 7.3):
        pipeline, rng = Pipeline(load_profile(profile)), random.Random(5)
        seen, due = [], 0.0
        for event in events:
            pipeline.handle(event)
            seen.append(pipeline.vehicle(ONE).estimator.snapshot)
            due += ticks_per_sample
            while due >= 1.0:
                pipeline.tick(event.arrival_us + rng.randrange(3_000_000))
                due -= 1.0
        states.append(seen)
    assert all(other == states[0] for other in states[1:])


def test_records_have_the_published_schema():
    """All of their fields are in docs/zenoh.md."""
    pipeline = fed(imu_events(100))
    outputs = pipeline.tick(START_US + 1_000_000, Load(overruns=3, dropped=4))
    (attitude,), (status,) = attitudes(outputs), statuses(outputs)
    decoded = json.loads(msgspec.json.encode(attitude), parse_constant=pytest.fail)
    assert list(decoded["confidence"]) == ["gravity", "magnetic"]
    assert list(decoded["sigma_deg"]) == ["inclination", "heading"]
    assert (decoded["schema"], decoded["state"]) == (1, "running")
    assert math.hypot(*decoded["q_ned_frd"]) == pytest.approx(1.0, abs=1e-12)
    assert 0.0 <= decoded["euler_deg"][2] < 360.0
    assert (status.overruns, status.dropped, status.imu_message) == (3, 4, "RAW_IMU")
    assert status.imu_rate_hz == pytest.approx(100.0, rel=1e-3)


@pytest.mark.parametrize(
    ("autopilot_and_type", "number", "name"),
    [((3, 2), 5, "LOITER"), ((3, 1), 5, "FBWA"), ((12, 2), 3 << 16, "POSCTL"),
     ((3, 2), 77, "mode 77")],
)  # fmt: skip
def test_a_status_has_the_flight_mode_and_whether_it_is_armed(autopilot_and_type, number, name):
    """They are the latest heartbeat's; a log's own events change a part of it."""
    pipeline = fed(imu_events(10))
    (before,) = statuses(pipeline.tick(START_US + 1_000_000))
    assert (before.mode, before.armed) == ("", None)
    pipeline.handle(Heartbeat(ONE, START_US, *autopilot_and_type, True, number))
    pipeline.handle(given.ModeChange(ONE, START_US, is_armed=False))
    (status,) = statuses(pipeline.tick(START_US + 2_000_000))
    assert (status.mode, status.armed) == (name, False)


def test_the_attitude_is_propagated_to_the_tick():
    """Its boot time is the vehicle's own, also where the continuous clock has left that."""
    events = [msgspec.structs.replace(e, boot_us=e.boot_us + 777) for e in imu_events(100)]
    pipeline, last = fed(events), events[-1]
    (record,) = attitudes(pipeline.tick(last.arrival_us + 4_000))
    assert record.time_unix_us == last.arrival_us + 4_000
    assert record.time_boot_us == pytest.approx(last.boot_us + 4_000, abs=1)
    assert record.age_ms == pytest.approx(4.0)
    estimator = pipeline.vehicle(ONE).estimator
    assert record.q_ned_frd == estimator.attitude(record.time_boot_us - 777).q_ned_frd


def test_statuses_of_many_come_one_by_one_over_the_second():
    fleet = [VehicleId(1 + k, 1) for k in range(100)]
    every = (event for each in fleet for event in imu_events(400, vehicle=each))
    events = sorted(every, key=lambda event: event.arrival_us)
    pipeline, reported, due_us = Pipeline(PAPER), [], START_US
    for event in events:
        if event.arrival_us > due_us:
            reported.append(with_status(pipeline.tick(due_us)))
            due_us += 20_000
        pipeline.handle(event)
    seconds = [reported[k : k + 50] for k in range(51, len(reported) - 49, 50)]
    assert len(seconds) == 2
    for second in seconds:
        assert max(map(len, second)) <= 4
        assert sorted(each for tick in second for each in tick) == fleet


def test_late_ticks_do_not_put_off_the_statuses_and_a_clock_set_back_brings_no_flood():
    """Due each second since the first: at 1.4 s that of 1 s, at 2.1 s that of 2 s."""
    pipeline = fed(imu_events(10))

    def printed(times_s):
        ticks = (pipeline.tick(START_US + round(1e6 * at_s)) for at_s in times_s)
        return [[each.sequence for each in statuses(outputs)] for outputs in ticks]

    found = printed((0.0, 0.5, 1.4, 1.9, 2.1, 2.9, 3.0, 600.0, 600.5, 601.0))
    assert found == [[0], [], [1], [], [2], [], [3], [4], [], [5]]
    found = printed(begin_s + 0.1 * tick for begin_s in (700, -3600) for tick in range(50))
    assert sum(map(len, found)) == pytest.approx(10, abs=2)


def test_refused_samples_are_counted_by_reason():
    events = imu_events(10)
    broken = events[-1].sample._replace(gyr_rad_s=(math.nan, 0.0, 0.0))
    pipeline = fed([*events, msgspec.structs.replace(events[-1], sample=broken), events[3]])
    pipeline.handle(given.Rejected(ONE, START_US, "stuck"))
    (status,) = statuses(pipeline.tick(START_US + 200_000))
    assert status.rejected == {"not_finite": 1, "not_later": 1, "stuck": 1}


def test_each_vehicle_has_an_estimator_and_ground_stations_have_none():
    two, gimbal, pipeline = VehicleId(2, 1), VehicleId(1, 154), Pipeline(PAPER)
    pipeline.handle(Heartbeat(VehicleId(255, 190), START_US, 8, 6))
    pipeline.handle(Heartbeat(ONE, START_US, 3, 2))
    (waiting,) = pipeline.tick(START_US)
    assert waiting.record.state == "waiting"
    for pair in zip(imu_events(50), imu_events(50, vehicle=two, seed=3), strict=True):
        fed(pair, pipeline)
    fed(imu_events(50, vehicle=gimbal, seed=4), pipeline)
    outputs = pipeline.tick(START_US + 500_000)
    assert {o.vehicle for o in only(Published, outputs)} == {ONE, two, gimbal}
    assert [v.name for v in pipeline.vehicles] == ["1", "2", "1-154"]
    alone = fed(imu_events(50, vehicle=two, seed=3))
    assert alone.vehicle(two).estimator.snapshot == pipeline.vehicle(two).estimator.snapshot


def test_one_system_id_only():
    pipeline = fed(imu_events(1), Pipeline(PAPER, system_id=2))
    assert pipeline.vehicles == ()
    assert pipeline.handle(given.Notice(ONE, START_US, "not wanted")) == []
    assert pipeline.handle(given.Notice(None, START_US, "for all")) == [Message("for all")]


def test_the_number_of_vehicles_is_bounded(monkeypatch):
    monkeypatch.setattr("service.pipeline.MAX_VEHICLES", 300)
    addresses = [VehicleId(1 + number // 250, number % 250) for number in range(305)]
    pipeline = fed(imu_events(1, vehicle=each)[0] for each in addresses)
    assert len(pipeline.vehicles) == 300
    pipeline.handle(given.Malformed(START_US, 3))
    assert pipeline.malformed == 3


def test_a_profile_that_raises_while_it_is_installed_changes_nothing(monkeypatch):
    """Whatever the checks let through: the vehicle flies on with the one of before."""
    pipeline, alone = fed(imu_events(100)), fed(imu_events(100))
    before = pipeline.vehicle(ONE).profile

    def overflow(*_settings, **_known):
        raise OverflowError("(34, 'Numerical result out of range')")

    monkeypatch.setattr("estimator.live.state.settings_of", overflow)
    with pytest.raises(InputError, match="out of range"):
        pipeline.replace_profile(ONE, {"filter": {"gamma": 0.25}})
    monkeypatch.undo()
    vehicle = pipeline.vehicle(ONE)
    assert vehicle.profile == vehicle.estimator.profile == before
    for one in (pipeline, alone):
        one.handle(imu_events(101)[-1])
    assert vehicle.estimator.snapshot == alone.vehicle(ONE).estimator.snapshot
    assert only(Replaced, pipeline.tick(START_US)) == []


def test_a_flood_of_profiles_is_reported_a_few_times():
    """The number of lines left out follows once there is room; a clock set back makes room."""
    pipeline = fed(imu_events(100))

    def replaced(times, now_us):
        for step in range(times):
            pipeline.replace_profile(ONE, {"filter": {"gamma": 0.1 + 0.001 * step}})
        return pipeline.tick(now_us)

    reported = [o for k in range(500) for o in replaced(4, START_US + 1_000_000 + 10_000 * k)]
    assert len(only(Replaced, reported)) == 500
    lines, limit = texts(reported), "there were more than 12 within a minute"
    # with the line that it runs 12 in a minute, and that there are more
    assert lines.count("vehicle 1: new parameters") == 11
    assert lines.count(f"vehicle 1: more lines are left out: {limit}") == 1
    later = START_US + 62_000_000
    pipeline.handle(imu_events(1, start_us=later)[0])
    assert f"vehicle 1: 1990 lines were left out: {limit}" in texts(replaced(1, later))
    earlier = START_US - 3_600_000_000
    pipeline.handle(imu_events(1, start_us=earlier)[0])
    assert "vehicle 1: new parameters" in texts(replaced(20, earlier))


@pytest.mark.parametrize("profile", ["paper", "imu"])
@pytest.mark.parametrize("ticks", [True, False])
def test_an_estimate_that_is_not_finite_is_made_anew_by_samples_and_not_by_ticks(profile, ticks):
    """A replay has no ticks: it mends itself there, too."""
    events = imu_events(60)
    pipeline = fed(events[:20], profile)
    vehicle = pipeline.vehicle(ONE)
    now = vehicle.estimator.snapshot
    broken = with_attitude(now.core, (math.nan, 0.0, 0.0, 1.0))
    vehicle.estimator.snapshot = now._replace(core=broken)
    if ticks:
        for _ in range(3):
            assert attitudes(pipeline.tick(events[20].arrival_us)) == []
        assert vehicle.rejected == {}
        assert vehicle.estimator.aligned  # as it was
    lines = []
    for event in events[20:]:
        lines += texts(pipeline.handle(event))
    assert vehicle.rejected == {"estimate_not_finite": 1}
    assert lines[0] == "vehicle 1: the estimate is not finite, aligning anew"
    assert len(attitudes(pipeline.tick(events[-1].arrival_us))) == 1


def test_the_latest_attitude_of_others_comes_with_ours_and_once():
    """Between ticks they would fill the sinks' queues, however fast they come."""
    pipeline = Pipeline(PAPER)

    def report(vehicle, source, w):
        q = (w, 0.0, 0.0, math.sqrt(1.0 - w * w))
        event = given.ReferenceAttitude(vehicle, START_US, 0, source, "ATTITUDE", q)
        assert pipeline.handle(event) == []
        return source, q

    report(ONE, "autopilot", 0.5)  # nobody knows this vehicle yet
    pipeline.handle(imu_events(1)[0])
    for n in range(50):
        autopilot = report(ONE, "autopilot", 0.01 * n)
        truth = report(ONE, "sim", 0.02 * n)
    report(VehicleId(9, 1), "sim", 0.1)
    outputs = pipeline.tick(START_US + 10_000)
    assert [each.peers for each in only(Published, outputs) if each.sample] == [(autopilot, truth)]
    assert not any(each.peers for each in only(Published, pipeline.tick(START_US + 20_000)))


def test_many_lost_vehicles_have_fewer_statuses_and_one_that_is_there_has_each_second():
    gone = [VehicleId(1 + k, 2) for k in range(2 * MOST_QUIET_HZ + 5)]
    pipeline = fed([event for each in gone for event in imu_events(3, vehicle=each)])
    reported, stream = [], imu_events(1400, start_us=START_US + 20_000_000)
    for event in stream:
        pipeline.handle(event)
        reported += with_status(pipeline.tick(event.arrival_us))
    assert 13 <= reported.count(ONE) <= 15  # in 14 s
    assert {reported.count(each) for each in gone} <= {4, 5, 6}


def test_a_tick_looks_at_no_vehicle_that_is_lost(monkeypatch):
    pipeline = fed([event for k in range(300) for event in imu_events(3, vehicle=VehicleId(7, k))])
    now_us = START_US + 20_000_000
    pipeline.tick(now_us)
    pipeline.tick(now_us + 1)
    pipeline.handle(imu_events(1, start_us=now_us)[0])
    looked, schedule = [], Vehicle.schedule
    monkeypatch.setattr(Vehicle, "schedule", lambda v, us: looked.append(v) or schedule(v, us))
    pipeline.tick(now_us + 2)
    assert {each.address for each in looked} == {ONE}


def test_a_vehicle_that_is_late_again_and_again_is_reported_a_few_times():
    """A computer too slow for the stream: each sample is old, and each tick after it is late."""
    pipeline, lines = Pipeline(PAPER), []
    for event in imu_events(400):
        lines += texts([*pipeline.handle(event), *pipeline.tick(event.arrival_us + 900_000)])
    assert {"vehicle 1: running", "vehicle 1: degraded"} < {*lines}
    assert len(lines) < 16
