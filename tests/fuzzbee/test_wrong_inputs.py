"""A hundred wrong inputs: one clear line each, or counted, or warned of; never anything else."""

from math import inf, nan, radians

import numpy as np
import pytest

from fuzzbee import Estimator, InputError, PaperFilter, load_profile, replay
from tests.fuzzbee.recording import FLIPS

N = 200
GYR = np.zeros((N, 3))
ACC = np.tile([0.0, 0.0, -9.8], (N, 1))
MAG = np.tile([0.2, 0.0, 0.4], (N, 1))
TIME = np.arange(N) / 100.0
UP = (0.0, 0.0, -9.8)
BIG = 10**400
DATES = np.zeros((N, 3), "M8[s]")
FIELDS = [("x", float), ("y", float), ("z", float)]
NOWHERE = np.full((N, 4), 91.0)
MIXED = np.random.default_rng(0).permutation(TIME)

NO_ROWS = [
    None, "abc", {"x": 1}, GYR[0], GYR.T, GYR[None], [], GYR[:, :2], GYR[:-1],
    [[0, 0, 0]] * N + [[0]],
    [["a", "b", "c"]] * N, [["0", "0", "0"]] * N, GYR + 1j, DATES, DATES - DATES, GYR.astype(bytes),
    np.zeros(N, FIELDS), (row for row in GYR), [[BIG, 0, 0]] * N, [[None, object(), 0]] * N, 1.0,
]  # fmt: skip
NO_TIMES = [
    "now", ["a"] * N, TIME[:, None], TIME[:-1], 0.1, {"a": 1}, [[1], [1, 2]], [None] * N, TIME + 1j,
    TIME * nan, TIME + inf, TIME + 1.7e18, TIME.astype("M8[s]"), [BIG] * N, [],
    np.ma.masked_array(TIME, mask=TIME > 1.0),
]  # fmt: skip
NO_VECTORS = [
    None, "abc", "123", b"abc", 1.0, (0, 0), (0, 0, 0, 0), np.zeros((1, 3)), np.zeros((3, 1)),
    {1, 2, 3}, {1: 1, 2: 2, 3: 3},
    (1j, 0, 0), (BIG, 0, 0), (None, 0, 0), ("a", 0, 0), [[0], [0, 1], 0],
]  # fmt: skip
NO_NUMBERS = [
    nan, inf, -inf, "x", "100", b"1", True, [1, 2], {}, 1j, BIG, np.array([1.0, 2.0]),
    np.datetime64(0, "s"),
]  # fmt: skip


def batch(**changed):
    """All but what is changed is sound."""
    given = {"gyr_rad_s": GYR, "acc_m_s2": ACC, "mag_gauss": MAG} | changed
    estimator = Estimator(rate_hz=100.0)
    return estimator, estimator.update_batch(**given)


def refuse(call, *names):
    """It raises one line that names one of these, and NumPy warns of nothing."""
    with pytest.raises(InputError) as caught:
        call()
    output = str(caught.value)
    assert "\n" not in output
    assert len(output) < 160
    assert any(name in output for name in names), output


def shown(values):
    return [f"{number}: {' '.join(repr(each).split()):.25}" for number, each in enumerate(values)]


@pytest.mark.parametrize("given", NO_ROWS, ids=shown(NO_ROWS))
def test_rows_that_are_none(given):
    refuse(lambda: batch(acc_m_s2=given), "acc_m_s2")


@pytest.mark.parametrize("name", ["gyr_rad_s", "mag_gauss", "velocity_ned_m_s"])
def test_rows_of_any_other_reading(name):
    for given in ("abc", GYR[:, :2], GYR + 1j):
        refuse(lambda given=given: batch(**{name: given}), name)


@pytest.mark.parametrize("given", NO_TIMES, ids=shown(NO_TIMES))
def test_times_that_are_none(given):
    estimator = Estimator()
    refuse(lambda: estimator.update_batch(GYR, ACC, MAG, given), "time_s")
    assert estimator.update((0, 0, 0), UP, time_s=0.0).q_ned_frd[0] == 1.0  # nothing was taken


@pytest.mark.parametrize("given", NO_VECTORS, ids=shown(NO_VECTORS))
def test_vectors_that_are_none(given):
    estimator = Estimator(rate_hz=100.0)
    refuse(lambda: estimator.update(given, UP), "gyr_rad_s")
    refuse(lambda: estimator.update_velocity(given), "velocity_ned_m_s")


@pytest.mark.parametrize("given", NO_NUMBERS, ids=shown(NO_NUMBERS))
def test_numbers_that_are_none(given):
    estimator = Estimator(rate_hz=100.0)
    refuse(lambda: estimator.update((0, 0, 0), UP, time_s=given), "time_s")
    refuse(lambda: estimator.update_velocity((1, 2, 3), sigma_m_s=given), "sigma_m_s")
    refuse(lambda: estimator.update_velocity((1, 2, 3), time_s=given), "time_s")
    for place, name in enumerate(("latitude_deg", "longitude_deg", "altitude_m", "unix_s")):
        values = [0.0, 0.0, 0.0, 1.7e9]
        values[place] = given
        refuse(lambda values=values: estimator.set_position(*values), name)
    refuse(lambda: Estimator(rate_hz=given), "rate_hz")
    refuse(lambda: Estimator(gain=given), "gain")


