"""What programs import: one call a sample and all samples at once are the same estimator."""

import copy
import dataclasses
import pickle
import warnings
from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise, product
from multiprocessing import get_context

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import fuzzbee
from estimator.aiding.phase import Phase
from estimator.estimator import Estimator as LiveEstimator
from estimator.live.core import with_attitude
from estimator.profile import merge_profile
from estimator.types import ImuSample, VelocitySample
from fuzzbee import Estimator, load_profile
from fuzzbee.array_estimator import Unfit
from fuzzbee.attitudes import Attitudes
from tests.fuzzbee.recording import FLIPS, recorded
from tests.programs import run_python

ROWS = 250  # 5 s
FIELDS = {field.name for field in dataclasses.fields(Attitudes)} - {"time_s", "warnings"}


@pytest.fixture(scope="module")
def flight():
    """Times, readings and velocities of a flight with flips; a field from the seventh row on."""
    time_s, gyr, acc, mag, velocity = (values[:ROWS].copy() for values in recorded(FLIPS)[:5])
    known = np.flatnonzero(mag.any(axis=1))
    latest = known[np.maximum(np.searchsorted(known, np.arange(ROWS), side="right") - 1, 0)]
    mag = mag[latest] + np.random.default_rng(3).normal(0.0, 0.002, (ROWS, 3))
    mag[:6] = 0.0
    return time_s, gyr, acc, mag, velocity


# Which column is damaged (of times, rates, forces, fields, velocities), and what its rows become:
# None is what the first of them was.
DAMAGES = {
    "lost field": (3, np.nan),
    "zero field": (3, 0.0),
    "repeated field": (3, None),
    "wild rate": (1, 1000.0),
    "no number": (2, np.inf),
    "time back": (0, None),
    "gap": (0, 0.1),
    "no velocity": (4, np.nan),
}


def spoil(columns, damage, rows):
    number, value = DAMAGES[damage]
    column = columns[number]
    if damage == "gap":
        column[rows.start :] += value * (rows.stop - rows.start)
    elif damage == "no velocity":
        column[rows.start :] = value
    else:
        column[rows] = column[rows.start] if value is None else value


def twice_damaged(test):
    """Each damage in three batches, with and without velocity, besides what is found at random."""
    for damage, has_velocity in product(DAMAGES, (False, True)):
        damages = [(damage, 30, 20), (damage, 120, 5)]
        given = {"damages": damages, "has_velocity": has_velocity, "cuts": [40, 200]}
        test = example(**given, calibrated=None)(test)
    return test


DAMAGE = st.tuples(st.sampled_from([*DAMAGES]), st.integers(0, ROWS - 1), st.integers(1, 60))


@twice_damaged
@settings(max_examples=10, deadline=None)
@given(
    damages=st.lists(DAMAGE, max_size=5),
    has_velocity=st.booleans(),
    cuts=st.lists(st.integers(0, ROWS), max_size=2).map(sorted),
    calibrated=st.sampled_from([None, False, True]),
)
def test_a_batch_equals_calls_to_the_last_digit(flight, damages, has_velocity, cuts, calibrated):
    """In batches that go on from each other at the cuts."""
    time_s, gyr, acc, mag, velocity = (values.copy() for values in flight)
    if not has_velocity:
        velocity[:] = np.nan
    for damage, begin, length in damages:
        rows = slice(begin, min(begin + length, ROWS))
        spoil((time_s, gyr, acc, mag, velocity), damage, rows)
    position = np.full((ROWS, 4), np.nan)
    position[60:180:7] = (-35.363, 149.165, 584.0, 1.72e9)
    position[130:180:7, 0] = 48.0  # far away
    calls, batches = (Estimator(compass_calibrated=calibrated) for _ in range(2))
    reported = []
    for k in range(ROWS):
        if np.isfinite(position[k]).all():
            calls.set_position(*position[k])
        if np.isfinite(velocity[k, :2]).all():
            calls.update_velocity(velocity[k], round(1e6 * time_s[k]) / 1e6)
        reported.append(calls.update(gyr[k], acc[k], mag[k], time_s[k]))
    edges, columns = (0, *cuts, ROWS), (gyr, acc, mag, time_s, velocity, position)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Unfit)  # damaged rows may look like other axes
        parts = [batches.update_batch(*(x[a:b] for x in columns)) for a, b in pairwise(edges)]
    assert batches.rejected == calls.rejected
    known = [k for k in range(ROWS) if reported[k] is not None]
    for name in FIELDS:
        found = np.concatenate([getattr(part, name) for part in parts])
        expected = np.array([getattr(reported[k], name) for k in known])
        assert np.array_equal(found[known], expected), name
    unknown = sorted(set(range(ROWS)) - set(known))
    assert np.isnan(np.concatenate([part.q_ned_frd for part in parts])[unknown]).all()


