"""The same faults in every kind of log: the same words for them, a sound attitude after them."""

import json
import math
import random
from collections import Counter

import pytest

from drivers.events import ClockReset
from drivers.logs.open import open_log
from estimator.profile import load_profile
from fuzzbee.cli import main
from fuzzbee.replays.score import report_log
from tests.drivers.logs.writers import (
    ALL_WRITERS,
    LAST_S,
    RATE_HZ,
    WRITERS,
    flight,
    gaps_s,
    imu_times,
    mcap,
    of,
    reasons,
    tlog,
)
from tests.drivers.mavlink.messages import UNIX, S

BEGIN_S, END_S = 8.0, 12.0
HOLDS_DEG = 5.0


def read(path):
    """Resets, times of the samples, and what is refused."""
    events = list(open_log(path))
    return of(ClockReset, events), imu_times(events), reasons(events)


def shifted(by_s):
    """Each sample of the flight, with its clock changed by so many seconds."""
    return [s._replace(time_us=s.time_us + round(S * by_s(time_s))) for time_s, s in flight()]


ZERO, SENTINEL = (0.0, 0.0, 0.0), (3e34, 3e34, 3e34)


def held(*names):
    """The first reading again and again."""
    return lambda samples: [
        each._replace(**{name: getattr(samples[0], name) for name in names}) for each in samples
    ]


def every(number, change):
    """``change(k, sample)`` in the place of every so manieth sample."""
    return lambda samples: [
        each if k % number else change(k, each) for k, each in enumerate(samples)
    ]


def put(number, **readings):
    return every(number, lambda _, s: s._replace(**readings))


def spiking(_, s):
    return s._replace(gyr_rad_s=(s.gyr_rad_s[0] + 25.0, *s.gyr_rad_s[1:]))


BOTH = "gyr_rad_s", "acc_m_s2"
FAULTS = {
    "stuck": (held(*BOTH), {"repeated", "stuck"}),
    "stuck gyroscope": (held(BOTH[0]), {"repeated", "gyroscope_stuck"}),
    "stuck accelerometer": (held(BOTH[1]), {"accelerometer_stuck"}),
    "stuck field": (held("mag_gauss"), {"magnetometer_stuck"}),
    "saturated": (
        every(1, lambda _, s: s._replace(gyr_rad_s=(34.9, *s.gyr_rad_s[1:]))),
        {"gyroscope_saturated", "gyroscope_spike"},
    ),
    "clipped": (
        every(1, lambda _, s: s._replace(acc_m_s2=(*s.acc_m_s2[:2], -156.9))),
        {"accelerometer_saturated"},
    ),
    "zero": (put(5, acc_m_s2=ZERO), {"zero_accelerometer"}),
    "spikes": (every(30, spiking), {"gyroscope_spike"}),
    "sentinels": (put(2, mag_gauss=SENTINEL), {"magnetometer_out_of_range"}),
    "duplicated": (lambda samples: [s for s in samples for _ in range(2)], {"duplicate"}),
}


@pytest.mark.parametrize("name", FAULTS)
@pytest.mark.parametrize("kind", WRITERS)
def test_a_sensors_fault_is_refused_and_the_attitude_holds_after_it(kind, name, tmp_path):
    (fault, expected), before, during, after = FAULTS[name], [], [], []
    for time_s, sample in flight():
        (before if time_s < BEGIN_S else during if time_s < END_S else after).append(sample)
    path = WRITERS[kind]([*before, *fault(during), *after], tmp_path)
    _, report = report_log(path, load_profile("paper"), skip_s=END_S + 3.0)
    assert set(report.rejected) == expected
    assert report.error_deg.total_rms < HOLDS_DEG


@pytest.mark.parametrize("step_s", [40.0, 3000.0])
@pytest.mark.parametrize("kind", WRITERS)
def test_a_leap_of_the_clock_is_cut_out(kind, step_s, tmp_path):
    path = WRITERS[kind](shifted(lambda time_s: step_s * (time_s >= BEGIN_S)), tmp_path)
    # a log that knows no arrivals knows no short leap from a hole
    resets = 1 if kind == "tlog" or step_s > 600 else 0
    assert len(of(ClockReset, open_log(path))) == resets
    _, report = report_log(path, load_profile("paper"), skip_s=BEGIN_S + 5.0)
    assert report.error_deg.total_rms < HOLDS_DEG


