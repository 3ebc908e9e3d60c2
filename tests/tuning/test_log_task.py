"""Tuning on recorded flights: segments, weights, and costs equal to the estimator's own run."""

from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pytest

from drivers.simulation.simulated_vehicle import simulate
from estimator.errors import InputError
from estimator.estimator import Estimator
from estimator.filter.kernel import correct
from estimator.filter.types import initial_state
from estimator.geometry.metrics import angle_errors
from estimator.geometry.quaternion import normalized_distance
from estimator.live.conditioned import conditioned_vectors
from estimator.live.settings import settings_of
from estimator.profile import load_profile, merge_profile
from estimator.types import ImuSample
from tuning.log_dataset import LogData, motion_s, read_log
from tuning.log_task import LogTask, _kernel_data, default_groups
from tuning.objective import profile_with, values_of
from tuning.segments import SEGMENT_S, SETTLE_S, Segment, segments, split, weights
from tuning.space import decode, random_positions

DATA = Path(__file__).resolve().parents[1] / "data"
SLOW_LOG = DATA / "sitl_copter_4hz.tlog"


def flight(rate_hz=50.0, duration_s=80.0, seed=3, **changes):
    """The simulated vehicle as a log; its field points as the profile's learnt north does not.

    The paper's magnetic vector has a heading of -45 deg: the declination that
    makes the learnt north agree with the truth.
    """
    n = int(rate_hz * duration_s)
    flown = simulate(seed, n, rate_hz, noise=0.3, bias=0.1)
    data = LogData(
        name="flight",
        sha256="0" * 64,
        message="RAW_IMU",
        rate_hz=rate_hz,
        reference="sim",
        declination_rad=-np.pi / 4,
        time_s=np.arange(n) / rate_hz,
        restart=np.arange(n) == 0,
        gyr_rad_s=flown.gyr_rad_s,
        acc_m_s2=flown.acc_m_s2,
        mag_gauss=flown.mag_gauss,
        has_mag=np.ones(n, dtype=bool),
        truth=flown.q_ned_frd,
        known=np.ones(n, dtype=bool),
    )
    return data._replace(**changes)


def candidates(task, count):
    return decode(task.space, random_positions(task.space, count, np.random.default_rng(1)))


def imu(gain="fuzzy"):
    return merge_profile(load_profile("imu"), {"filter": {"gain": gain}})


def test_segments_follow_each_other_after_the_settling():
    data = flight()
    found = segments(data)
    assert data.time_s[found[0].first] == pytest.approx(SETTLE_S)
    for segment, following in pairwise(found):
        assert following.first == segment.last + 1
    for first, last in found:
        assert data.time_s[last] - data.time_s[first] == pytest.approx(SEGMENT_S)
    assert len(found) == 4  # of 701 samples each, in 70 s


def test_no_segment_crosses_a_restart_or_a_silence():
    data = flight()
    restart = data.restart.copy()
    restart[1200] = True
    time_s = data.time_s.copy()
    time_s[3000:] += 5.0
    found = segments(data._replace(restart=restart, time_s=time_s))
    for first, last in found:
        assert not restart[first + 1 : last + 1].any()
        assert np.diff(time_s[first : last + 1]).max() < 1.0
    assert found
    begun = time_s[1200] + SETTLE_S
    assert any(time_s[s.first] == pytest.approx(begun) for s in found)


def test_a_segment_needs_its_reference():
    data = flight()
    known = data.known.copy()
    known[700:900] = False
    without = segments(data._replace(known=known))
    assert len(without) == len(segments(data)) - 1


def test_split_keeps_a_third_out_and_of_two_one():
    nine = [Segment(i, i) for i in range(9)]
    tuning, held_out = split(nine)
    assert len(held_out) == 3
    assert sorted(tuning + held_out) == nine
    assert [len(part) for part in split(nine[:2])] == [1, 1]


