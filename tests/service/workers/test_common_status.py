import pytest

from drivers.events import RefusedFrames, Shed, VehicleId
from estimator.reasons import Reason
from service.counts import Counts
from service.departures import DepartedCounts
from service.records import StatusRecord
from service.workers.common_status import CommonStatus
from service.workers.job import Tally

FIRST, SECOND = VehicleId(1, 1), VehicleId(2, 1)


def status(overruns=0, dropped=0, shed=0, *, overloaded=False):
    return StatusRecord(
        "running", "RAW_IMU", 50.0, 0.1, {"spike": 1}, overruns, dropped, 5,
        overloaded=overloaded, shed=shed,
    )  # fmt: skip


def counts(samples, attitudes=10):
    return Counts("running", None, "RAW_IMU", 50.0, 0, samples, 3, attitudes, 5, {"spike": 1})


@pytest.fixture
def common():
    made = CommonStatus()
    made.note(0, Tally(100, 3, 4, (0, 0, 0), {FIRST: counts(50)}))
    made.note(1, Tally(120, 5, 6, DepartedCounts(1, 20, 5, 6, 30), {SECOND: counts(70)}))
    return made


def test_a_status_has_what_all_have_lost_and_only_its_own_workers_overload(common):
    common.dropped, common.malformed, common.restarts = 7, 8, 2
    published = common.status(0, FIRST, status(overruns=3, dropped=4))
    assert published.overruns == 3 + 5
    assert published.dropped == 4 + 6 + 7
    assert (published.malformed, published.restarts, published.worker) == (8, 2, 1)
    assert not published.overloaded
    assert common.status(1, SECOND, status(overloaded=True)).overloaded
    common.is_overloaded = True
    assert common.status(0, FIRST, status()).overloaded


def test_what_the_link_refuses_and_leaves_out_counts_for_its_vehicle(common):
    common.refuse(RefusedFrames(FIRST, 0, Reason.UNSIGNED, 4))
    common.refuse(RefusedFrames(FIRST, 0, Reason.UNSIGNED, 5))
    common.refuse(RefusedFrames(VehicleId(99, 1), 0, Reason.UNSIGNED, 1))
    common.shed(Shed(FIRST, 0, "RAW_IMU", 6))
    published = common.status(0, FIRST, status(shed=3))
    assert published.rejected == {"spike": 1, "unsigned": 9}
    assert published.shed == 9
    assert common.status(1, SECOND, status()).rejected == {"spike": 1}
    assert common.refused == {"unsigned": 10}
    assert common.tally.vehicles[FIRST].rejected == {"spike": 1, "unsigned": 9}


def test_what_a_dead_worker_had_counted_stays(common):
    last = common.forget(0)
    assert last.vehicles == {FIRST: counts(50)}
    common.note(0, Tally(1, 1, 1, DepartedCounts(), {FIRST: counts(60)}))
    total = common.tally
    assert (total.ticks, total.overruns, total.dropped) == (120, 3 + 5 + 1, 4 + 6 + 1)
    assert total.departed == DepartedCounts(1, 20, 5, 6, 30)
    assert total.vehicles == {FIRST: counts(60), SECOND: counts(70)}
    assert common.status(1, SECOND, status(overruns=5)).overruns == 5 + 1 + 3
