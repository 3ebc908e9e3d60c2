"""The simulated autopilot's protocol, alone and in a fleet, without a socket."""

import itertools
from math import inf

import numpy as np
import pytest

from drivers.events import VehicleId
from drivers.simulation.autopilot import PARAMETERS, SimulatedAutopilot, VehicleOptions
from drivers.simulation.fleet import Fleet
from drivers.simulation.simulated_vehicle import simulate
from estimator.errors import InputError
from tests.drivers.mavlink.messages import UNIX, PymavlinkParser, frame, m

SECOND = 1_000_000


def parsed(data):
    return PymavlinkParser().feed(data)


def message(kind, *fields):
    """A message as another program sends it, after a trip through bytes."""
    (read,) = parsed(frame(getattr(m, f"MAVLink_{kind}_message")(*fields), 255, 190))
    return read


def interval(message_id, interval_us, target=(1, 1)):
    return message("command_long", *target, 511, 0, message_id, interval_us, 0, 0, 0, 0, 0)


def of_type(messages, kind):
    return [m for m in messages if m.get_type() == kind]


def flown(until_us=10 * SECOND - 1, system_id=1, **options):
    autopilot = SimulatedAutopilot(VehicleOptions(**options), system_id)
    return parsed(autopilot.advance(until_us, UNIX))


def gaps(messages):
    return set(np.diff([m.time_usec for m in messages]).tolist())


def test_ten_seconds_of_frames():
    messages, expected = flown(seed=4), simulate(4, 1000)
    raw = of_type(messages, "RAW_IMU")
    assert [m.time_usec for m in raw] == expected.time_us.tolist()
    units = ((expected.acc_m_s2 / 9.80665, "acc"), (expected.gyr_rad_s, "gyro"),
             (expected.mag_gauss, "mag"))  # fmt: skip
    for values, name in units:
        sent = [[getattr(m, axis + name) for axis in "xyz"] for m in raw]
        assert np.abs(np.array(sent) - 1000 * values).max() <= 1.0
    for kind in ("SIM_STATE", "ATTITUDE_QUATERNION"):
        sent = [(m.q1, m.q2, m.q3, m.q4) for m in of_type(messages, kind)]
        np.testing.assert_allclose(sent, expected.q_ned_frd, atol=1e-7)  # single precision
    assert len(of_type(messages, "HEARTBEAT")) == 10
    rare = ("HEARTBEAT", "AUTOPILOT_VERSION")
    kinds = [m.get_type() for m in messages if m.get_type() not in rare]
    assert kinds == 1000 * ["RAW_IMU", "SIM_STATE", "ATTITUDE", "ATTITUDE_QUATERNION"]
    assert {m.get_srcSystem() for m in messages} == {1}
    sequence = [m.get_seq() for m in messages]
    assert all((b - a) % 256 == 1 for a, b in itertools.pairwise(sequence))


def test_euler_angles_and_the_force_at_rest_are_those_of_the_quaternion():
    from scipy.spatial.transform import Rotation

    messages = flown()
    q = [(m.q1, m.q2, m.q3, m.q4) for m in of_type(messages, "ATTITUDE_QUATERNION")]
    euler = [(m.roll, m.pitch, m.yaw) for m in of_type(messages, "ATTITUDE")]
    expected = Rotation.from_quat(q, scalar_first=True)
    error = (Rotation.from_euler("xyz", euler).inv() * expected).magnitude()
    assert error.max() < 1e-5  # single precision, near the pole worse
    sent = [(m.xacc, m.yacc, m.zacc) for m in of_type(messages, "SIM_STATE")]
    np.testing.assert_allclose(sent, expected.inv().apply((0.0, 0.0, -9.80665)), atol=1e-5)


def test_advancing_in_steps_gives_the_same_frames():
    whole, stepped = (SimulatedAutopilot(VehicleOptions(rate_hz=33.0), 2) for _ in range(2))
    parts = [stepped.advance(t, UNIX) for t in range(0, 5 * SECOND + 1, 2000)]
    assert b"".join(parts) == whole.advance(5 * SECOND, UNIX)


def test_drop_loses_frames_seeded():
    first, again, other = ([m.get_seq() for m in flown(seed=k, drop=0.2)] for k in (1, 1, 2))
    # 4010 frames; the deviation of the count is sqrt(4010 x 0.2 x 0.8) = 25
    assert abs(len(first) - 0.8 * 4010) < 5 * 25
    assert first == again != other


