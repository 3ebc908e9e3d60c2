"""Whatever the bounds allow, an estimator in flight survives: alone, together, at both ends."""

import math
import random

import numba
import numpy as np
import pytest

from estimator.aiding.types import AidingParams
from estimator.bounds import bounds_of
from estimator.conditioning.params import ConditioningParams
from estimator.errors import InputError
from estimator.estimator import Estimator
from estimator.profile import load_profile, merge_profile
from tests.flight import banked_flight, north_known, taken_along

SECTIONS = {"conditioning": ConditioningParams, "aiding": AidingParams}
BOUNDS = {section: bounds_of(kind) for section, kind in SECTIONS.items()}
SWITCHES = [
    name for name, value in ConditioningParams._field_defaults.items() if isinstance(value, bool)
]
FILTER = {
    "gamma": (0.0, 1e3),
    "rate_time_constant_s": (1e-3, 1e3),
    "bias_bound_rad_s": (0.0, 100.0),
    "euler_step_max_s": (0.0, 0.01),
    "first_step_s": (0.0, 0.01),
}
CONFIDENCE = dict.fromkeys(("gravity", "magnetic", "cross"), (0.0, 1e3))
EVERY = {**BOUNDS, "filter": FILTER, "confidence": CONFIDENCE}
BEFORE, AFTER = 300, 250  # samples: aided by then, and through half of a banked turn
GAP_US = 700_000  # a hole in the stream, behind the change

slow_in_python = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="a hundred flights")


@pytest.fixture(scope="module")
def start():
    """An estimator in flight, helped by velocity, with what comes next."""
    flight = banked_flight(11.0, seed=1)
    estimator, reports = taken_along(north_known(), flight, BEFORE), dict(flight.reports)
    rest = [(sample, reports.get(k)) for k, sample in enumerate(flight.samples)]
    return estimator.profile, estimator.snapshot, rest[BEFORE : BEFORE + AFTER]


def require_survival(start, partial):
    """Fly on with the change; every published number is finite."""
    profile, snapshot, rest = start
    estimator = Estimator(profile)
    estimator.snapshot = snapshot
    estimator.replace_profile(merge_profile(profile, partial))
    for k, (sample, report) in enumerate(rest):
        late_us = GAP_US * (k > AFTER // 2)
        assert estimator.update(sample._replace(time_us=sample.time_us + late_us)) is None
        if report is not None:
            estimator.update_report(report._replace(time_us=report.time_us + late_us))
        attitude = estimator.attitude(sample.time_us + late_us)
        assert np.isfinite(np.hstack(attitude[:-1])).all(), (partial, k, attitude)


def test_every_number_has_bounds_that_hold_its_default():
    for section, kind in SECTIONS.items():
        for name, default in kind._field_defaults.items():
            if not isinstance(default, bool):
                low, high = BOUNDS[section][name]
                assert 0.0 < low < default < high < 1e5, name


@slow_in_python
@pytest.mark.parametrize("end", [0, 1])
@pytest.mark.parametrize("section", SECTIONS)
def test_each_alone(start, section, end):
    for name, bounds in BOUNDS[section].items():
        require_survival(start, {section: {name: bounds[end]}})


@pytest.mark.parametrize("end", [0, 1])
def test_all_together(start, end):
    partial = {
        section: {name: bounds[end] for name, bounds in known.items()}
        for section, known in EVERY.items()
    }
    require_survival(start, partial)


@slow_in_python
def test_any_mixture_of_ends(start):
    rng = random.Random(2)
    for _ in range(60):
        share = rng.choice((0.1, 0.5, 1.0))
        partial = {
            section: {n: rng.choice(b) for n, b in known.items() if rng.random() < share}
            for section, known in EVERY.items()
        }
        partial["conditioning"] |= {name: rng.random() < 0.7 for name in SWITCHES}
        require_survival(start, partial)


@pytest.mark.parametrize("section", SECTIONS)
def test_beyond_its_bounds_each_is_refused_by_name(section):
    base = load_profile("imu")
    for name, (low, high) in BOUNDS[section].items():
        for value in (math.nextafter(low, 0.0), math.nextafter(high, 1e9), 5e-324, 1e300, -1.0):
            with pytest.raises(InputError, match=rf"{section}\.{name}: .* is outside \["):
                merge_profile(base, {section: {name: value}})
