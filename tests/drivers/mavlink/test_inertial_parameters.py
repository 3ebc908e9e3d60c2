"""Parameters of an IMU, played as ArduPilot does: (raw - offset) * scale."""

import numpy as np
import pytest

from drivers.mavlink.ardupilot import inertial_parameters
from estimator.calibration import Calibration

FOUND = Calibration(
    gyr_bias_rad_s=(0.01, -0.02, 0.03),
    acc_bias_m_s2=(0.1, 0.2, -0.3),
    acc_matrix=((1.02, 0.0, 0.0), (0.0, 0.97, 0.0), (0.0, 0.0, 1.01)),
)


def sent(parameters, raw, name, scale=None):
    offset = [parameters.get(f"{name}_{axis}", 0.0) for axis in "XYZ"]
    scales = [parameters.get(f"{scale}_{axis}", 1.0) for axis in "XYZ"]
    return (raw - offset) * scales


@pytest.mark.parametrize(
    ("message", "gyr", "acc"),
    [("RAW_IMU", "INS_GYROFFS", "INS_ACC"), ("SCALED_IMU2", "INS_GYR2OFFS", "INS_ACC2")],
)
@pytest.mark.parametrize("is_set", [False, True])
def test_with_the_new_parameters_it_sends_what_is_right(message, gyr, acc, is_set):
    three = [(gyr, 0.004), (f"{acc}OFFS", 0.5), (f"{acc}SCAL", 1.1)]
    was = {f"{name}_{axis}": value for name, value in three for axis in "XYZ"} if is_set else {}
    new = was | inertial_parameters(was, message, FOUND)
    raw = np.array([0.3, -0.2, 9.0])
    rate = sent(was, raw, gyr) - FOUND.gyr_bias_rad_s
    assert sent(new, raw, gyr) == pytest.approx(rate)
    force = sent(was, raw, f"{acc}OFFS", f"{acc}SCAL") - FOUND.acc_bias_m_s2
    wanted = np.array(FOUND.acc_matrix) @ force
    assert sent(new, raw, f"{acc}OFFS", f"{acc}SCAL") == pytest.approx(wanted)


def test_what_is_right_already_is_not_named():
    assert inertial_parameters({}, "RAW_IMU", Calibration()) == {}
    assert inertial_parameters({"AHRS_ORIENTATION": 4.0}, "RAW_IMU", FOUND) == {}
