"""What is known about a compass, and until when."""

from estimator.aiding.compass import (
    AGAIN_US,
    DISTRUST_US,
    UNLIKE_US,
    Compass,
    calibrated,
    given_up,
    restarted,
    told,
)

NOW_US = 500_000_000


def given_up_twice(apart_us=AGAIN_US - 1):
    return given_up(given_up(Compass(), NOW_US - apart_us), NOW_US)


def test_it_is_trusted_until_told_otherwise():
    assert calibrated(Compass(), NOW_US)
    assert not calibrated(told(Compass(), False), NOW_US)


def test_giving_up_once_is_no_reason():
    assert calibrated(given_up(Compass(), NOW_US), NOW_US)
    assert calibrated(given_up_twice(AGAIN_US), NOW_US)


def test_giving_up_twice_in_a_row_is_one_for_a_while():
    assert not calibrated(given_up_twice(), NOW_US + DISTRUST_US - 1)
    assert calibrated(given_up_twice(), NOW_US + DISTRUST_US)


def test_a_field_unlike_the_places_own_must_look_like_it_for_a_while():
    unlike = Compass(unlike_us=NOW_US)
    assert not calibrated(unlike, NOW_US + UNLIKE_US - 1)
    assert calibrated(unlike, NOW_US + UNLIKE_US)


def test_being_told_the_same_again_is_no_news():
    """A ground station may fetch the parameters at any time."""
    assert told(given_up_twice(), True) == given_up_twice()
    assert calibrated(told(told(given_up_twice(), False), True), NOW_US)


def test_a_reboot_leaves_what_was_told():
    """Times before it are of another clock."""
    assert restarted(given_up_twice()) == Compass()
    once = restarted(given_up(Compass(), NOW_US))
    assert calibrated(given_up(once, 1_000_000), 1_000_000)
    assert not calibrated(restarted(told(Compass(), False)), 0)
