"""PARAM_VALUE of autopilots and others; parameters of compass and IMU as ArduPilot uses them."""

import struct

import numpy as np
import pytest

from drivers.events import Parameter, VehicleId
from drivers.mavlink.ardupilot import corrected, inertial_parameters
from drivers.mavlink.decoder import MOST_WAITING, MavlinkDecoder
from estimator.calibration import Calibration
from tests.drivers.mavlink.messages import ARDUPILOT, PX4, decode_all, heartbeat, m, only, raw_imu

NO_AUTOPILOT = 8
REAL, INT32 = 9, 6


def events_of(*sent):
    """The events of (system, component, message), each through real bytes."""
    decoder = MavlinkDecoder()
    return [
        event
        for system, component, message in sent
        for event in decode_all([message], decoder, system=system, component=component)
    ]


def parameter(name=b"AHRS_TRIM_X", value=0.05, kind=REAL):
    return m.MAVLink_param_value_message(name, value, kind, 1, 0)


ONE, TWO = VehicleId(1, 1), VehicleId(1, 2)


@pytest.mark.parametrize(
    ("sent", "expected"),
    [
        ([(1, 1, parameter())], [ONE]),
        ([(1, 1, heartbeat()), (1, 190, parameter())], [ONE]),  # MAVProxy's
        ([(1, 190, parameter()), (1, 1, heartbeat())], [ONE]),  # before any autopilot was
        ([(1, 190, parameter()), (1, 190, heartbeat(NO_AUTOPILOT))], []),
        ([(1, 1, heartbeat()), (2, 190, parameter())], []),  # another system's
        ([(1, 1, heartbeat()), (0, 190, parameter())], []),
        ([(1, 2, raw_imu()), (1, 190, parameter())], [TWO]),  # an autopilot by what it sends
        ([(1, 2, heartbeat()), (1, 1, heartbeat()), (1, 190, parameter())], [ONE]),
        ([(1, 2, heartbeat()), (1, 1, heartbeat()), (1, 2, parameter())], [TWO]),
    ],
)
def test_whose_a_parameter_is(sent, expected):
    assert [event.vehicle for event in only(Parameter, events_of(*sent))] == expected


@pytest.mark.parametrize(("autopilot", "value"), [(PX4, 21.0), (ARDUPILOT, 2.942726775082116e-44)])
def test_an_integer_is_read_as_its_autopilot_writes_it(autopilot, value):
    bits = struct.unpack("<f", struct.pack("<i", 21))[0]
    sent = parameter(b"MAV_TYPE", bits, INT32)
    for order in (
        [(1, 1, heartbeat(autopilot)), (1, 190, sent)],
        [(1, 190, sent), (1, 1, heartbeat(autopilot))],
    ):
        (found,) = only(Parameter, events_of(*order))
        assert found.value == value


def test_what_waits_is_bounded_and_the_latest_of_each_name():
    others = [(1 + k % 8, 190, parameter(b"P%d" % k)) for k in range(MOST_WAITING)]
    sent = [(1, 190, parameter(b"A", 1.0)), (1, 190, parameter(b"A", 2.0)), *others]
    beats = ((system, 1, heartbeat()) for system in range(1, 9))
    found = only(Parameter, events_of(*sent, *beats))
    assert len(found) == MOST_WAITING
    assert [event.value for event in found if event.name == "A"] == [2.0]


def compass_sent(parameters, raw, number=""):
    """``correct_field``: mag += offsets; mag *= scale; mag = mat * mag."""
    ofs, dia, odi = (
        [parameters.get(f"COMPASS_{name}{number}_{axis}", default) for axis in "XYZ"]
        for name, default in (("OFS", 0.0), ("DIA", 1.0), ("ODI", 0.0))
    )
    x, y, z = odi
    mat = np.array([[dia[0], x, y], [x, dia[1], z], [y, z, dia[2]]])
    return mat @ ((raw + ofs) * parameters.get(f"COMPASS_SCALE{number}", 1.0))


