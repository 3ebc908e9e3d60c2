"""Frames and units: messages packed by pymavlink, decoded by us."""

import math

import pytest

from drivers import events as given
from drivers.mavlink.decoder import MOST_SENDERS, MavlinkDecoder
from drivers.mavlink.messages import IMU_MESSAGES, ImuMessage
from drivers.samples.intake import MOST_STREAMS
from drivers.samples.vehicle_clock import TimeField
from estimator.types import ZERO_VEC3, ImuSample, VelocitySample
from tests.drivers.mavlink.messages import (
    ARDUPILOT,
    GENERIC,
    PX4,
    UNIX,
    VEHICLE,
    G,
    S,
    decode_all,
    heartbeat,
    highres,
    m,
    only,
    raw_imu,
)


def test_a_message_with_an_array_is_of_one_imu(monkeypatch):
    """pymavlink's own object, which such a message becomes, has the message's number as ``id``."""

    def vectors(m):
        return (m.rollspeed, m.pitchspeed, m.yawspeed), (m.xacc, m.yacc, 1e-2 * m.zacc), ZERO_VEC3

    hil = ImuMessage(115, "HIL_STATE_QUATERNION", TimeField.TIME_USEC, vectors)
    monkeypatch.setitem(IMU_MESSAGES, hil.number, hil)
    message = m.MAVLink_hil_state_quaternion_message(
        S, (1, 0, 0, 0), 0.5, 0, 0, *(0,) * 8, 0, 0, -1000
    )
    (imu,) = only(given.Imu, decode_all([message]))
    assert imu.message == "HIL_STATE_QUATERNION"
    assert imu.sample == ImuSample(S, (0.5, 0.0, 0.0), (0, 0, -10.0), ZERO_VEC3, False)


ONE = VEHICLE, UNIX
HALF_PI_YAW = (0.5**0.5, 0.0, 0.0, 0.5**0.5)


def close(*values):
    """Equal but for rounding: floats on the wire have 24 bits."""
    return pytest.approx(values, rel=1e-6, abs=1e-12)


def sample(name, time_us, gyr, acc, mag=None):
    vectors = (close(*each) for each in (gyr, acc, mag or ZERO_VEC3))
    return given.Imu(*ONE, time_us, name, ImuSample(time_us, *vectors, mag is not None))


def velocity(name, time_us, vector, *others):
    return given.Velocity(*ONE, name, VelocitySample(time_us, close(*vector), *others))


def shown(time_us, source, name, q):
    return given.ReferenceAttitude(*ONE, time_us, source, name, pytest.approx(q, abs=1e-7))


PLACE = 4 * 10**8, -(10**8), 50_500
MS, US = 1500, 1_500_000
TABLE = [
    (
        m.MAVLink_raw_imu_message(2 * S, 0, 0, -1000, 0, 0, 0, 200, 0, 400, id=2),
        sample("RAW_IMU:2", 2 * S, (0, 0, 0), (0, 0, -G - 0.5e-3 * G), (0.2005, 0, 0.4005)),
    ),
    (
        raw_imu(2 * S, (100, -200, -1000), (1, -2, 3), (200, -100, 400)),
        sample(
            "RAW_IMU",
            2 * S,
            (0.0015, -0.0025, 0.0035),  # the middle of what is cut to 1, -2 and 3 mrad/s
            (0.1005 * G, -0.2005 * G, -1.0005 * G),
            (0.2005, -0.1005, 0.4005),
        ),
    ),
    (
        m.MAVLink_scaled_imu2_message(MS, 0, 0, -844, 1000, 0, 0, 0, 0, 0),
        sample("SCALED_IMU2", US, (1.0005, 0.0, 0.0), (0.0, 0.0, -0.8445 * G)),
    ),
    (
        highres(2 * S, (0.5, -0.25, -9.75), (0.5, -0.25, 0.125), (0.25, 0.5, 0.0)),
        sample("HIGHRES_IMU", 2 * S, (0.5, -0.25, 0.125), (0.5, -0.25, -9.75), (0.25, 0.5, 0.0)),
    ),
    (
        m.MAVLink_attitude_message(MS, 0.0, 0.0, math.pi / 2, 0, 0, 0),
        shown(US, "autopilot", "ATTITUDE", HALF_PI_YAW),
    ),
    (
        m.MAVLink_attitude_quaternion_message(MS, 0.5, -0.5, 0.5, 0.5, 0, 0, 0),
        shown(US, "autopilot", "ATTITUDE_QUATERNION", (0.5, -0.5, 0.5, 0.5)),
    ),
    (
        m.MAVLink_simstate_message(math.pi, 0.0, 0.0, 0, 0, 0, 0, 0, 0, 0, 0),
        shown(S, "sim", "SIMSTATE", (0.0, 1.0, 0.0, 0.0)),
    ),
    (
        m.MAVLink_sim_state_message(0.5, 0.5, -0.5, 0.5, *[0] * 17),
        shown(S, "sim", "SIM_STATE", (0.5, 0.5, -0.5, 0.5)),
    ),
    (
        m.MAVLink_local_position_ned_message(MS, 1, 2, 3, 4.0, -5.0, 0.5),
        velocity("LOCAL_POSITION_NED", US, (4.0, -5.0, 0.5), True, 0.3),
    ),
    (
        m.MAVLink_global_position_int_message(MS, *PLACE, 0, 100, -200, 50, 0),
        velocity("GLOBAL_POSITION_INT", US, (1.0, -2.0, 0.5), True, 0.3),
    ),
    (
        m.MAVLink_global_position_int_message(MS, *PLACE, 0, 0, 0, 0, 0),
        given.Position(*ONE, US, "GLOBAL_POSITION_INT", 40.0, -10.0, 50.5),
    ),
    (
        m.MAVLink_gps_raw_int_message(900_000, 3, *PLACE, 0, 0, 200, 9000, 9),
        velocity("GPS_RAW_INT", 900_000, (0.0, 2.0, 0.0), False, 0.5, 0.1),
    ),
    (  # to the south-west, with its accuracy
        m.MAVLink_gps_raw_int_message(
            900_000, 3, *PLACE, 0, 0, 200, 21_000, 9, 50_500, 0, 0, 250, 0
        ),
        velocity("GPS_RAW_INT", 900_000, (-(3.0**0.5), -1.0, 0.0), False, 0.25, 0.1),
    ),
    (
        m.MAVLink_param_value_message(b"AHRS_TRIM_X", -0.0625, 9, 10, 1),
        given.Parameter(*ONE, "AHRS_TRIM_X", -0.0625),
    ),
    (heartbeat(ARDUPILOT, 12), given.Heartbeat(*ONE, ARDUPILOT, 12, is_armed=False, custom_mode=0)),
    (m.MAVLink_command_ack_message(511, 4), given.CommandAck(*ONE, 511, 4)),
]


