"""The numbers are those of pymavlink's definitions."""

import pytest

from drivers.mavlink import constants
from drivers.mavlink.constants import mavlink

NAMES = [name for name in vars(constants) if name.isupper()]
OF_OURS = {"HIGHRES_IMU_UPDATED_MAG", "UNKNOWN_UINT16"}


@pytest.mark.parametrize("name", sorted({*NAMES} - OF_OURS))
def test_numbers_are_the_dialect_s(name):
    own = name.endswith("_ID")
    known = f"MAVLINK_MSG_ID_{name[:-3]}" if own else name
    assert getattr(constants, name) == getattr(mavlink(), known)


def test_the_magnetometer_s_bits():
    m = mavlink()
    bits = (m.HIGHRES_IMU_UPDATED_XMAG, m.HIGHRES_IMU_UPDATED_YMAG, m.HIGHRES_IMU_UPDATED_ZMAG)
    assert sum(bits) == constants.HIGHRES_IMU_UPDATED_MAG