@pytest.mark.parametrize("back_s", [0.5, 3.0, 3600.0, 1.7e9])
@pytest.mark.parametrize("kind", ["dataflash", "ulog", "csv", "mcap"])
def test_a_clock_that_is_set_back_is_a_reset_reported_once(kind, back_s, tmp_path, capsys):
    """By a person, by NTP, or to 1970; a log that counts from the boot may not go below zero."""
    begin_s = 2.0 * back_s + 20.0 if kind in ("dataflash", "ulog") else 0.0
    if begin_s > 1e5:
        pytest.skip("no vehicle runs for years")
    samples = shifted(lambda time_s: begin_s - back_s * (time_s >= BEGIN_S))
    path = ALL_WRITERS[kind](samples, tmp_path)
    assert main(["replay", str(path), "--profile", "paper", "--json"]) == 0
    output = capsys.readouterr()
    report = json.loads(output.out)
    assert report["imu"]["samples"] >= len(samples) - 2
    assert sum(report["rejected"].values()) <= 2
    assert output.err.count("aligning anew") == 1


@pytest.mark.parametrize("kind", ALL_WRITERS)
def test_a_log_of_which_much_is_refused_is_reported(kind, tmp_path, capsys):
    path = ALL_WRITERS[kind](put(4, acc_m_s2=ZERO)([s for _, s in flight()]), tmp_path)
    what = "much was refused: 300 x zero_accelerometer; 900 samples were used"
    for verb, name in (("replay", path.name), ("check", f"fuzzbee: {path}")):
        assert main([verb, str(path), "--profile", "paper", "--json"]) == 0
        (line,) = [line for line in capsys.readouterr().err.splitlines() if "refused" in line]
        assert line == f"{name}: {what}"


@pytest.mark.parametrize("keep", [1, 5])  # of the samples: 50 and 10 Hz
@pytest.mark.parametrize("first_s", [0.5, 0.8, 1.1, BEGIN_S])
@pytest.mark.parametrize("is_still", [False, True])
@pytest.mark.parametrize("kind", ["tlog", "dataflash"])  # PX4 begins a new log
def test_a_vehicle_that_boots_again_loses_nothing(kind, is_still, first_s, keep, tmp_path):
    """Also where its clock falls back by less than links reorder; a simulator's may repeat it."""
    still = {"gyr_rad_s": ZERO, "acc_m_s2": (0.0, 0.0, -9.8)} if is_still else {}
    samples = [
        s._replace(time_us=round(S * (time_s + 0.2 - first_s * (time_s >= first_s))), **still)
        for k, (time_s, s) in enumerate(flight())
        if k % keep == 0
    ]
    options = [lambda k: UNIX + round(k * keep * S / RATE_HZ)] if kind == "tlog" else []
    resets, times_us, refused = read(WRITERS[kind](samples, tmp_path, *options))
    assert [reset.reason for reset in resets] == ["reboot"]
    assert (len(times_us), refused) == (len(samples), {})
    assert min(gaps_s(times_us)) > 0


def twice(samples):
    """A block that a logger has written once more."""
    return [*samples[:600], *samples[570:]]


def early(samples):
    """Some come too early, by three places; the clock was not set back for those behind."""
    for k in range(400, 600, 10):
        samples.insert(k, samples.pop(k + 3))
    return samples


def leaping_at_the_end(samples):
    """And the truth that comes with the last one."""
    return [*samples[:-1], samples[-1]._replace(time_us=samples[-1].time_us + 3000 * S)]


ORDERS = {
    "twice": (twice, ("dataflash", "ulog", "csv", "mcap"), {"duplicate": 30}),
    "early": (early, ("tlog", "dataflash", "csv"), {"out_of_order": 60}),
    "put in order": (early, ("ulog",), {}),
    "leaping at the end": (leaping_at_the_end, ("tlog", "csv"), {"clock_step": 1}),
}
CASES = [(name, kind) for name, (_, kinds, _) in ORDERS.items() for kind in kinds]


