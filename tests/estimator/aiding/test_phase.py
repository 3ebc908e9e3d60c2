"""The phases of the aiding: what follows on what, what is left blank, and that all can be kept."""

import pytest

from estimator.aiding.beginning import blank_aiding
from estimator.aiding.phase import Cause, Phase, after
from estimator.aiding.search import EMPTY_SEARCH, SEARCH_ANEW
from estimator.conditioning.params import LONG_S
from estimator.estimator import Estimator
from estimator.geometry.quaternion import exp, rotate
from estimator.live.core import UNSEEN
from estimator.live.refusal import is_gap, mean_interval
from estimator.live.rows import TIME
from estimator.live.settings import settings_of
from estimator.profile import load_profile, merge_profile
from estimator.types import ZERO_VEC3, RateSample, VelocitySample
from tests.flight import TRUE_NORTH, ZURICH, banked_flight, calibrated, north_known

OFF = merge_profile(load_profile("imu"), {**TRUE_NORTH, "aiding": {"enabled": False}})
SECOND = 50  # samples


@pytest.fixture(scope="module")
def flight():
    return banked_flight()


class Pilot:
    """Flies an estimator along, and notes each phase as it is entered."""

    def __init__(self, estimator, flight, *, field=True):
        self.estimator, self._flight, self._field = estimator, flight, field
        self._reports = dict(flight.reports)
        self.k, self._late_us = 0, 0
        self.phases = [estimator.snapshot.context.phase]

    def fly(self, seconds, *, reports=True):
        for _ in range(round(seconds * SECOND)):
            sample = self._flight.samples[self.k]
            if not self._field:
                sample = sample._replace(has_mag=False, mag_gauss=ZERO_VEC3)
            sample = sample._replace(time_us=sample.time_us + self._late_us)
            assert self.estimator.update(sample) is None
            self._note()
            report = self._reports.get(self.k) if reports else None
            if report is not None:
                late = report._replace(time_us=report.time_us + self._late_us)
                self.estimator.update_report(late)
            self.k += 1
        return self

    def pause(self, seconds):
        self._late_us += round(1e6 * seconds)
        return self

    def _note(self):
        now = self.estimator.snapshot
        phase = now.context.phase
        if phase is not self.phases[-1]:
            self.phases.append(phase)
        require_nothing_stale(self.estimator, now)


def require_nothing_stale(estimator, now):
    phase, core = now.context.phase, now.core
    state, *arrays = blank_aiding(settings_of(estimator.profile).aiding)
    if phase is not Phase.AIDED:
        blank = (state, *(tuple(array.ravel().tolist()) for array in arrays))
        assert (core.aided, core.covariance, core.velocity_history) == blank
    if phase in (Phase.EMPTY, Phase.RAW):
        assert (core.seen, core.search) == (UNSEEN, EMPTY_SEARCH)


def test_the_field_gives_the_heading_and_a_gap_takes_it(flight):
    pilot = Pilot(north_known(), flight).fly(4.0).pause(6.0).fly(0.04, reports=False)
    begun = [Phase.EMPTY, Phase.UNAIDED, Phase.SEARCHING, Phase.AIDED]
    assert pilot.phases == [*begun, Phase.UNAIDED]
    assert pilot.fly(3.0).phases[-1] is Phase.AIDED


def test_a_fast_stream_is_aided_through_a_hole_of_seconds(flight):
    pilot = Pilot(north_known(), flight).fly(4.0).pause(3.5).fly(1.0)
    assert pilot.phases[-1] is Phase.AIDED


def test_without_a_field_it_is_searched_for_and_a_gap_ends_the_search(flight):
    """How the vehicle has turned meanwhile is not known: what was shown before is void."""
    pilot = Pilot(north_known(), flight, field=False).fly(5.0)
    search = pilot.estimator.snapshot.core.search
    assert search.evidence.windows == pytest.approx(3.81, rel=0.2)
    broken = Pilot(Estimator(pilot.estimator.profile), flight, field=False)
    broken.estimator.snapshot, broken.k = pilot.estimator.snapshot, pilot.k
    assert pilot.fly(25.0).phases == [Phase.EMPTY, Phase.UNAIDED, Phase.SEARCHING, Phase.AIDED]
    assert broken.estimator.snapshot.context.phase is Phase.SEARCHING
    broken.pause(6.0).fly(0.04, reports=False)
    assert broken.phases[-1] is Phase.UNAIDED
    assert broken.estimator.snapshot.core.search == SEARCH_ANEW