@pytest.mark.parametrize(
    ("call", "name"),
    [
        *((lambda hz=hz: Estimator(rate_hz=hz), "rate_hz") for hz in (0.0, -1.0, 1e-300)),
        (lambda: Estimator(gain=-1.0), "gain -1.0: must be a number, 0.01 to 10000"),
        (lambda: Estimator(gain=1e300), "gain 1e+300: must be a number, 0.01 to 10000"),
        *((lambda given=given: Estimator(given), "profile") for given in (3, None, {}, "no such")),
        (lambda: load_profile(7.5), "profile"),
        (lambda: PaperFilter(np.eye(3), profile=3), "profile"),
        *(
            (lambda given=given: PaperFilter(np.eye(3), R_hat=given), "R_hat")
            for given in (np.ones((3, 3)), np.diag((1.0, 1.0, -1.0)), np.eye(3) * nan)
        ),
        (lambda: replay(None), "log None"),
        (lambda: replay("nowhere.tlog"), "nowhere"),
        (lambda: replay(FLIPS, 3), "profile"),
        (lambda: replay(FLIPS, skip_s="x"), "skip_s"),
        (lambda: replay(FLIPS, skip_s=-1.0), "skip_s"),
        (lambda: replay(FLIPS, columns=7), "columns 7"),
        (lambda: setattr(Estimator(), "state", None), "state None"),
        (lambda: Estimator().update((0, 0, 0), UP), "rate_hz"),
        (lambda: Estimator().update_batch(GYR, ACC), "rate_hz"),
        (lambda: Estimator().update_velocity((1, 2, 3), sigma_m_s=-1.0), "sigma_m_s"),
        (lambda: Estimator(rate_hz=9).update_batch(GYR, ACC, position=GYR), "(200, 4)"),
        (lambda: Estimator(rate_hz=9).update_batch(GYR, ACC, position=NOWHERE), "position"),
        (lambda: Estimator().set_position(91.0, 0.0, 0.0, 0.0), "latitude_deg"),
        (lambda: Estimator().set_position(0.0, 999.0, 0.0, 0.0), "longitude_deg"),
    ],
)
def test_what_is_out_of_range(call, name):
    refuse(call, name)


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"gyr_rad_s": GYR * nan}, "not_finite"),
        ({"gyr_rad_s": GYR + inf}, "not_finite"),
        ({"acc_m_s2": ACC * nan}, "not_finite"),
        ({"acc_m_s2": np.ma.masked_array(ACC, mask=True)}, "not_finite"),
        ({"gyr_rad_s": GYR + 1e300}, "gyroscope_out_of_range"),
        ({"acc_m_s2": ACC * 1e300}, "accelerometer_out_of_range"),
        ({"time_s": TIME[::-1]}, "not_later"),
        ({"time_s": TIME * 0.0}, "not_later"),
        ({"time_s": MIXED}, "not_later"),
    ],
)
def test_what_cannot_be_used_is_counted_and_warned_of(changed, reason):
    with pytest.warns(UserWarning, match=f"most of the samples could not be used: .* {reason}$"):
        estimator, attitudes = batch(**changed)
    assert estimator.rejected[reason] > 0.9 * N
    assert any(reason in line for line in attitudes.warnings)


@pytest.mark.parametrize("scale", [0.0, 1e-300])
def test_an_accelerometer_that_reads_nothing_has_a_large_sigma(scale):
    _, attitudes = batch(acc_m_s2=ACC * scale)
    assert attitudes.sigma_inclination_rad[-1] > radians(30.0)


def test_a_field_beyond_any_is_counted():
    estimator, _ = batch(mag_gauss=MAG * 1e300)
    assert estimator.rejected


@pytest.mark.parametrize(
    "way",
    [
        list, tuple, np.asfortranarray, lambda rows: rows.astype(">f8"),
        lambda rows: rows.astype(object), lambda rows: np.broadcast_to(rows[0], rows.shape),
        lambda rows: np.repeat(rows, 2, axis=1)[:, ::2], np.ma.asarray, lambda rows: rows.tolist(),
    ],
)  # fmt: skip
def test_any_array_of_the_same_numbers_is_the_same(way):
    rows = {"gyr_rad_s": way(GYR), "acc_m_s2": way(ACC), "mag_gauss": way(MAG)}
    _, wanted = batch()
    estimator, attitudes = batch(**rows)
    assert np.array_equal(attitudes.q_ned_frd, wanted.q_ned_frd)
    assert not estimator.rejected
    assert not attitudes.warnings
