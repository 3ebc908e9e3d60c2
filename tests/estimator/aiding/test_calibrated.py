"""What is known about a compass, and until when."""

from estimator.aiding.compass import (
    Compass,
    declare,
    is_trusted,
    record_giving_up,
    restart,
)
from estimator.conditioning.times import FORGET_S, LONG_S, MEMORY_S

NOW_US = 500_000_000
AGAIN_US, DISTRUST_US, UNLIKE_US = (int(1e6 * s) for s in (LONG_S, FORGET_S, MEMORY_S))


def given_up_twice(apart_us=AGAIN_US - 1):
    return record_giving_up(record_giving_up(Compass(), NOW_US - apart_us), NOW_US)


def test_it_is_trusted_until_told_otherwise():
    assert is_trusted(Compass(), NOW_US)
    assert not is_trusted(declare(Compass(), False), NOW_US)


def test_giving_up_once_is_no_reason():
    assert is_trusted(record_giving_up(Compass(), NOW_US), NOW_US)
    assert is_trusted(given_up_twice(AGAIN_US), NOW_US)


def test_giving_up_twice_in_a_row_is_one_for_a_while():
    assert not is_trusted(given_up_twice(), NOW_US + DISTRUST_US - 1)
    assert is_trusted(given_up_twice(), NOW_US + DISTRUST_US)


def test_a_field_unlike_the_places_own_must_look_like_it_for_a_while():
    unlike = Compass(unlike_us=NOW_US)
    assert not is_trusted(unlike, NOW_US + UNLIKE_US - 1)
    assert is_trusted(unlike, NOW_US + UNLIKE_US)


def test_being_told_the_same_again_is_no_news():
    """A ground station may fetch the parameters at any time."""
    assert declare(given_up_twice(), True) == given_up_twice()
    assert is_trusted(declare(declare(given_up_twice(), False), True), NOW_US)


def test_a_reboot_leaves_what_was_told():
    """Times before it are of another clock."""
    assert restart(given_up_twice()) == Compass()
    once = restart(record_giving_up(Compass(), NOW_US))
    assert is_trusted(record_giving_up(once, 1_000_000), 1_000_000)
    assert not is_trusted(restart(declare(Compass(), False)), 0)