def test_reports_that_stay_away_end_it():
    pilot = Pilot(north_known(), banked_flight(seconds=106.0)).fly(4.0)
    pilot.fly(LONG_S - 1.0, reports=False)
    assert pilot.phases[-1] is Phase.AIDED
    pilot.fly(2.0, reports=False)
    assert pilot.phases[-2:] == [Phase.AIDED, Phase.UNAIDED]
    # the unaided attitude is known better by then, which is no compass's fault
    assert pilot.estimator.snapshot.context.compass.gave_up_us is None


@pytest.mark.parametrize(
    ("happen", "follows"),
    [
        (lambda one: one.replace_profile(load_profile("paper")), Phase.RAW),
        (lambda one: one.replace_profile(OFF), Phase.UNAIDED),
        (lambda one: one.set_field_calibrated(False), Phase.UNAIDED),
    ],
    ids=["raw", "off", "misled"],
)
def test_what_else_ends_it(flight, happen, follows):
    pilot = Pilot(north_known(), flight).fly(4.0)
    assert pilot.phases[-1] is Phase.AIDED
    happen(pilot.estimator)
    assert pilot.fly(0.02, reports=False).phases[-1] is follows


def test_raw_vectors_go_on_as_conditioned_ones_even_across_a_gap(flight):
    one = calibrated(load_profile("paper"))
    pilot = Pilot(one, flight).fly(1.0).pause(5.0)
    one.replace_profile(north_known().profile)
    assert pilot.fly(0.02).phases == [Phase.EMPTY, Phase.RAW, Phase.UNAIDED]


def test_only_a_sample_leaves_the_beginning_and_nothing_returns_to_it():
    assert {c for c in Cause if after(Phase.EMPTY, c) is not Phase.EMPTY} == {
        Cause.SAMPLE,
        Cause.RAW_SAMPLE,
    }
    assert all(after(p, c) is not Phase.EMPTY for p in Phase if p is not Phase.EMPTY for c in Cause)


@pytest.mark.parametrize("name", ["paper", "imu"])
def test_a_restart_forgets_everything(flight, name):
    """Also when the vehicle's clock starts again."""
    used, fresh = (Pilot(calibrated(load_profile(name)), flight) for _ in range(2))
    assert used.fly(20.0).estimator.is_aided == (name == "imu")
    used.estimator.restart()
    assert used.estimator.snapshot == fresh.estimator.snapshot
    used.k = 0
    assert used.fly(20.0).estimator.snapshot == fresh.fly(20.0).estimator.snapshot


# profile, seconds, whether there is a field, and whether it is calibrated
STATES = {
    "raw": ("paper", 4.0, True, True),
    "search open": ("imu", 4.0, False, True),
    "aided without field": ("imu", 40.0, False, True),
    "aided without north": ("imu", 40.0, True, False),
}
AS_BEFORE = {
    "restored": lambda one, _: setattr(one, "snapshot", one.snapshot),
    "replaced": lambda one, _: one.replace_profile(merge_profile(one.profile, {})),
    "declared the same": lambda one, is_calibrated: one.set_field_calibrated(is_calibrated),
}


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("interruption", AS_BEFORE)
def test_interruptions_change_nothing(flight, state, interruption):
    """Between a sample and a report that belongs to it."""
    name, seconds, has_field, is_calibrated = STATES[state]
    straight, broken = (
        Pilot(calibrated(load_profile(name)), flight, field=has_field) for _ in range(2)
    )
    for pilot in (straight, broken):
        pilot.estimator.set_field_calibrated(is_calibrated)
        pilot.fly(seconds).fly(1 / SECOND, reports=False)
        assert (pilot.phases[-1] is Phase.AIDED) == state.startswith("aided")
        if pilot is broken:
            AS_BEFORE[interruption](pilot.estimator, is_calibrated)
        pilot.estimator.update_report(dict(flight.reports)[pilot.k - 1])
        pilot.fly(10.0)
    assert broken.estimator.snapshot == straight.estimator.snapshot


def waiting(one):
    """A report ahead of the IMU."""
    ahead_us = one.snapshot.core.time_us + 30_000
    one.update_report(VelocitySample(ahead_us, (15.0, 1.0, 0.0), True, 0.3))
    assert one.snapshot.core.reports[TIME] == ahead_us


INTERRUPTIONS = {
    "a report waits": waiting,
    "another IMU": lambda one: one.change_imu(),
    "a turn": lambda one: one.turn(exp((0.1, -0.2, 0.3))),
    "a place": lambda one: one.set_position(*ZURICH),
}