def test_a_batch_of_calls_that_nothing_disturbs_is_compiled_in_runs(flight, monkeypatch):
    """The first row, which aligns, and a bad one are calls; else a batch costs what calls cost."""
    time_s, gyr, acc, mag, _ = (values.copy() for values in flight)
    gyr[100] = np.nan
    estimator = Estimator()
    inner, taken = estimator._inner, []
    take = inner.take
    monkeypatch.setattr(inner, "take", lambda *sample: (taken.append(sample[0]), take(*sample))[1])
    estimator.update_batch(gyr, acc, mag, time_s)
    assert taken == [round(1e6 * time_s[k]) for k in (0, 100)]


def test_an_estimate_that_is_not_finite_begins_anew_in_a_batch_too(flight):
    time_s, gyr, acc, mag, _ = flight
    batch, calls = Estimator(), Estimator()
    for estimator in (batch, calls):
        estimator.update_batch(gyr[:50], acc[:50], mag[:50], time_s[:50])
        inner = estimator._inner
        poisoned = with_attitude(inner.snapshot.core, (np.nan,) * 4)
        inner.snapshot = inner.snapshot._replace(core=poisoned)
    found = batch.update_batch(gyr[50:60], acc[50:60], mag[50:60], time_s[50:60])
    reported = [calls.update(gyr[k], acc[k], mag[k], time_s[k]) for k in range(50, 60)]
    assert reported[0] is None
    assert np.isnan([*found.q_ned_frd[0], *found.rate_rad_s[0], found.gain[0]]).all()
    expected = [attitude.q_ned_frd for attitude in reported[1:]]
    assert [tuple(q) for q in found.q_ned_frd[1:]] == expected
    assert batch.rejected == calls.rejected == {"estimate_not_finite": 1}


def test_a_velocity_is_handed_on_as_it_is_at_the_last_samples_time():
    """Beside the live estimator, which is given reports of its own kind; without a time, too."""
    ours, live = Estimator("imu"), LiveEstimator(load_profile("imu"))
    for t, w, f, m, v in zip(*recorded(FLIPS)[:5], strict=True):
        time_us, has_mag = round(1e6 * t), bool(np.any(m))
        attitude = ours.update(w, f, m if has_mag else None, t)
        live.update(ImuSample(time_us, tuple(w), tuple(f), tuple(m), has_mag))
        expected = live.attitude(time_us)
        if np.isfinite(v[:2]).all():
            velocity = (v[0] + 0.3, v[1] - 0.2, v[2])
            ours.update_velocity(velocity, sigma_m_s=0.4)
            live.update_report(VelocitySample(time_us, velocity, True, 0.4))
    assert live.snapshot.context.phase is Phase.AIDED
    assert attitude.q_ned_frd == pytest.approx(expected.q_ned_frd, abs=1e-12)


def from_its_state(estimator):
    made = Estimator()
    made.state = pickle.loads(pickle.dumps(estimator.state))
    return made


@pytest.mark.parametrize(
    "way",
    [Estimator.copy, copy.copy, copy.deepcopy, from_its_state,
     lambda e: pickle.loads(pickle.dumps(e))],
)  # fmt: skip
@pytest.mark.parametrize("has_velocity", [False, True])
def test_a_copy_goes_on_as_the_first_does_and_leaves_it_alone(flight, way, has_velocity):
    time_s, gyr, acc, mag, velocity = flight
    readings = (gyr, acc, mag, time_s, velocity if has_velocity else None)
    first, begun = Estimator(), slice(None, 120)
    first.set_position(-35.363, 149.165, 584.0, unix_s=1.72e9)
    first.update_batch(*(each if each is None else each[begun] for each in readings))
    first.update(gyr[0], acc[0], time_s=time_s[0])  # which is refused
    then = [each if each is None else each[120:] for each in readings]
    second = way(first)
    assert second.rejected == {"not_later": 1}
    wanted, found = second.update_batch(*then), first.update_batch(*then)
    for name in FIELDS:
        assert np.array_equal(getattr(wanted, name), getattr(found, name)), name


def test_after_a_reset_it_is_a_new_one(flight):
    time_s, gyr, acc, mag, velocity = flight
    estimator = Estimator()
    first = estimator.update_batch(gyr, acc, mag, time_s, velocity)
    estimator.reset()
    again = estimator.update_batch(gyr, acc, mag, time_s, velocity)
    assert np.array_equal(first.q_ned_frd, again.q_ned_frd, equal_nan=True)
    assert not estimator.rejected


