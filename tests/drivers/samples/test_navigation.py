"""The rule how far a receiver and a filter are believed, word by word."""

import math

import pytest

from drivers.events import VehicleId
from drivers.samples.navigation import MOST_INFLATION, STATUS_HOLDS_US, Navigation

ONE = VehicleId(1, 1)
NOW_US = 1_700_000_000_000_000
CANBERRA = (-35.36, 149.17)
NEAR_NOWHERE = (2081e-7, -732e-7)  # what ArduPlane sends before its first fix
FLYING = 0x33F  # ArduPilot with satellites
STANDING = 0xA7  # const_pos_mode, although with a velocity
WITHOUT = 0x3A5  # const_pos_mode and no velocity

# flags of the filter (None: it never spoke), fix type of the receiver (likewise), place, believed
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


@pytest.mark.parametrize(("flags", "fix", "place", "believed"), PLACES)
def test_a_place_needs_a_word(flags, fix, place, believed):
    navigation = Navigation()
    if flags is not None:
        navigation.update_status(ONE, NOW_US, flags, 0.1)
    if fix is not None:
        navigation.update_fix(fix >= 3, NOW_US)
    assert navigation.accepts_position(*place, NOW_US) is believed


@pytest.mark.parametrize("flags", [STANDING, WITHOUT, 0, 0x400, FLYING & ~0x02])
def test_a_filter_that_has_no_velocity_is_not_asked_for_it(flags):
    navigation = Navigation()
    assert navigation.velocity_sigma_m_s(0.3, NOW_US) == 0.3  # it has said nothing yet
    navigation.update_status(ONE, NOW_US, flags, 0.0)
    assert navigation.velocity_sigma_m_s(0.3, NOW_US) is None


@pytest.mark.parametrize(
    ("ratio", "sigma_m_s"),
    [
        (0.0, 0.3),
        (0.4, 0.3),  # two of its gate's five sigmas
        (1.0, 1.2),
        (2.0, 2.7),
        (1e9, 0.3 * MOST_INFLATION),
        (math.nan, 0.3),  # PX4 where there is nothing to test
    ],
)
def test_sigma_grows_with_the_test_ratio(ratio, sigma_m_s):
    navigation = Navigation()
    navigation.update_status(ONE, NOW_US, FLYING, ratio)
    assert navigation.velocity_sigma_m_s(0.3, NOW_US) == pytest.approx(sigma_m_s)


def test_words_hold_for_a_while_and_not_beyond_a_reboot():
    navigation = Navigation()
    navigation.update_status(ONE, NOW_US, STANDING, 0.0)
    assert navigation.velocity_sigma_m_s(0.3, NOW_US + STATUS_HOLDS_US) is None
    assert navigation.velocity_sigma_m_s(0.3, NOW_US + STATUS_HOLDS_US + 1) == 0.3
    navigation.update_status(ONE, NOW_US, 0x10, 0.0)
    navigation.update_fix(False, NOW_US)
    navigation.forget()
    assert navigation.accepts_position(*CANBERRA, NOW_US)
    assert navigation.velocity_sigma_m_s(0.3, NOW_US) == 0.3
    assert not navigation.accepts_position(*NEAR_NOWHERE, NOW_US)
