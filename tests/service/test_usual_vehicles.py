"""Vehicles stepped by compiled code, many at a time, are what Python makes of each event.

The faults of ``test_faults.py`` hold both against each other, too, with one vehicle.
"""

import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.events import Imu, VehicleId
from drivers.logs.log_file import Window
from drivers.logs.tlog import TlogRecords, believe
from drivers.mavlink.backlog import Arrived
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.encoder import FrameEncoder
from drivers.mavlink.framing import FrameReader
from drivers.mavlink.readings import Readings
from drivers.simulation.simulated_vehicle import SimulatedVehicle
from estimator.live import reports
from estimator.live.reports import MOST_WAITING
from estimator.profile import load_profile
from estimator.types import VelocitySample
from service import usual_reports
from service.load import Load
from service.pipeline import Pipeline
from service.usual_columns import REPORT_SIZE, STATE_SIZE, WAITING
from service.vehicle import Vehicle
from tests.drivers.mavlink.test_usual_frames import LOGS, is_compiled, m, packed
from tests.service.flight_rig import START_US

S = 1_000_000
LOADS = [Load()] * 20 + [Load(is_shedding=True)] * 3
LOADS += [Load(is_behind=True), Load(has_just_woken=True)]


def scaled_imu(time_us, *reading):
    """Of the same clock as the second IMU's."""
    return m.MAVLink_scaled_imu_message(time_us // 1000, *reading)


SOUND = 5  # the vehicle with one IMU and no faults, but that its y axis turns round
TURNED_US = 8 * S


def frames_of(number, seconds, rng):
    """What a vehicle with two IMUs sends, with pauses, spikes and a silent first IMU."""
    encoder, own = FrameEncoder(VehicleId(number, 1)), []
    fault, until_us = None, 0
    first = m.MAVLink_raw_imu_message if number % 2 else scaled_imu
    for sample in SimulatedVehicle(seed=number, rate_hz=50.0, noise=0.1, bias=0.1):
        t = sample.time_us
        if t > seconds * S:
            return own
        if t >= until_us:
            fault = rng.choice(
                (None, None, None, "pause", "no first", "no field", "spike", "beside")
            )
            until_us = t + rng.randrange(S)
        if number == SOUND:
            fault = None if t < TURNED_US else "y turned"
        arrival_us = START_US + t + rng.randrange(15_000)
        scaled = [1000 / 9.80665 * a for a in sample.acc_m_s2]
        scaled += [
            1e3 * (20.0 if fault == "spike" and rng.random() < 0.2 else w) for w in sample.gyr_rad_s
        ]
        scaled[4] *= -1.0 if fault == "y turned" else 1.0
        scaled += [0.0 if fault == "no field" else 1e3 * b for b in sample.mag_gauss]
        reading = [round(max(-32768.0, min(32767.0, each))) for each in scaled]
        messages = [m.MAVLink_scaled_imu2_message(t // 1000 + 1, *reading)] * (number != SOUND)
        if fault != "no first":
            messages.insert(0, first(t, *reading))
        if number % 2:
            stamp_ms = t // 1000 + (7 if fault == "beside" and number == 3 else 0)
            rates = (0.1, 0.2, 0.3, *sample.true_rate_rad_s)
            messages.append(m.MAVLink_attitude_message(stamp_ms, *rates))
        if rng.random() < 0.02:
            messages.append(m.MAVLink_heartbeat_message(2, 3, 128, 0, 4, 3))
        if fault != "pause":
            own += [
                (arrival_us + k, encoder.frame(packed(each), 0)) for k, each in enumerate(messages)
            ]
    return own


@is_compiled
@pytest.mark.parametrize("profile", ["paper", "imu"])
def test_many_at_a_time_are_the_same_as_one_by_one(profile):
    rng = random.Random(5)
    sent = sorted(each for number in range(1, SOUND + 1) for each in frames_of(number, 15.0, rng))
    reader, (one, many) = FrameReader(), (Pipeline(load_profile(profile)) for _ in range(2))
    decoders, waiting, singly = [MavlinkDecoder(references=False) for _ in range(2)], [], 0
    handle = many.handle

    def handle_and_count(event):
        nonlocal singly
        singly += isinstance(event, Imu)
        return handle(event)

    many.handle = handle_and_count
    due_us, samples = START_US, 0
    for arrival_us, data in sent:
        if arrival_us >= due_us:
            said = [line for each in decoders[1].readings_of(waiting) for line in many.handle(each)]
            told = [
                x
                for us, frame in map(tuple, waiting)
                for e in decoders[0].events(frame, us)
                for x in one.handle(e)
            ]
            assert sorted(x.text for x in said) == sorted(x.text for x in told)
            load = rng.choice(LOADS)
            ours, theirs = many.tick(due_us, load), one.tick(due_us, load)
            assert sorted(map(repr, ours)) == sorted(map(repr, theirs))
            waiting, due_us = [], due_us + 20_000
        (frame,) = reader.feed(data)
        samples += frame.message_id != m.MAVLINK_MSG_ID_ATTITUDE
        waiting.append(Arrived(arrival_us, frame))
    assert [each.counts for each in many.vehicles] == [each.counts for each in one.vehicles]
    if profile == "paper":
        assert singly < 0.5 * samples  # 0.29: the others were never events


def compare(arrived, rng, profile="imu"):
    """Both ways the same, at ticks of 50 a second; how many events Python has handled."""
    one, many = (Pipeline(load_profile(profile)) for _ in range(2))
    decoders, handled = [MavlinkDecoder(references=False) for _ in range(2)], 0
    handle = many.handle

    def handle_and_count(event):
        nonlocal handled
        handled += not isinstance(event, Readings)
        return handle(event)

    many.handle = handle_and_count
    due_us, waiting = arrived[0].arrival_us, []
    for each in arrived:
        if each.arrival_us >= due_us:
            load = rng.choice(LOADS)
            said = [x.text for e in decoders[1].readings_of(waiting) for x in many.handle(e)]
            told = [
                x.text
                for us, frame in map(tuple, waiting)
                for e in decoders[0].events(frame, us)
                for x in one.handle(e)
            ]
            assert sorted(said) == sorted(told)
            ours, theirs = many.tick(due_us, load), one.tick(due_us, load)
            assert sorted(map(repr, ours)) == sorted(map(repr, theirs))
            waiting, due_us = [], max(due_us, each.arrival_us) + 20_000
        waiting.append(each)
    assert [each.counts for each in many.vehicles] == [each.counts for each in one.vehicles]
    return handled


@is_compiled
@pytest.mark.parametrize("path", dict.fromkeys(LOGS), ids=lambda path: path.name)
def test_recorded_vehicles_are_the_same_as_one_by_one(path):
    records = TlogRecords(Window(path.read_bytes()), MavlinkDecoder(references=False).wanted)
    arrived = [Arrived(us, frame) for us, frame in believe(records, 0) if frame is not None]
    compare(arrived[:20_000], random.Random(3))


velocities = st.lists(
    st.builds(
        VelocitySample,
        st.integers(0, 12).map(lambda k: 100_000 * k),
        st.tuples(*(st.floats(-3.0, 3.0),) * 3),
        st.booleans(),
        st.floats(0.1, 2.0),
        st.sampled_from([0.0, 0.1]),
    ),
    max_size=MOST_WAITING,
)


@given(velocities, st.integers(0, 12), st.sampled_from([0.15, 0.5]))
def test_velocities_that_wait_go_in_the_order_of_the_estimators_own(waiting, now, oldest_s):
    time_us = 100_000 * now
    due, ahead = reports.take_due(tuple(waiting), time_us, oldest_s)
    row, rows = [0] * STATE_SIZE, np.zeros((MOST_WAITING, REPORT_SIZE))
    row[WAITING] = len(waiting)
    for k, each in enumerate(waiting):
        usual_reports.write_sample(rows[k], each)
    count, *taken = usual_reports.take_due(row, rows, time_us, oldest_s)
    assert taken[:count] == [reports.report_with_age(each, time_us) for each in due]
    left = rows[: row[WAITING]].tolist()
    assert tuple(map(usual_reports.sample_of, left)) == ahead


@is_compiled
def test_what_waits_behind_a_newcomers_first_sample_is_stepped_with_the_others(monkeypatch):
    """Each of some twenty in Python took as long as the first one."""
    encoder = FrameEncoder(VehicleId(1, 1))
    messages = [
        message
        for k in range(60)
        for message in (
            m.MAVLink_raw_imu_message(S + 20_000 * k, 0, k, -999, *[1] * 6),
            m.MAVLink_attitude_message(1000 + 20 * k, *[0.1] * 6),
        )
    ]
    frames = [encoder.frame(packed(each), 0) for each in messages]
    waiting = [
        Arrived(START_US + 10_000 * k, frame)
        for k, data in enumerate(frames)
        for frame in FrameReader().feed(data)
    ]
    singly, on_imu = [], Vehicle.on_imu
    monkeypatch.setattr(Vehicle, "on_imu", lambda v, event: singly.append(1) or on_imu(v, event))
    pipeline = Pipeline(load_profile("paper"))
    for each in MavlinkDecoder(references=False).readings_of(waiting):
        pipeline.handle(each)
    (vehicle,) = pipeline.vehicles
    assert vehicle.samples == 60
    assert len(singly) < 5
