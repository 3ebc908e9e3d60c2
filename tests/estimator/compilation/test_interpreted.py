"""Interpreted kernels say what compiled ones say, and nothing of theirs is compiled."""

from types import ModuleType

import numba
import numpy as np
import pytest

from estimator.compilation.fingerprint import is_library
from estimator.compilation.interpreted import interpreted, is_interpreting, set_interpreting
from estimator.conditioning.condition import condition
from estimator.estimator import Estimator
from estimator.filter import kernel
from estimator.live import resident
from estimator.profile import load_profile
from estimator.types import ImuSample, VelocitySample

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="all is Python")

SAMPLES, STEP_US = 300, 10_000


@pytest.fixture
def interpreting():
    set_interpreting(True)
    yield
    set_interpreting(False)


def flown(profile, *, change_over_at=None):
    """The attitudes of a tumbling vehicle with velocity, all of them."""
    random = np.random.default_rng(5)
    estimator, said = Estimator(load_profile(profile)), []
    for k in range(SAMPLES):
        if k == change_over_at:
            set_interpreting(False)
            estimator.snapshot = estimator.snapshot
        gyr, acc, mag = random.normal(0.0, (0.3, 1.0, 0.05), (3, 3)).T
        time_us = k * STEP_US
        estimator.update(
            ImuSample(
                time_us,
                tuple(gyr.tolist()),
                (acc[0].item(), acc[1].item(), acc[2].item() - 9.8),
                (mag[0].item() + 0.2, mag[1].item(), mag[2].item() + 0.4),
                True,
            )
        )
        if k % 10 == 0:
            estimator.update_velocity(VelocitySample(time_us, (0.1, 0.0, 0.0), True, 0.1))
        said.append(estimator.attitude(time_us))
    return said


def numbers(attitudes):
    return np.array(
        [(*a.q_ned_frd, a.sigma_inclination_rad, a.sigma_heading_rad) for a in attitudes]
    )


@pytest.mark.parametrize("profile", ["imu", "paper"])
def test_both_forms_agree_to_rounding(profile, interpreting):
    in_python = numbers(flown(profile))
    set_interpreting(False)
    np.testing.assert_allclose(in_python, numbers(flown(profile)), rtol=0, atol=1e-9)


def test_a_change_over_is_not_seen_in_the_attitude(interpreting):
    changed = numbers(flown("imu", change_over_at=150))
    np.testing.assert_allclose(changed, numbers(flown("imu")), rtol=0, atol=1e-9)


def test_types_of_results_are_those_of_compiled_code(interpreting):
    attitude = flown("imu")[-1]
    assert {type(x) for x in numbers_in(attitude)} <= {float, int, str}


def numbers_in(value):
    if not isinstance(value, tuple):
        return [value]
    return [x for part in value for x in numbers_in(part)]


def test_nothing_is_compiled_meanwhile():
    """Not behind a module's name either."""
    for function in (resident.advance, resident.advance_raw, resident.advance_aided):
        reached, waiting = set(), [interpreted(function)]
        while waiting:
            form = waiting.pop()
            assert not hasattr(form, "py_func"), form
            assert not isinstance(form, ModuleType) or is_library(form), form
            if id(form) in reached or not hasattr(form, "__globals__"):
                waiting += vars(form).values() if type(form).__name__ == "SimpleNamespace" else []
                continue
            reached.add(id(form))
            waiting += form.__globals__.values()
        assert len(reached) > 10


def test_compiled_functions_stay_as_they_are():
    interpreted(resident.advance)
    assert hasattr(condition, "py_func")
    assert hasattr(kernel.step, "py_func")
    assert not is_interpreting()
