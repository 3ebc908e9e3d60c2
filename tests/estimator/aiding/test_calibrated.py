"""What is known about a compass, and until when."""

import pytest

from estimator.aiding.compass import (
    Compass,
    declare,
    is_usable,
    record_giving_up,
    rejected_until_us,
    restart,
)
from estimator.conditioning.params import FORGET_S, LONG_S, MEMORY_S

NOW_US = 500_000_000
AGAIN_US, MISLED_US, UNLIKE_US = (int(1e6 * s) for s in (LONG_S, FORGET_S, MEMORY_S))


DECLARED = declare(Compass(), True)


def given_up_twice(apart_us=AGAIN_US - 1):
    return record_giving_up(record_giving_up(DECLARED, NOW_US - apart_us), NOW_US)


UNLIKE = DECLARED._replace(unlike_us=NOW_US)
CONTRADICTED = DECLARED._replace(contradicted_us=NOW_US)


@pytest.mark.parametrize(
    ("known", "passed_us", "usable"),
    [
        (Compass(), 0, False),  # it has to be declared calibrated
        (DECLARED, 0, True),
        (declare(DECLARED, False), 0, False),
        (Compass(confirmed=True), 0, True),  # velocity confirms only one without a declaration
        (Compass(declared_calibrated=False, confirmed=True), 0, False),
        (record_giving_up(DECLARED, NOW_US), 0, True),
        (given_up_twice(AGAIN_US), 0, True),
        (given_up_twice(), MISLED_US - 1, False),  # twice in a row counts for a while
        (given_up_twice(), MISLED_US, True),
        (UNLIKE, UNLIKE_US - 1, False),  # a field unlike the place's own
        (UNLIKE, UNLIKE_US, True),
        (CONTRADICTED, 0, False),  # until velocity confirms it
        (CONTRADICTED._replace(confirmed=True), 0, True),
    ],
)
def test_what_is_known_shows_whether_a_compass_is_usable(known, passed_us, usable):
    assert is_usable(known, NOW_US + passed_us) is usable


def test_a_contradicted_compass_is_rejected_until_velocity_confirms_it():
    assert rejected_until_us(CONTRADICTED) == NOW_US + MISLED_US
    assert rejected_until_us(CONTRADICTED._replace(confirmed=True)) < 0
    # to declare the same again is no news: a ground station may fetch the parameters at any time
    assert declare(given_up_twice(), True) == given_up_twice()
    assert is_usable(declare(declare(given_up_twice(), False), True), NOW_US)


def test_a_reboot_leaves_what_was_declared():
    """Times before it are of another clock."""
    assert restart(given_up_twice()) == DECLARED
    once = restart(record_giving_up(DECLARED, NOW_US))
    assert is_usable(record_giving_up(once, 1_000_000), 1_000_000)
    assert not is_usable(restart(declare(Compass(), False)), 0)
