"""What autopilots report about their own position and velocity, in each kind of stream."""

import math

import pytest

from drivers.events import Imu, Position, Velocity
from drivers.logs.open import open_log
from drivers.samples.navigation import MOST_INFLATION, STATUS_HOLDS_US
from tests.drivers.logs.writers import DataflashWriter, UlogWriter
from tests.drivers.mavlink.messages import S, decode_all, m, only, raw_imu

FLYING = 0x33F  # ArduPilot with satellites
STANDING = 0xA7  # const_pos_mode, although with a velocity
WITHOUT = 0x3A5  # const_pos_mode and no velocity
CANBERRA, NEAR_NOWHERE = (-353632610, 1491652299), (2081, -732)  # ArduPlane's before its first fix


def decoded(*messages):
    """The events of messages a tenth of a second apart, an IMU's with each."""
    sent = []
    for k, message in enumerate(messages):
        boot_ms = 100_000 + 100 * k
        if "time_boot_ms" in message.fieldnames:
            message.time_boot_ms = boot_ms
        if message.get_type() == "GPS_RAW_INT":
            message.time_usec = 1000 * boot_ms
        sent += [raw_imu(1000 * boot_ms, gyr=(0, 0, k)), message]
    events = decode_all(sent, interval_us=S // 20)
    return [event for event in events if not isinstance(event, Imu)]


def position(lat=CANBERRA[0], lon=CANBERRA[1]):
    return m.MAVLink_global_position_int_message(0, lat, lon, 584000, 0, 100, 200, 0, 0)


def local():
    return m.MAVLink_local_position_ned_message(0, 0.0, 0.0, 0.0, 1.0, 2.0, 0.0)


def receiver(fix_type):
    return m.MAVLink_gps_raw_int_message(0, fix_type, *CANBERRA, 584000, 100, 100, 500, 9000, 10)


def ardupilot(flags, ratio=0.1):
    return m.MAVLink_ekf_status_report_message(flags, ratio, 0.0, 0.0, 0.0, 0.0)


def px4(flags, ratio=0.1):
    return m.MAVLink_estimator_status_message(S, flags, ratio, 0, 0, 0, 0, 0, 0, 0)


def names(events, kind):
    return [event.message for event in events if isinstance(event, kind)]


def test_what_is_sent_before_the_first_fix_is_no_place():
    """ArduPlane 4.5: a few metres from (0, 0), and fix type 0 or 1 beside it."""
    before = [receiver(0), ardupilot(0x400), position(2081, -732), receiver(1), position(2093, -9)]
    assert names(decoded(*before), Position | Velocity) == []
    events = decoded(*before, receiver(3), ardupilot(FLYING), position())
    assert names(events, Position) == ["GPS_RAW_INT", "GLOBAL_POSITION_INT"]
    assert names(events, Velocity) == ["GPS_RAW_INT", "GLOBAL_POSITION_INT"]


# flags of the filter (None: it never reports), fix type of the receiver (likewise), place, used
PLACES = [
    (None, None, CANBERRA, True),
    (None, None, NEAR_NOWHERE, False),
    (None, 3, CANBERRA, True),
    (None, 6, CANBERRA, True),
    (None, 1, CANBERRA, False),
    (None, 3, NEAR_NOWHERE, False),
    (FLYING, None, CANBERRA, True),
    (FLYING, 0, CANBERRA, True),  # by cameras or beacons
    (FLYING, None, NEAR_NOWHERE, True),  # a ship there
    (STANDING, None, CANBERRA, False),
    (STANDING, 0, CANBERRA, False),
    (STANDING, 3, CANBERRA, True),  # on the bench, before the filter uses it
    (STANDING, 3, NEAR_NOWHERE, False),
    (0x400, 1, NEAR_NOWHERE, False),
    (FLYING & ~0x02, None, NEAR_NOWHERE, True),  # a place without a velocity
    (FLYING & ~0x10, None, CANBERRA, False),  # and a velocity without a place
]


@pytest.mark.parametrize(("flags", "fix", "place", "is_used"), PLACES)
def test_a_place_is_used_where_the_filter_or_the_receiver_has_one(flags, fix, place, is_used):
    status = [] if flags is None else [ardupilot(flags)]
    events = decoded(*status, *([] if fix is None else [receiver(fix)]), position(*place))
    assert ("GLOBAL_POSITION_INT" in names(events, Position)) is is_used
    assert ("GPS_RAW_INT" in names(events, Velocity)) is (fix in (3, 6))  # whatever the filter has


@pytest.mark.parametrize("status", [ardupilot, px4])
@pytest.mark.parametrize(
    ("flags", "ratio", "sigma_m_s"),
    [
        (FLYING, 0.1, 0.3),
        (FLYING, 0.4, 0.3),  # two of its gate's five sigmas
        (FLYING, 1.0, 1.2),
        (FLYING, 2.0, 2.7),
        (FLYING, 1e9, 0.3 * MOST_INFLATION),
        (FLYING, math.nan, 0.3),  # PX4 where there is nothing to test
        *((flags, 0.1, None) for flags in (STANDING, WITHOUT, 0, 0x400, FLYING & ~0x02)),
    ],
)
def test_a_filters_velocity_is_taken_as_far_as_its_own_tests_allow(status, flags, ratio, sigma_m_s):
    events = decoded(status(flags, ratio), position(), local())
    sigmas = [e.sample.sigma_m_s for e in only(Velocity, events)]
    assert sigmas == pytest.approx([sigma_m_s] * 2 if sigma_m_s else [])


def test_a_status_holds_for_a_while():
    later = [local() for _ in range(10 * STATUS_HOLDS_US // S + 1)]
    status, event = decoded(ardupilot(STANDING), *later)
    assert event.arrival_us - status.arrival_us == STATUS_HOLDS_US + S // 10


def dataflash(folder, flags, ratio=0.1):
    log = DataflashWriter()
    log.format("XKF4", "QBcccH", "TimeUS,C,SV,SP,SH,SS")
    log.format("XKF1", "QBfff", "TimeUS,C,VN,VE,VD")
    log.format("IMU", "Qffffff", "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.write("IMU", S, 0.0, 0.0, 0.0, 0.0, 0.0, -9.8)
    log.write("XKF4", S, 0, ratio, 0, 0, flags)
    log.write("XKF4", S, 1, 3.0, 0, 0, STANDING)  # the second filter, which is not read
    log.write("XKF1", S, 0, 1.0, 2.0, 0.0)
    return log.save(folder)


def ulog(folder, flags, *, ratio=0.1, dead_reckoning=False, primary=0, changes=False):
    """Where the filter in use ``changes`` the first one was, at the time of its status."""
    log = UlogWriter().sensors()
    log.sample(S - 1, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8))
    log.topic(0, "estimator_selector_status", "uint8_t primary_instance")
    log.topic(1, "estimator_status", "float vel_test_ratio;uint16_t solution_status_flags")
    flags_of = "bool v_xy_valid;bool v_z_valid;bool dead_reckoning"
    log.topic(2, "vehicle_local_position", f"float vx;float vy;float vz;{flags_of}")
    log.row(0, "B", S, primary)
    if changes:
        log.row(0, "B", S - 1, 0).row(0, "B", S + 2, 1)
    log.row(1, "fH", S + 1, ratio, flags)
    log.row(2, "3f3?", S + 4, 1.0, 2.0, 0.0, True, True, dead_reckoning)
    return log.save(folder)


@pytest.mark.parametrize(
    ("write", "flags", "reported", "sigmas"),
    [
        *((write, FLYING, {}, [0.3]) for write in (dataflash, ulog)),
        *((write, FLYING, {"ratio": 1.0}, [1.2]) for write in (dataflash, ulog)),
        *((write, STANDING, {}, []) for write in (dataflash, ulog)),
        (ulog, FLYING, {"dead_reckoning": True}, []),
        (ulog, STANDING, {"primary": 1}, [0.3]),  # another filter's word than the velocity's
        (ulog, STANDING, {"changes": True}, [0.3]),
    ],
)
def test_on_board_logs(write, flags, reported, sigmas, tmp_path):
    events = list(open_log(write(tmp_path, flags, **reported)))
    assert [e.sample.sigma_m_s for e in only(Velocity, events)] == pytest.approx(sigmas)
