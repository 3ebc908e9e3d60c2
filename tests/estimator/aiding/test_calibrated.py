"""What is known about a compass, and until when."""

from estimator.aiding.compass import (
    Compass,
    declare,
    is_trusted,
    record_giving_up,
    rejected_until_us,
    restart,
)
from estimator.conditioning.params import FORGET_S, LONG_S, MEMORY_S

NOW_US = 500_000_000
AGAIN_US, DISTRUST_US, UNLIKE_US = (int(1e6 * s) for s in (LONG_S, FORGET_S, MEMORY_S))


DECLARED = declare(Compass(), True)


def given_up_twice(apart_us=AGAIN_US - 1):
    return record_giving_up(record_giving_up(DECLARED, NOW_US - apart_us), NOW_US)


def test_it_has_to_be_declared_calibrated():
    assert not is_trusted(Compass(), NOW_US)
    assert is_trusted(DECLARED, NOW_US)
    assert not is_trusted(declare(DECLARED, False), NOW_US)


def test_velocity_confirms_only_one_without_a_declaration():
    assert is_trusted(Compass(confirmed=True), NOW_US)
    assert not is_trusted(Compass(declared_calibrated=False, confirmed=True), NOW_US)


def test_giving_up_once_is_no_reason():
    assert is_trusted(record_giving_up(DECLARED, NOW_US), NOW_US)
    assert is_trusted(given_up_twice(AGAIN_US), NOW_US)


def test_giving_up_twice_in_a_row_is_one_for_a_while():
    assert not is_trusted(given_up_twice(), NOW_US + DISTRUST_US - 1)
    assert is_trusted(given_up_twice(), NOW_US + DISTRUST_US)


def test_a_field_unlike_the_places_own_must_look_like_it_for_a_while():
    unlike = DECLARED._replace(unlike_us=NOW_US)
    assert not is_trusted(unlike, NOW_US + UNLIKE_US - 1)
    assert is_trusted(unlike, NOW_US + UNLIKE_US)


def test_declaring_the_same_again_is_no_news():
    """A ground station may fetch the parameters at any time."""
    assert declare(given_up_twice(), True) == given_up_twice()
    assert is_trusted(declare(declare(given_up_twice(), False), True), NOW_US)


def test_a_reboot_leaves_what_was_declared():
    """Times before it are of another clock."""
    assert restart(given_up_twice()) == DECLARED
    once = restart(record_giving_up(DECLARED, NOW_US))
    assert is_trusted(record_giving_up(once, 1_000_000), 1_000_000)
    assert not is_trusted(restart(declare(Compass(), False)), 0)


def test_what_velocity_contradicted_counts_until_velocity_confirms_it():
    contradicted = DECLARED._replace(contradicted_us=NOW_US)
    assert rejected_until_us(contradicted) == NOW_US + DISTRUST_US
    assert rejected_until_us(contradicted._replace(confirmed=True)) < 0
    assert not is_trusted(contradicted, NOW_US)
    assert is_trusted(contradicted._replace(confirmed=True), NOW_US)