@pytest.mark.parametrize(("name", "kind"), CASES)
def test_samples_in_another_order_are_counted_or_put_in_order(name, kind, tmp_path):
    order, _, refused = ORDERS[name]
    samples = order([sample for _, sample in flight()])
    resets, times_us, found = read(ALL_WRITERS[kind](samples, tmp_path))
    assert (resets, found) == ([], refused)
    assert len(times_us) == len(samples) - sum(refused.values())


@pytest.mark.parametrize("kind", ["tlog", "mcap"])
@pytest.mark.parametrize("step_s", [-1.9, -1.2, -0.8, -0.3, -0.06, 0.8, 1.9, 3.5])
def test_a_short_leap_beside_steady_arrivals_costs_nothing(step_s, kind, tmp_path):
    """There and back again, and nothing is aligned anew."""
    samples = shifted(lambda time_s: 100 + step_s * (BEGIN_S <= time_s < END_S))
    path = tlog(samples, tmp_path) if kind == "tlog" else mcap(samples, tmp_path, received_ns)
    resets, times_us, _ = read(path)
    assert [(each.reason, each.goes_on) for each in resets] == [("jump", True)] * 2
    assert len(times_us) == len(samples)
    assert max(gaps_s(times_us)) < 0.1
    assert times_us[-1] - times_us[0] == pytest.approx((LAST_S - 1 / RATE_HZ) * S, abs=0.1 * S)


def received_ns(k):
    """When a recorder gets the rows of a flight: up to 1 ms late."""
    return round(1e9 * (1.7e9 + k / RATE_HZ)) + 1_000_000 * (k % 7) // 7


# of a row: what it becomes, and the word that it, or a part of it, is counted under
DAMAGES = [
    (lambda s: s, None),
    (lambda s: s._replace(mag_gauss=SENTINEL), "magnetometer_out_of_range"),
    (lambda s: s._replace(mag_gauss=(10.0, *s.mag_gauss[1:])), "magnetometer_out_of_range"),
    (lambda s: s._replace(mag_gauss=ZERO), None),
    (lambda s: s._replace(acc_m_s2=ZERO), "zero_accelerometer"),
    (lambda s: s._replace(acc_m_s2=(0.0, 0.0, -401.0)), "accelerometer_out_of_range"),
    (lambda s: s._replace(acc_m_s2=SENTINEL), "accelerometer_out_of_range"),
    (lambda s: s._replace(gyr_rad_s=(71.0, 0.0, 0.0)), "gyroscope_out_of_range"),
    (lambda s: s._replace(gyr_rad_s=SENTINEL), "gyroscope_out_of_range"),
    (lambda s: s._replace(acc_m_s2=(math.inf, 0.0, -9.8)), "not_finite"),
    (lambda s: s._replace(acc_m_s2=(math.nan, 0.0, -9.8)), "not_finite"),  # in a table it is empty
    (lambda s: s._replace(gyr_rad_s=(0.0, -math.inf, 0.0)), "not_finite"),
]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", ALL_WRITERS)
def test_no_row_is_lost_that_can_be_used_and_each_other_has_its_reason(kind, seed, tmp_path):
    """Any mixture, half of the rows as they are; counts add up."""
    rng, samples, expected = random.Random(seed), [], Counter()
    for _, sample in flight():
        change, reason = rng.choice(DAMAGES) if rng.random() < 0.5 else DAMAGES[0]
        if kind == "mcap" and reason == "not_finite":
            change, reason = DAMAGES[0]  # JSON has no such numbers
        samples.append(change(sample))
        expected[reason] += 1
    refused = {reason for reason in expected if reason and not reason.startswith("magnetometer")}
    _, times_us, found = read(ALL_WRITERS[kind](samples, tmp_path))
    assert len(times_us) == len(samples) - sum(expected[reason] for reason in refused)
    assert {reason: found[reason] for reason in refused} == {r: expected[r] for r in refused}
    # a field beside a row that is refused may not be looked at
    assert 0 < found["magnetometer_out_of_range"] <= expected["magnetometer_out_of_range"]
    assert found.keys() <= {*refused, "magnetometer_out_of_range"}