@pytest.mark.parametrize(("message", "number"), [("RAW_IMU", ""), ("SCALED_IMU2", "2")])
@pytest.mark.parametrize("was_soft", [False, True])
def test_with_the_new_parameters_a_compass_sends_the_corrected_field(message, number, was_soft):
    names = ("OFS", [5.0, 13.0, -18.0]), ("DIA", [0.9, 1.1, 1.2]), ("ODI", [0.0, 0.0, 0.0])
    was = {
        f"COMPASS_{name}{number}_{axis}": value
        for name, three in names[: 3 if was_soft else 1]
        for axis, value in zip("XYZ", three, strict=True)
    }
    was |= {f"COMPASS_SCALE{number}": 1.1} if was_soft else {}
    offset = np.array([0.06, -0.04, 0.05])
    matrix = np.diag([1.05, 0.95, 1.02]) if was_soft else np.eye(3) + 0.03 * np.eye(3)[::-1]
    raw = np.random.default_rng(1).normal(0.0, 400.0, 3)
    new = was | corrected(was, message, offset, matrix)
    wanted = matrix @ (compass_sent(was, raw, number) - 1e3 * offset)
    assert compass_sent(new, raw, number) == pytest.approx(wanted)
    assert not any("DIA" in name for name in corrected(was, message, offset, None))


FOUND = Calibration(
    gyr_bias_rad_s=(0.01, -0.02, 0.03),
    acc_bias_m_s2=(0.1, 0.2, -0.3),
    acc_matrix=((1.02, 0.0, 0.0), (0.0, 0.97, 0.0), (0.0, 0.0, 1.01)),
)


def imu_sent(parameters, raw, name, scale=None):
    """(raw - offset) * scale."""
    offset = [parameters.get(f"{name}_{axis}", 0.0) for axis in "XYZ"]
    scales = [parameters.get(f"{scale}_{axis}", 1.0) for axis in "XYZ"]
    return (raw - offset) * scales


@pytest.mark.parametrize(
    ("message", "gyr", "acc"),
    [("RAW_IMU", "INS_GYROFFS", "INS_ACC"), ("SCALED_IMU2", "INS_GYR2OFFS", "INS_ACC2")],
)
@pytest.mark.parametrize("is_set", [False, True])
def test_with_the_new_parameters_an_imu_sends_what_is_right(message, gyr, acc, is_set):
    three = [(gyr, 0.004), (f"{acc}OFFS", 0.5), (f"{acc}SCAL", 1.1)]
    was = {f"{name}_{axis}": value for name, value in three for axis in "XYZ"} if is_set else {}
    new = was | inertial_parameters(was, message, FOUND)
    raw = np.array([0.3, -0.2, 9.0])
    rate = imu_sent(was, raw, gyr) - FOUND.gyr_bias_rad_s
    assert imu_sent(new, raw, gyr) == pytest.approx(rate)
    force = imu_sent(was, raw, f"{acc}OFFS", f"{acc}SCAL") - FOUND.acc_bias_m_s2
    wanted = np.array(FOUND.acc_matrix) @ force
    assert imu_sent(new, raw, f"{acc}OFFS", f"{acc}SCAL") == pytest.approx(wanted)


def test_what_is_right_already_is_not_named():
    assert inertial_parameters({}, "RAW_IMU", Calibration()) == {}
    assert inertial_parameters({"AHRS_ORIENTATION": 4.0}, "RAW_IMU", FOUND) == {}


def test_what_throttle_does_is_nothing_to_begin_with_for_what_the_current_does():
    was = {"COMPASS_MOT_X": 7.0, "COMPASS_MOT_Y": 0.0, "COMPASS_MOT_Z": 0.0}
    found = [
        corrected(was | {"COMPASS_MOTCT": by}, "RAW_IMU", np.zeros(3), None, np.full(3, 1e-3))
        for by in (1.0, 2.0)
    ]
    assert [each["COMPASS_MOT_X"] for each in found] == pytest.approx([-1.0, 6.0])