@pytest.mark.parametrize("rate_hz", [2.0, 4.0, 50.0, 100.0])
def test_weights_sum_to_the_papers_at_any_rate(rate_hz):
    """0.3 x 101 samples of the first second and 1001 of 4..14 s."""
    data = flight(rate_hz=rate_hz)
    segment = segments(data)[0]
    w = weights(data, segment)
    t = data.time_s[segment.first : segment.last + 1] - data.time_s[segment.first]
    assert w.sum() == pytest.approx(0.3 * 101 + 1001)
    assert w[t < 1.0 + 1e-9].sum() == pytest.approx(0.3 * 101)
    assert (w[(t > 1.01) & (t < 3.99)] == 0.0).all()


def plain_cost(profile, data, chosen):
    """The same cost by the live estimator, sample by sample, set wrong where a segment starts."""
    estimator = Estimator(profile)
    settings = settings_of(profile)
    steps = _kernel_data(profile, data, chosen, len(chosen))
    starts = {s.first for s in chosen}
    total = 0.0
    for i, time_s in enumerate(data.time_s):
        sample = ImuSample(
            round(1e6 * time_s),
            *(tuple(a[i].tolist()) for a in (data.gyr_rad_s, data.acc_m_s2, data.mag_gauss)),
            bool(data.has_mag[i]),
        )
        assert estimator.update(sample) is None
        if i in starts:
            now = estimator.snapshot
            wrong = initial_state(tuple(steps.start[i].tolist()))
            vectors = conditioned_vectors(settings.reference, now.core.seen)
            state = correct(settings.filter, wrong, vectors, 0.0)
            estimator.snapshot = now._replace(core=now.core._replace(filter=state))
        q = estimator.snapshot.core.filter.q_ned_frd
        if steps.weight[i] > 0.0:
            total += steps.weight[i] * normalized_distance(tuple(data.truth[i].tolist()), q)
    return total


@pytest.mark.parametrize("gain", ["fuzzy", "fixed", "noise"])
def test_cost_is_that_of_the_live_estimator(gain):
    """The search's kernel takes the estimator's own steps, whatever sets the gain."""
    data = flight(duration_s=40.0)
    declination_deg = float(np.degrees(data.declination_rad))
    base = imu(gain)
    reference = msgspec.structs.replace(base.reference, declination_deg=declination_deg)
    base = msgspec.structs.replace(base, reference=reference)
    task = LogTask(base, ("confidence",), (data,))
    tuning, held_out = split(segments(data))
    score = task.score(base)
    assert score.tuning == pytest.approx(plain_cost(base, data, tuning), rel=1e-9)
    assert score.held_out == pytest.approx(plain_cost(base, data, held_out), rel=1e-9)


def test_shared_vectors_give_the_cost_of_the_whole_chain():
    task = LogTask(imu(), ("membership", "confidence"), (flight(),))
    assert task.objective.prepared is not None
    for values in candidates(task, 5):
        profile = profile_with(task.space, task.base, values)
        whole = LogTask(profile, ("conditioning",), (flight(),))
        own = values_of(whole.space, profile)[None, :]
        assert whole.objective.prepared is None
        np.testing.assert_allclose(
            task.objective.costs(values[None, :]), whole.objective.costs(own), rtol=1e-9
        )


def test_score_is_the_searched_cost():
    for groups in (("membership", "filter"), ("confidence", "conditioning")):
        task = LogTask(imu(), groups, (flight(),))
        for values in candidates(task, 3):
            profile = profile_with(task.space, task.base, values)
            searched = task.objective.costs(values[None, :])[0]
            assert task.score(profile).tuning == pytest.approx(searched, rel=1e-9)


@pytest.mark.parametrize("groups", [("membership",), ("confidence", "conditioning")])
def test_costs_are_the_same_bits_for_any_batch(groups):
    task = LogTask(imu(), groups, (flight(duration_s=45.0),))
    values = candidates(task, 7)
    together = task.objective.costs(values)
    assert np.array_equal(together, task.objective.serial_costs(values))
    assert np.array_equal(together[3:4], task.objective.costs(values[3:4]))
    assert np.ptp(together) > 0.0