def test_message_interval_changes_the_rate_for_good():
    autopilot = SimulatedAutopilot(VehicleOptions(rate_hz=4.0), 1)
    autopilot.advance(2 * SECOND, UNIX)
    (ack,) = parsed(autopilot.handle(interval(27, 20_000), UNIX))
    assert (ack.get_type(), ack.command, ack.result) == ("COMMAND_ACK", 511, 0)
    assert (ack.target_system, ack.target_component) == (255, 190)
    messages = parsed(autopilot.advance(12 * SECOND, UNIX))
    raw = of_type(messages, "RAW_IMU")
    assert gaps(raw[1:]) == {20_000}
    assert len(raw) > 480
    assert len(of_type(messages, "ATTITUDE")) == pytest.approx(40, abs=2)
    # SIM_STATE has no time: it follows a RAW_IMU, or is not sent
    for before, after in itertools.pairwise(messages):
        if after.get_type() == "SIM_STATE":
            assert before.get_type() == "RAW_IMU"


@pytest.mark.parametrize(
    ("intervals_us", "raw", "attitudes"),
    [([(27, 500_000)], 20, 1000), ([(30, -1)], 1000, 0), ([(30, -1), (30, 0)], 1000, 1000)],
    ids=["slower", "off", "default"],
)
def test_an_interval_of_one_stream_keeps_the_others(intervals_us, raw, attitudes):
    autopilot = SimulatedAutopilot(VehicleOptions(), 1)
    autopilot.advance(0, UNIX)
    for each in intervals_us:
        autopilot.handle(interval(*each), UNIX)
    messages = parsed(autopilot.advance(10 * SECOND, UNIX))
    assert len(of_type(messages, "RAW_IMU")) == pytest.approx(raw, abs=1)
    assert len(of_type(messages, "ATTITUDE")) == attitudes


@pytest.mark.parametrize(
    ("command", "result"),
    [
        (interval(9999, 20_000), 4),
        (interval(27, 10), 2),
        (interval(27, -5), 2),
        (interval(27, float("nan")), 2),
        (message("command_long", 1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0), 3),
    ],
)
def test_what_it_cannot_do_is_answered_so(command, result):
    autopilot = SimulatedAutopilot(VehicleOptions(), 1)
    (ack,) = parsed(autopilot.handle(command, UNIX))
    assert ack.result == result
    raw = of_type(parsed(autopilot.advance(SECOND, UNIX)), "RAW_IMU")
    assert gaps(raw) == {10_000}


def test_commands_to_others_are_left_alone():
    autopilot = SimulatedAutopilot(VehicleOptions(), 2)
    others = [interval(27, 20_000, target=target) for target in ((1, 1), (2, 154))]
    for each in (*others, message("heartbeat", 6, 8, 0, 0, 4, 3)):
        assert autopilot.handle(each, UNIX) == b""
    assert autopilot.handle(interval(27, 20_000, target=(0, 0)), UNIX) != b""


def test_parameters():
    autopilot = SimulatedAutopilot(VehicleOptions(), 1)
    assert autopilot.id == VehicleId(1, 1)
    values = parsed(autopilot.handle(message("param_request_list", 1, 1), UNIX))
    assert [(v.param_id, v.param_value) for v in values] == list(PARAMETERS)
    assert [v.param_index for v in values] == list(range(len(PARAMETERS)))
    for name, index in ((b"COMPASS_OFS_Y", -1), (b"", 5)):
        request = message("param_request_read", 1, 1, name, index)
        (value,) = parsed(autopilot.handle(request, UNIX))
        assert value.param_id == "COMPASS_OFS_Y"
    for name, index in ((b"NO_SUCH", -1), (b"", 99)):
        assert autopilot.handle(message("param_request_read", 1, 1, name, index), UNIX) == b""


def test_it_identifies_itself_ahead_of_the_first_sample():
    for motion in ("paper", "flight"):
        messages = flown(SECOND - 1, motion=motion)
        kinds = [each.get_type() for each in messages]
        assert kinds.index("AUTOPILOT_VERSION") < kinds.index("RAW_IMU")
        output = of_type(messages, "AUTOPILOT_VERSION")
        assert len(output) == 10
        assert bytes(output[0].flight_custom_version) == b"fuzzbee\0"
        assert bytes(output[0].middleware_custom_version).rstrip(b"\0") == motion.encode()


