"""Parameters of a compass, played as ArduPilot's ``correct_field`` does."""

import numpy as np
import pytest

from drivers.mavlink.ardupilot import corrected


def sent(parameters, raw, number=""):
    """mag += offsets; mag *= scale; mag = mat * mag."""
    ofs, dia, odi = (
        [parameters.get(f"COMPASS_{name}{number}_{axis}", default) for axis in "XYZ"]
        for name, default in (("OFS", 0.0), ("DIA", 1.0), ("ODI", 0.0))
    )
    x, y, z = odi
    mat = np.array([[dia[0], x, y], [x, dia[1], z], [y, z, dia[2]]])
    return mat @ ((raw + ofs) * parameters.get(f"COMPASS_SCALE{number}", 1.0))


@pytest.mark.parametrize(("message", "number"), [("RAW_IMU", ""), ("SCALED_IMU2", "2")])
@pytest.mark.parametrize("was_soft", [False, True])
def test_with_the_new_parameters_it_sends_the_corrected_field(message, number, was_soft):
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
    wanted = matrix @ (sent(was, raw, number) - 1e3 * offset)
    assert sent(new, raw, number) == pytest.approx(wanted)
    assert not any("DIA" in name for name in corrected(was, message, offset, None))


def test_what_throttle_does_is_nothing_to_begin_with_for_what_the_current_does():
    was = {"COMPASS_MOT_X": 7.0, "COMPASS_MOT_Y": 0.0, "COMPASS_MOT_Z": 0.0}
    found = [
        corrected(was | {"COMPASS_MOTCT": by}, "RAW_IMU", np.zeros(3), None, np.full(3, 1e-3))
        for by in (1.0, 2.0)
    ]
    assert [each["COMPASS_MOT_X"] for each in found] == pytest.approx([-1.0, 6.0])