def test_a_pickled_estimator_goes_on_in_another_process(flight):
    """Which has never seen this estimator."""
    readings, estimator = [flight[k] for k in (1, 2, 3, 0)], Estimator()
    estimator.update_batch(*(each[:120] for each in readings))
    then = [each[120:] for each in readings]
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        elsewhere = pool.submit(Estimator.update_batch, estimator, *then).result()
    assert np.array_equal(elsewhere.q_ned_frd, estimator.update_batch(*then).q_ned_frd)


# --- arrays in, attitudes out

LEVEL = ((0.0, 0.0, 0.0), (0.0, 0.0, -9.8), (0.2, 0.0, 0.4))


def turning_level(n, rate_hz, rate_rad_s=0.5):
    """A level vehicle that turns right from north: readings (n, 3) without any noise."""
    yaw = rate_rad_s * np.arange(n) / rate_hz
    gyr = np.tile((0.0, 0.0, rate_rad_s), (n, 1))
    mag = np.stack([0.2 * np.cos(yaw), -0.2 * np.sin(yaw), np.full(n, 0.4)], axis=1)
    return gyr, np.tile((0.0, 0.0, -9.8), (n, 1)), mag, np.degrees(yaw) % 360.0


def test_every_name_is_there_and_no_other_and_no_command_hides_the_function_replay():
    assert all(getattr(fuzzbee, name) is not None for name in fuzzbee.__all__)
    with pytest.raises(AttributeError, match="nonsense"):
        _ = fuzzbee.nonsense
    code = "import fuzzbee.app; from fuzzbee import replay; assert callable(replay)"
    run_python("-c", code, timeout_s=900)


def test_a_turn_to_the_right_is_a_growing_heading():
    gyr, acc, mag, yaw_deg = turning_level(500, 100.0)
    attitudes = Estimator(rate_hz=100.0).update_batch(gyr, acc, mag)
    roll, pitch, heading = attitudes.euler_deg.T
    assert np.abs([roll, pitch]).max() < 1e-3
    # The field's lag is not known yet: half a degree is 17 ms at this rate
    assert np.abs((heading - yaw_deg + 180.0) % 360.0 - 180.0).max() < 0.5
    assert attitudes.time_s == pytest.approx(np.arange(500) / 100.0)
    # to the right is clockwise: seen from above in ENU it is a falling angle, from 90 deg on
    w, x, y, z = attitudes.q_enu_flu.T
    angle_deg = np.degrees(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
    assert angle_deg == pytest.approx((90.0 - heading + 180.0) % 360.0 - 180.0, abs=1e-6)


def test_before_the_first_sample_that_can_be_used_there_is_no_attitude():
    gyr, acc, mag, _ = turning_level(4, 100.0)
    acc[0] = np.nan
    estimator = Estimator(rate_hz=100.0)
    attitudes = estimator.update_batch(gyr, acc, mag)
    for values in (attitudes.q_ned_frd, attitudes.euler_deg, attitudes.q_enu_flu):
        assert np.isnan(values[0]).all()
        assert np.isfinite(values[1:]).all()
    assert estimator.rejected == {"not_finite": 1}
    assert Estimator().update((np.nan,) * 3, LEVEL[1], time_s=0.0) is None
    estimator.reset()
    estimator.update_velocity((0.0, 0.0, 0.0))  # of no sample yet: nothing to report
    assert [estimator.update(*LEVEL).time_us for _ in range(3)] == [0, 10_000, 20_000]
    assert not estimator.rejected
    assert estimator.update(*LEVEL, time_s=0.0).q_ned_frd == pytest.approx((1.0, 0.0, 0.0, 0.0))
    assert estimator.rejected == {"not_later": 1}


def test_the_mounting_of_a_profile_is_used():
    """An IMU that is turned right by 90 deg: its x axis is the body's y axis."""
    mounting = {"mounting": {"rotation_deg": (0.0, 0.0, 90.0)}}
    turned = Estimator(merge_profile(load_profile("imu"), mounting), rate_hz=100.0)
    gyr, acc, mag, _ = turning_level(50, 100.0)
    seen = [np.stack([v[:, 1], -v[:, 0], v[:, 2]], axis=1) for v in (gyr, acc, mag)]
    straight = Estimator(rate_hz=100.0).update_batch(gyr, acc, mag)
    # to rounding: the quaternions are of order 1
    assert turned.update_batch(*seen).q_ned_frd == pytest.approx(straight.q_ned_frd, abs=1e-12)