def test_a_flight_sends_its_place_and_velocity_and_falls_silent():
    messages = flown(100 * SECOND - 1, motion="flight", rate_hz=50, seed=2)
    reported = of_type(messages, "GLOBAL_POSITION_INT")
    true = of_type(messages, "SIM_STATE")
    assert len(reported) == 991  # 10 Hz but in the silence
    speed = np.array([(m.vx, m.vy, m.vz) for m in reported]) / 100
    expected = np.array([(m.vn, m.ve, m.vd) for m in true])[::5][: len(speed)]
    # before the silence both are in step; the velocity's own noise is 0.05 m/s
    assert (speed - expected)[:700].std() == pytest.approx(0.05, rel=0.1)
    assert {m.lat // 10_000 for m in reported} <= set(range(47_390, 47_410))
    assert abs(true[0].zacc + 9.80665) < 1e-4
    times = np.array([m.time_usec for m in of_type(messages, "RAW_IMU")])
    assert np.diff(times).max() == 920_000
    calm = flown(100 * SECOND - 1, motion="flight", rate_hz=50, calm=True)
    assert gaps(of_type(calm, "RAW_IMU")) == {20_000}


def test_after_a_pause_slow_messages_keep_their_interval():
    """What was due meanwhile is not made up for, one a sample."""
    autopilot = SimulatedAutopilot(VehicleOptions(motion="flight", calm=True), 1)
    autopilot.advance(SECOND, UNIX)
    autopilot.skip(11 * SECOND)
    messages = parsed(autopilot.advance(12 * SECOND, UNIX))
    assert len(of_type(messages, "RAW_IMU")) == pytest.approx(100, abs=1)
    assert len(of_type(messages, "GLOBAL_POSITION_INT")) == pytest.approx(10, abs=2)


def test_vehicles_have_signals_of_their_own_and_are_spread():
    fleet = Fleet(VehicleOptions(seed=10, rate_hz=10.0), 5)
    sent = []
    for now_us in range(0, 2 * SECOND, 1000):
        fleet.send_due(now_us, UNIX, lambda data, now=now_us: sent.append((now, data)))
    for system_id in range(1, 6):
        mine = [m for _, data in sent for m in parsed(data) if m.get_srcSystem() == system_id]
        raw = of_type(mine, "RAW_IMU")
        expected = simulate(10 + system_id - 1, len(raw), rate_hz=10.0)
        gyro = np.array([m.zgyro for m in raw])
        assert np.abs(gyro - 1000 * expected.gyr_rad_s[:, 2]).max() <= 1.0
    times = [now for now, data in sent if of_type(parsed(data), "RAW_IMU")]
    assert len(times) == len(set(times)) == 100


def test_after_a_stall_the_fleet_goes_on_with_the_present():
    fleet = Fleet(VehicleOptions(), 2)
    sent = []
    fleet.send_due(5000, UNIX, sent.append)
    sent.clear()
    fleet.send_due(100 * SECOND, UNIX, sent.append)
    fleet.send_due(100 * SECOND + 5000, UNIX, sent.append)
    raw = of_type(parsed(b"".join(sent)), "RAW_IMU")
    assert [(m.get_srcSystem(), m.time_usec) for m in raw] == [(1, 10**8), (2, 10**8)]


def test_a_fleet_answers_each_peer_s_half_frames():
    fleet = Fleet(VehicleOptions(rate_hz=2.0), 3)
    request = bytes(interval(27, 10_000, target=(2, 1)).get_msgbuf())
    answers = []
    fleet.receive("a", request[:10], UNIX, answers.append)
    fleet.receive("b", request, UNIX, answers.append)
    assert len(answers) == 1
    fleet.receive("a", request[10:], UNIX, answers.append)
    acks = parsed(b"".join(answers))
    assert [(m.get_type(), m.get_srcSystem()) for m in acks] == 2 * [("COMMAND_ACK", 2)]
    fleet.receive("a", b"", UNIX, answers.append)


@pytest.mark.parametrize(
    "options", [{"rate_hz": 1e5}, {"drop": -0.1}, {"bias": inf}, {"magnet": (3.0, 3.0)}]
)
def test_options_beyond_the_ends_that_the_command_names_are_refused(options):
    with pytest.raises(InputError):
        Fleet(VehicleOptions(**options), 1)
