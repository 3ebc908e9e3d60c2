"""Readings and stamps that cannot be, in any mixture: each is used or has its reason."""

import math
from collections import Counter
from itertools import pairwise

import pytest
from hypothesis import given

from drivers.events import ClockReset, Imu, Rejected, VehicleId
from drivers.samples.imu_stream import Field, Stamp
from drivers.samples.intake import Intake
from drivers.samples.vehicle_clock import TimeField
from estimator.types import ZERO_VEC3
from tests.drivers.mavlink.messages import UNIX, S
from tests.fuzz.cases import built, fuzzed

NUMBERS = (1e300, -1e300, 3e38, 3e34, math.nan, math.inf, 0.0, -0.0, 5e-324, 9999.0, 10.0)


class Row:
    """A sample that is sound until something happens to it."""

    def __init__(self, k, period_us, rng):
        self.raw_us, self.arrival_us = 500 * S + k * period_us, UNIX + k * period_us
        turn = 0.3 * math.sin(1e-6 * k * period_us)
        gyr = (turn, 0.1 - turn, 0.05)
        self.gyr, self.acc, self.mag = (
            tuple(x + rng.gauss(0.0, sigma) for x in v)
            for v, sigma in ((gyr, 0.01), ((0.0, 0.5, -9.8), 0.05), ((0.2, 0.0, 0.4), 0.003))
        )


def number(rows, rng, name):
    """One that stands for none, in one axis or in all; the row's other readings are sound."""
    for row in rows:
        bad = rng.choice(NUMBERS)
        axes = getattr(row, name)
        setattr(row, name, (bad,) * 3 if rng.random() < 0.5 else (bad, *axes[1:]))


def held(rows, rng, name):
    for row in rows:
        setattr(row, name, getattr(rows[0], name))


def scaled(rows, rng, name):
    scale = 10.0 ** rng.uniform(-3.0, 6.0)
    for row in rows:
        setattr(row, name, tuple(scale * x for x in getattr(row, name)))


def wrapped(rows, rng, name):
    unit = {"gyr": rng.choice((1e-3, math.radians(0.1))), "acc": 9.80665e-3, "mag": 1e-3}[name]
    peak = rng.uniform(25.0, 45.0) * 1e3
    for k, row in enumerate(rows):
        counts = getattr(row, name)[0] / unit + peak * math.sin(math.pi * k / len(rows))
        if not math.isfinite(counts):
            continue
        shown = unit * ((round(counts) + 32768) % 65536 - 32768)
        setattr(row, name, (shown, *getattr(row, name)[1:]))


def swapped(rows, rng, name):
    for row in rows:
        row.gyr, row.acc = row.acc, row.gyr


def set_off(rows, rng, name):
    """A clock that is set, and perhaps back again."""
    step_us = rng.choice((-1, 1)) * rng.choice(
        (20_000, 500_000, 1_900_000, 99 * S, 3600 * S, 86_400 * S)
    )
    for row in rows:
        row.raw_us = max(row.raw_us + step_us, 0)


def late(rows, rng, name):
    for row in rows:
        row.arrival_us += rng.randrange(3 * S)


def repeated(rows, rng, name):
    for row in rows[1:]:
        row.raw_us = rows[0].raw_us


VALUES, CLOCKS = [number, held, scaled, wrapped, swapped], [set_off, late, repeated]


def flight(rng, faults):
    """Rows of any rate, some stretches of which have one of the faults."""
    period_us = rng.choice((2_500, 10_000, 20_000, 100_000, 250_000))
    rows = [Row(k, period_us, rng) for k in range(400)]
    for _ in range(rng.randrange(1, 6)):
        begin = rng.randrange(len(rows))
        count = rng.choice((1, 2, 3, 5, 6, 20, 100, 400))
        rng.choice(faults)(rows[begin : begin + count], rng, rng.choice(("gyr", "acc", "mag")))
    return rows


def taken(rows):
    """The samples and the refusals of a flight's rows; the latter not of a field alone."""
    intake, events = Intake(VehicleId(1, 1)), []
    for row in rows:
        stamp = Stamp(TimeField.TIME_USEC, row.raw_us, row.arrival_us)
        events += intake.imu("RAW_IMU", stamp, row.gyr, row.acc, Field(row.mag))
    events += intake.end()
    refused = Counter(str(e.reason) for e in events if isinstance(e, Rejected))
    of_rows = {why: n for why, n in refused.items() if not why.startswith("magnetometer")}
    return [e for e in events if isinstance(e, Imu)], of_rows, events


@pytest.mark.parametrize(
    "faults", [VALUES, CLOCKS, VALUES + CLOCKS], ids=("values", "clocks", "both")
)
@fuzzed(60, 6000)
@given(built(lambda rng: rng))
def test_each_row_is_used_or_has_a_reason(faults, rng):
    rows = flight(rng, faults)
    samples, refused, events = taken(rows)
    assert len(samples) + sum(refused.values()) == len(rows)
    assert all(a.sample.time_us < b.sample.time_us for a, b in pairwise(samples))
    for event in samples:
        sample = event.sample
        assert all(map(math.isfinite, sample.gyr_rad_s + sample.acc_m_s2 + sample.mag_gauss))
        assert max(map(abs, sample.mag_gauss)) <= 8.0
        assert sample.has_mag or sample.mag_gauss == ZERO_VEC3
    if faults is VALUES:
        assert not [event for event in events if isinstance(event, ClockReset)]


@fuzzed(60, 3000)
@given(built(lambda rng: rng))
def test_no_row_is_lost_whose_field_alone_is_wrong(rng):
    rows = [Row(k, 20_000, rng) for k in range(400)]
    for fault in rng.sample([number, held, scaled, wrapped], 2):
        begin = rng.randrange(len(rows))
        fault(rows[begin : begin + rng.randrange(1, 200)], rng, "mag")
    samples, refused, _ = taken(rows)
    assert (len(samples), refused) == (len(rows), {})
