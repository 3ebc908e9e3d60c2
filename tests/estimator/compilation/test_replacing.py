"""Replaced fields of named tuples, in Python and in compiled code."""

from typing import NamedTuple

import pytest

from estimator.compilation.compiled import compiled, replacer


class Inner(NamedTuple):
    value: tuple[float, float]
    flag: bool


class Outer(NamedTuple):
    first: float
    inner: Inner
    last: int


with_last_and_first = replacer(Outer, "last", "first")
with_inner = replacer(Outer, "inner")
BEFORE = Outer(1.0, Inner((2.0, 3.0), flag=True), 4)


@compiled
def change(outer: Outer, last: int, first: float) -> Outer:
    return with_inner(with_last_and_first(outer, last, first), Inner((first, first), False))


@pytest.mark.parametrize("function", [change, getattr(change, "py_func", change)])
def test_only_what_is_named_changes_and_in_the_order_named(function):
    assert function(BEFORE, 9, 7.0) == Outer(7.0, Inner((7.0, 7.0), flag=False), 9)
    assert with_last_and_first(BEFORE, 5, 6.0) == BEFORE._replace(last=5, first=6.0)
    assert isinstance(function(BEFORE, 9, 7.0), Outer)


@pytest.mark.parametrize("names", [("middle",), ("first", "first")])
def test_a_field_that_is_not_there_or_twice_is_refused_at_once(names):
    with pytest.raises(ValueError, match="Outer has the fields"):
        replacer(Outer, *names)