def test_two_logs_count_by_their_segments():
    one, two = flight(seed=3), flight(seed=4, duration_s=60.0)
    both = LogTask(imu(), ("membership",), (one, two))
    base = imu()
    costs = [LogTask(base, ("membership",), (log,)) for log in (one, two)]
    counts = [task.segment_counts()[0] for task in costs]
    each = [task.score(base).tuning for task in costs]
    assert both.score(base).tuning == pytest.approx(np.average(each, weights=counts), rel=1e-9)


def test_without_a_field_only_the_inclination_counts():
    """A truth turned about the vertical costs nothing then."""
    data = flight(rate_hz=20.0)
    none = data._replace(has_mag=np.zeros(len(data.time_s), dtype=bool))
    half = np.sqrt(0.5)
    w, x, y, z = data.truth.T
    quarter = np.stack([half * (w - z), half * (x - y), half * (y + x), half * (z + w)], axis=1)
    off = angle_errors(tuple(quarter[0].tolist()), tuple(data.truth[0].tolist()))
    assert off.heading_rad == pytest.approx(np.pi / 2)
    assert off.inclination_rad == pytest.approx(0.0, abs=1e-7)
    task, turned = (
        LogTask(imu(), ("membership",), (log,)) for log in (none, none._replace(truth=quarter))
    )
    # only the wrong starts differ, and they are as wrong about level axes for most headings
    steady = task.score(task.base).tuning
    assert turned.score(task.base).tuning == pytest.approx(steady, rel=0.2)
    with_field = LogTask(imu(), ("membership",), (data._replace(truth=quarter),))
    assert with_field.score(task.base).tuning > 300.0  # e = 0.5 over 1001 samples and more


def test_a_log_without_reference_is_tuned_on_its_own_vectors():
    """Without noise and bias an honest gyroscope predicts its vectors; a wrong one does not."""
    n = 20 * 80
    flown = simulate(1, n, 20.0, noise=0.0, bias=0.0)
    blind = flight(
        rate_hz=20.0,
        reference="none",
        known=np.zeros(n, dtype=bool),
        gyr_rad_s=flown.gyr_rad_s,
        acc_m_s2=flown.acc_m_s2,
        mag_gauss=flown.mag_gauss,
    )
    task = LogTask(imu(), default_groups(20.0), (blind,))
    good = task.score(task.base).tuning
    assert np.isfinite(good)
    wrong = blind._replace(gyr_rad_s=-blind.gyr_rad_s)
    bad = LogTask(imu(), default_groups(20.0), (wrong,)).score(task.base).tuning
    assert bad > 3.0 * good


def test_needs_two_segments():
    task = LogTask(imu(), ("membership",), (flight(duration_s=30.0),))
    with pytest.raises(InputError, match="at least two stretches"):
        _ = task.objective


def test_needs_conditioning():
    task = LogTask(load_profile("paper"), ("membership",), (flight(),))
    with pytest.raises(InputError, match=r"conditioning\.enabled"):
        _ = task.objective


def test_memberships_that_set_no_gain_are_not_tuned():
    task = LogTask(imu("fixed"), ("membership",), (flight(),))
    with pytest.raises(InputError, match=r"filter\.gain is 'fixed'"):
        _ = task.objective


def test_groups_by_rate():
    assert default_groups(50.0) == ("membership",)
    assert default_groups(9.9) == ("confidence", "conditioning")


def test_reads_a_log_with_the_truth_of_a_simulation():
    data = read_log(SLOW_LOG)
    assert data.reference == "sim"
    assert data.message == "RAW_IMU"
    assert data.rate_hz == pytest.approx(4.0, abs=0.2)
    assert data.known.mean() > 0.95
    assert data.restart[0]
    assert (np.diff(data.time_s) > 0.0).all()
    assert data.has_field
    assert motion_s(data) > 30.0
    assert len(data.sha256) == 64


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("sub_on_its_side.tlog", "at least 60 s"),
        ("sitl_copter_flips.tlog", "at least 60 s"),
        ("copter_reboot.tlog", "no motion"),
        ("no_such.tlog", "no such file"),
    ],
)
def test_refuses_a_log_that_tells_nothing(name, told):
    with pytest.raises(InputError, match=told) as error:
        read_log(DATA / name)
    assert name in str(error.value)
    assert "\n" not in str(error.value)
