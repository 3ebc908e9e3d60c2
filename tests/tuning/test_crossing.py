"""What a search finds on one half of the flights makes the reference of the other half."""

from pathlib import Path

import numpy as np
import pytest

from estimator.profile import load_profile, merge_profile
from fuzzbee.tune.read_flight import read_flight
from tuning.crossing import cross, halves
from tuning.flight import Part
from tuning.log_task import LogTask, Split, split
from tuning.smoothed import smoothed_flight

LOG = Path(__file__).resolve().parents[1] / "data" / "sitl_copter_4hz.tlog"
IMU = load_profile("imu")
# Two profiles that a search may find; each smooths in its own way.
FOUND = [merge_profile(IMU, {"aiding": {"acc_noise": noise}}) for noise in (0.5, 0.2)]


@pytest.fixture(scope="module")
def flown():
    return read_flight(LOG, IMU)


@pytest.fixture(scope="module")
def smooth(flown):
    return smoothed_flight(flown, IMU)


def searched(task):
    """The crossed task, and the parts of each search on the way."""
    asked = []

    def search(half):
        asked.append(half.split.tuning)
        return FOUND[len(asked) - 1]

    return cross(task, search), asked


def test_the_halves_of_a_flight_are_smoothed_by_what_the_other_found(smooth):
    task = LogTask(IMU, ("noise",), split((smooth,)))
    crossed, asked = searched(task)
    (whole,) = task.split.tuning
    (earlier,), (later,) = asked
    assert (earlier.first, earlier.last, later.last) == (whole.first, later.first, whole.last)
    assert smooth.known[earlier.window].sum() == pytest.approx(
        smooth.known[later.window].sum(), abs=1
    )
    for part, half, by in zip(crossed.split.tuning, (earlier, later), FOUND[::-1], strict=True):
        assert part.window == half.window
        assert np.array_equal(part.flight.truth, smoothed_flight(smooth, by).truth, equal_nan=True)
        assert not np.array_equal(part.flight.truth, smooth.truth, equal_nan=True)
    assert crossed.split.held_out == task.split.held_out


def test_several_flights_are_taken_by_turns(smooth):
    names = [smooth._replace(name=name) for name in "abc"]
    one, other = halves(tuple(Part(flight, 0, 100) for flight in names))
    assert [[part.flight.name for part in half] for half in (one, other)] == [["a", "c"], ["b"]]


def test_only_what_was_smoothed_is_crossed(flown, smooth):
    parts = [Part(flight, 0, len(flight.truth)) for flight in (flown, smooth)]
    crossed, _ = searched(LogTask(IMU, ("noise",), Split(tuple(parts), (parts[1],))))
    assert crossed.split.tuning[0].flight is flown
    assert crossed.split.tuning[1].flight is not smooth


@pytest.mark.parametrize(("reference", "goal"), [("sim", "flight"), ("smooth", "recovery")])
def test_without_a_smoothed_reference_nothing_is_searched_before(flown, smooth, reference, goal):
    flight = flown if reference == "sim" else smooth
    task = LogTask(IMU, ("noise",), split((flight,)), goal)
    assert searched(task) == (task, [])


def test_a_reference_that_is_not_sure_stays_as_it_was(smooth):
    """With readings taken for a hundred times as noisy nothing is known to a few degrees."""
    part = Part(smooth, 0, len(smooth.truth))
    noisy = {"gyr_slow_noise_1_s": 1.0, "acc_noise": 10.0, "heading_noise": 10.0}
    task = LogTask(IMU, ("noise",), Split((part, part), (part,)))
    crossed = cross(task, lambda _: merge_profile(IMU, {"aiding": noisy}))
    assert all(each.flight is smooth for each in crossed.split.tuning)