@pytest.mark.parametrize("force_mavlink1", [False, True], ids=["v2", "v1"])
@pytest.mark.parametrize(("message", "expected"), TABLE, ids=lambda x: type(x).__name__)
def test_each_message_becomes_its_event(message, expected, force_mavlink1):
    decoder = MavlinkDecoder()
    decode_all([raw_imu(S)], decoder)
    events = decode_all([message], decoder, force_mavlink1=force_mavlink1)
    (event,) = [e for e in events if type(e) is type(expected)]
    assert event == expected


FIELDS = {
    "a repeated one is absent until a quarter second has passed": (
        [raw_imu(S + 20_000 * k) for k in range(26)],
        [k in (0, 12, 24) for k in range(26)],
    ),
    "a new one is fresh at once": (
        [raw_imu(S + 20_000 * k, mag=(200 + k // 2, 0, 400)) for k in range(6)],
        [True, False] * 3,
    ),
    "HIGHRES_IMU shows itself which are new": (
        [highres(S, updated=0x3F), highres(S + 5000, updated=0x1FF)],
        [False, True],
    ),
}


@pytest.mark.parametrize(("messages", "is_fresh"), FIELDS.values(), ids=FIELDS)
def test_which_fields_are_fresh(messages, is_fresh):
    interval_us = messages[1].time_usec - S
    events = decode_all(messages, interval_us=interval_us)
    assert [event.sample.has_mag for event in events] == is_fresh


@pytest.mark.parametrize("factor", [1.0, 1e3, 1e6])
def test_highres_fields_come_in_gauss_whatever_the_firmware_thinks(factor):
    """From half the Earth's weakest field to eight times its strongest, hard iron included."""
    for size in (0.11, 0.4, 5.0):
        (event,) = decode_all([highres(mag=(0.1 * factor, 0.0, -size * factor))])
        assert event.sample.mag_gauss == pytest.approx((0.1, 0.0, -size), rel=1e-6)


@pytest.mark.parametrize(
    ("make", "fields", "autopilot", "words"),
    [
        (raw_imu, {"acc": (0, 0, -962)}, ARDUPILOT, ""),
        (raw_imu, {"acc": (17, 30, 1063)}, ARDUPILOT, ""),  # upside down, and known to be FRD
        (raw_imu, {"acc": (0, 0, -9807)}, ARDUPILOT, "accelerometer reads 9.8"),
        (highres, {"acc": (0.0, 0.0, -0.45 * G)}, ARDUPILOT, "accelerometer reads"),
        (highres, {"acc": (0.0, 0.0, -0.55 * G)}, ARDUPILOT, ""),
        (highres, {"acc": (0.0, 0.0, -1.9 * G)}, ARDUPILOT, ""),
        (highres, {"acc": (0.0, 0.0, -2.1 * G)}, ARDUPILOT, "accelerometer reads"),
        (highres, {"gyr": (0.0, 0.0, 40.0)}, PX4, "gyroscope"),
        (raw_imu, {"mag": (8000, 0, 0)}, ARDUPILOT, "magnetometer reads 8"),
        (highres, {"gyr": (-30.0, -30.0, 1.0)}, ARDUPILOT, "gyroscope reads 2.43e+03 deg/s"),
        (raw_imu, {"acc": (0, 0, 1025)}, GENERIC, "accelerometer z is positive"),
        (highres, {"acc": (0.0, -9.0, 4.0)}, GENERIC, ""),  # far from level, it may be right
    ],
)
def test_readings_that_cannot_be_right_are_reported_once(make, fields, autopilot, words):
    messages = [make(S + 250_000 * k, **fields) for k in range(150)]
    events = decode_all([heartbeat(autopilot), *messages], interval_us=250_000)
    texts = [event.text for event in only(given.Notice, events)]
    assert len(texts) == bool(words)
    assert words in "".join(texts)
    assert ("[mounting] acc_sign = -1" in "".join(texts)) == ("z is positive" in words)


def test_a_second_of_free_fall_is_no_reason():
    fall = [raw_imu(S + 20_000 * k, acc=(0, 0, -10)) for k in range(60)]
    rest = [raw_imu(3 * S + 20_000 * k) for k in range(800)]
    assert not only(given.Notice, decode_all(fall + rest))


def attitude_quaternion(w, x=0, ms=MS):
    return m.MAVLink_attitude_quaternion_message(ms, w, x, *[0] * 5)


@pytest.mark.parametrize(
    ("message", "kinds"),
    [
        (m.MAVLink_gps_raw_int_message(0, 1, 0, 0, 0, 0, 0, 65535, 65535, 0), []),
        (m.MAVLink_gps_raw_int_message(0, 2, 4 * 10**8, 10**8, 0, 0, 0, 0, 0, 4), []),
        (m.MAVLink_global_position_int_message(1500, 0, 0, 0, 0, 0, 0, 0, 0), []),
        # without a speed it still knows where it is
        (m.MAVLink_gps_raw_int_message(1, 3, *PLACE, 0, 0, 65535, 0, 9), [given.Position]),
        (m.MAVLink_attitude_message(1500, math.nan, 0, 0, 0, 0, 0), []),
        (m.MAVLink_ahrs2_message(math.nan, 0, 0, 0, 0, 0), []),
        *((attitude_quaternion(w), []) for w in (0, math.nan, 1.06)),
        (attitude_quaternion(0, 0.96), [given.ReferenceAttitude]),
    ],
)
def test_what_is_broken_or_without_a_fix_is_dropped(message, kinds):
    assert [type(event) for event in decode_all([raw_imu(), message])] == [given.Imu, *kinds]


SCALED_IMU = [m.MAVLink_scaled_imu_message(300_000 + 20 * k, 0, 0, -1000, *[0] * 6) for k in (0, 1)]
REBOOTED = {
    "ATTITUDE": lambda ms: m.MAVLink_attitude_message(ms, 0, 0, 0, 0, 0, 0),
    "ATTITUDE_QUATERNION": lambda ms: attitude_quaternion(1, ms=ms),
    "LOCAL_POSITION_NED": lambda ms: m.MAVLink_local_position_ned_message(ms, *[0] * 6),
    "GLOBAL_POSITION_INT": lambda ms: m.MAVLink_global_position_int_message(ms, *PLACE, *[0] * 5),
}


@pytest.mark.parametrize("make", REBOOTED.values(), ids=REBOOTED)
def test_a_reboot_is_reported_by_whatever_confirms_it(make):
    """With SCALED_IMU alone all messages have one clock."""
    events = decode_all([*SCALED_IMU, make(5000), make(5020)])
    first, second, reset, confirming = events[:4]  # the first message of the new boot waits
    assert type(first) is type(second) is given.Imu
    assert type(reset) is given.ClockReset
    assert isinstance(confirming, given.ReferenceAttitude | given.Position | given.Velocity)
    assert (reset.reason, reset.step_s) == ("reboot", pytest.approx(5.0 - 300.02))


def test_of_a_clock_that_begins_anew_nothing_is_placed_until_that_of_the_line_does():
    """Whether the vehicle has booted is RAW_IMU's to show; until then each is counted."""
    boots = [m.MAVLink_scaled_imu2_message(5000 + 20 * k, 0, 0, -1000, *[0] * 6) for k in range(5)]
    before = [raw_imu(300 * S), m.MAVLink_scaled_imu2_message(300_000, 0, 0, -1000, *[0] * 6)]
    after = [raw_imu(5 * S + 20_000 * k) for k in (5, 6)]
    after.append(m.MAVLink_scaled_imu2_message(5120, 0, 0, -1000, *[0] * 6))
    events = decode_all([*before, *boots, *after])
    refused = only(given.Rejected, events)
    assert {event.message for event in refused} == {"SCALED_IMU2"}
    assert [event.reason for event in refused] == ["clock_step", *["no_clock"] * 4]
    assert [event.message for event in only(given.Imu, events)] == [
        *("RAW_IMU", "SCALED_IMU2"),
        *("RAW_IMU", "RAW_IMU", "SCALED_IMU2"),
    ]


def test_a_message_without_content_does_not_touch_the_clock():
    broken = []
    for ms in (7, 27):
        broken.append(m.MAVLink_attitude_message(ms, math.nan, 0, 0, 0, 0, 0))
        broken.append(m.MAVLink_local_position_ned_message(ms, 0, 0, 0, math.nan, 0, 0))
        broken.append(m.MAVLink_global_position_int_message(ms, *[0] * 8))
    assert [type(event) for event in decode_all([*SCALED_IMU, *broken])] == [given.Imu, given.Imu]


@pytest.mark.parametrize(
    "messages",
    [
        [m.MAVLink_vfr_hud_message(0, 0, 0, 0, 0, 0)],
        # cameras, stations
        [heartbeat(*kind) for kind in ((8, 30), (8, 2), (8, 6), (0, 6), (3, 6))],
        [m.MAVLink_attitude_message(1500, 0, 0, 0, 0, 0, 0)],  # of a companion without an IMU
    ],
)
def test_what_is_no_vehicle_s_becomes_nothing(messages):
    assert decode_all(messages) == []


def test_a_link_of_any_number_of_senders_and_streams_is_remembered_within_bounds():
    """Of all system ids, also 255."""
    decoder, known, turned_away, refused = MavlinkDecoder(), set(), 0, 0
    for number in range(MOST_SENDERS + 200):
        address = {"system": 1 + number % 255, "component": 1 + number // 255}
        events = decode_all([raw_imu()], decoder, **address)
        known |= {event.vehicle for event in only(given.Imu, events)}
        turned_away += sum(event.frames for event in only(given.RefusedFrames, events))
    assert len(known) == MOST_SENDERS
    assert turned_away == 200  # every sample is accounted for
    for instance in range(256):
        message = m.MAVLink_raw_imu_message(S, 0, 0, -1000, 0, 0, 1, 0, 0, 0, id=instance)
        events = only(given.Rejected, decode_all([message], decoder))
        refused += [event.reason for event in events] == ["too_many_streams"]
    assert refused == 256 - MOST_STREAMS


def test_a_sender_with_an_imu_takes_the_slot_of_the_longest_silent_without_one(monkeypatch):
    """A table that is full of heartbeats, all of them fresh."""
    monkeypatch.setattr("drivers.mavlink.decoder.MOST_SENDERS", 3)
    decoder = MavlinkDecoder()
    for system in (1, 2, 3, 1):
        assert len(decode_all([heartbeat()], decoder, system=system)) == 1
    gone, imu = decode_all([raw_imu()], decoder, system=7)
    assert gone == given.Forgotten(given.VehicleId(2, 1), UNIX)
    assert imu.vehicle == given.VehicleId(7, 1)


def test_other_imus_are_skipped_while_the_one_in_use_comes():
    """Half a second after its end they are decoded; a better one always, all if none is known."""
    sent = []
    for k in range(100):
        sent += [raw_imu(S + 20_000 * k)] if k < 50 else []
        others = m.MAVLink_scaled_imu2_message, m.MAVLink_scaled_imu3_message
        sent += [other(1000 + 20 * k, 0, 0, -1000, *[0] * 6) for other in others]

    def taken(in_use):
        decoder = MavlinkDecoder()
        decoder.imu_in_use = lambda _: in_use
        events = only(given.Imu, decode_all(sent, decoder, interval_us=20_000 // 3))
        return {name: sum(e.message == name for e in events) for name in
                ("RAW_IMU", "SCALED_IMU2", "SCALED_IMU3")}  # fmt: skip

    assert taken(None) == {"RAW_IMU": 50, "SCALED_IMU2": 100, "SCALED_IMU3": 100}
    first = taken("RAW_IMU")
    assert first["RAW_IMU"] == 50
    assert 10 < first["SCALED_IMU2"] < 50  # of the 50 after RAW_IMU ended, less half a second
    assert taken("SCALED_IMU2") == {"RAW_IMU": 50, "SCALED_IMU2": 100, "SCALED_IMU3": 0}