# raw vectors have no use for velocity
RAW = [("paper", name, False) for name in INTERRUPTIONS if name != "a report waits"]
CONDITIONED = [("imu", name, aided) for name in INTERRUPTIONS for aided in (True, False)]


@pytest.mark.parametrize(("profile", "name", "aided"), RAW + CONDITIONED)
def test_a_snapshot_taken_then_goes_on_to_the_last_bit(flight, profile, name, aided):
    straight, resumed = calibrated(load_profile(profile)), calibrated(load_profile(profile))
    if name != "a place":
        straight.set_position(*ZURICH)
    one = Pilot(straight, flight).fly(6.0, reports=aided)
    assert (one.phases[-1] is Phase.AIDED) is (aided and name != "a place")
    INTERRUPTIONS[name](straight)
    resumed.snapshot = straight.snapshot
    other = Pilot(resumed, flight)
    other.k = one.k
    for _ in range(10):
        one.fly(0.2, reports=aided)
        other.fly(0.2, reports=aided)
        assert resumed.snapshot == straight.snapshot
        time_us = straight.snapshot.core.time_us + 7_000
        assert resumed.attitude(time_us) == straight.attitude(time_us)


def test_the_field_does_not_begin_it_on_a_vertical_that_has_just_begun(flight):
    """The unaided vertical is a mean over ``gravity_tau_s`` (2.5 s), which a hole makes void."""
    pilot = Pilot(north_known(), flight).fly(2.4)
    assert Phase.AIDED not in pilot.phases
    assert pilot.fly(0.4).phases[-1] is Phase.AIDED
    assert pilot.fly(1.2).pause(20.0).fly(2.0).phases[-1] is not Phase.AIDED
    assert pilot.fly(1.0).phases[-1] is Phase.AIDED


@pytest.mark.parametrize(("others_hz", "follows"), [(10.0, Phase.AIDED), (1.0, Phase.UNAIDED)])
def test_a_gap_whose_turning_others_have_seen_is_none(flight, others_hz, follows):
    """Body rates of ATTITUDE, not more than 0.35 s apart."""
    one = north_known()
    pilot = Pilot(one, flight).fly(4.0)
    now_us = one.snapshot.core.time_us
    for k in range(1, round(6.0 * others_hz)):
        rate = flight.samples[pilot.k - 1].gyr_rad_s
        one.update_report(RateSample(now_us + round(1e6 * k / others_hz), rate))
    pilot.pause(6.0).fly(0.02, reports=False)
    assert pilot.phases[-1] is follows


def test_a_search_begins_with_the_force_of_the_sample_that_its_first_report_comes_with(flight):
    """Until then nobody follows the force; afterwards each sample adds to the window."""
    pilot = Pilot(calibrated(load_profile("imu")), flight, field=False).fly(3, reports=False)
    assert pilot.estimator.snapshot.core.search == EMPTY_SEARCH
    then = pilot.estimator.snapshot.core
    while not then.search.window.is_open:
        then = pilot.fly(1 / SECOND).estimator.snapshot.core
    force = rotate(then.gathered.q_g_frd, then.sample.acc_m_s2)
    assert then.search.window.first_force_m_s2 == pytest.approx(force, abs=1e-12)
    now = pilot.fly(10 / SECOND, reports=False).estimator.snapshot.core
    force = rotate(now.gathered.q_g_frd, now.sample.acc_m_s2)
    assert now.search.window.force_m_s2 == pytest.approx(force, abs=1e-12)
    passed_s = now.search.window.time_s - then.search.window.time_s
    assert passed_s == pytest.approx(10 / SECOND, abs=1e-9)


def mean_step_s(steps_s):
    value = 0.0
    for dt_s in steps_s:
        value = mean_interval(value, dt_s)
    return value


@pytest.mark.parametrize(
    ("step_s", "longest_s"), [(0.02, 3.618), (0.25, 1.0), (0.5, 1.5), (1.0, 3.0), (2.0, 6.0)]
)
def test_a_gap_is_three_mean_intervals_and_a_second_at_least(step_s, longest_s):
    steady = mean_step_s([step_s] * 50)
    assert not is_gap(steady, longest_s - 0.01)
    assert is_gap(steady, longest_s + 0.01)


def test_one_gap_makes_no_slow_stream_and_one_that_slows_down_is_followed():
    assert mean_step_s([0.02] * 50 + [10.0]) == pytest.approx(0.022)
    assert mean_step_s([0.02] * 50 + [1.0] * 70) > 0.85
