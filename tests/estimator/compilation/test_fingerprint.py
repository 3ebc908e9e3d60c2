"""A kernel is compiled anew for what it is made of, and for nothing else."""

import textwrap
import types
from pathlib import Path

import pytest

import estimator
from estimator.compilation.fingerprint import Fingerprints

LIMITS = '''
"""Limits."""
LIMIT = 2.0  # of nothing
NEAR = (1.0, 2)
'''
PARTS = '''
from typing import Annotated, NamedTuple

import limits
from limits import NEAR

class State(NamedTuple):
    """What changes."""

    x: float
    y: Annotated[float, (0, 9)] = 0.5

def part(state: State) -> float:
    """A part."""
    return state.x if state.x < limits.LIMIT else NEAR[0]

def unused():
    """Nothing calls it."""
    return 1.0
'''
KERNEL = '''
from math import sqrt

import parts
from parts import State, part

def kernel(state: State) -> float:
    """A kernel."""
    # the root of a part
    return sqrt(late(state))

def late(state: State, by=1.0) -> float:
    """Defined behind its user."""
    return part(state) + by + 3.0
'''


def taken(monkeypatch, limits=LIMITS, parts=PARTS, kernel=KERNEL):
    """The kernel's fingerprint, with these sources."""
    for name, source in (("limits", limits), ("parts", parts), ("kernels", kernel)):
        module = types.ModuleType(name)
        monkeypatch.setitem(__import__("sys").modules, name, module)
        exec(compile(textwrap.dedent(source), f"{name}.py", "exec"), vars(module))
    return Fingerprints().of(module.kernel)


SAME = {
    "a kernel's docstring": (KERNEL, '"""A kernel."""', '"""Another."""'),
    "a part's docstring": (PARTS, '"""A part."""', '"""Some part,\n    on two lines."""'),
    "a type's docstring": (PARTS, '"""What changes."""', '"""Or not."""'),
    "a comment": (KERNEL, "# the root of a part", "# so be it\n    # and more"),
    "lines above": (KERNEL, "from math", "\n\n\n\nfrom math"),
    "a function that is not called": (PARTS, "return 1.0", "return 2.0"),
    "bounds of a parameter": (PARTS, "(0, 9)", "(0, 8)"),
}
OTHER = {
    "a constant in a kernel": (KERNEL, "3.0", "3.5"),
    "a default": (KERNEL, "by=1.0", "by=1.5"),
    "a type of constant": (KERNEL, "3.0", "3"),
    "another function": (KERNEL, "sqrt", "sin"),
    "a constant of a module": (LIMITS, "2.0", "2.5"),
    "a number in a tuple": (LIMITS, "(1.0, 2)", "(1.0, 3)"),
    "a part": (PARTS, "state.x <", "state.y <"),
    "the order of a type's fields": (
        PARTS,
        "x: float\n    y: Annotated[float, (0, 9)] = 0.5",
        "y: Annotated[float, (0, 9)]\n    x: float = 0.5",
    ),
    "a field's type": (PARTS, "x: float", "x: int"),
    "a field's default": (PARTS, "= 0.5", "= 0.6"),
    "a sign of zero": (LIMITS, "2.0", "-0.0"),
}


def changed(change):
    source, before, after = change
    assert before in source
    name = {LIMITS: "limits", PARTS: "parts", KERNEL: "kernel"}[source]
    return {name: source.replace(before, after)}


@pytest.mark.parametrize("change", SAME.values(), ids=SAME)
def test_words_are_no_part_of_it(monkeypatch, change):
    assert taken(monkeypatch, **changed(change)) == taken(monkeypatch)


@pytest.mark.parametrize("change", OTHER.values(), ids=OTHER)
def test_what_ends_up_in_machine_code_is(monkeypatch, change):
    assert taken(monkeypatch, **changed(change)) != taken(monkeypatch)


def test_a_constant_of_a_real_kernel(monkeypatch):
    """And one that only the Python around the kernels uses is no part of it."""
    from estimator.aiding.sources import velocity
    from estimator.compilation.compiled import plain
    from estimator.filter import kernel

    def of_step():
        return Fingerprints().of(plain(kernel.step))

    before = of_step()
    monkeypatch.setattr(velocity, "SPEED_LIMIT_M_S", 1.0)
    assert of_step() == before
    monkeypatch.setattr(kernel, "PLAIN_STEP_LIMIT", 1.7)
    assert of_step() != before


def test_every_module_with_kernels_is_described_without_addresses():
    """``<... at 0x...>`` in a description would be another one at each start."""
    from estimator.live import resident

    marks = Fingerprints()
    described = []
    real = marks._describe
    marks._describe = lambda value: described.append(real(value)) or described[-1]
    kernels = [value for value in vars(resident).values() if hasattr(value, "py_func")]
    for kernel in kernels or [resident.advance]:
        marks.of(getattr(kernel, "py_func", kernel))
    assert len(described) > 1000
    assert not [text for text in described if "0x" in text and " at 0x" in text]
    assert Path(next(iter(estimator.__path__))).name not in described  # no path either
