import numpy as np
import pytest

from drivers.events import ReferenceAttitude, VehicleId
from drivers.logs.reference_track import ReferenceTrack
from estimator.geometry.quaternion import angle_between, exp

VEHICLE = VehicleId(1, 1)


def turned(yaw_rad):
    return exp((0.0, 0.0, yaw_rad))


def track_of(times_us, message="ATTITUDE", rate_rad_s=0.5):
    track = ReferenceTrack()
    for t in times_us:
        q = turned(rate_rad_s * t * 1e-6)
        track.add(ReferenceAttitude(VEHICLE, t, t, "autopilot", message, q))
    return track


def test_between_samples_the_reference_is_interpolated_along_the_arc():
    track = track_of(range(0, 2_000_001, 100_000))
    times = np.array([0, 50_000, 123_456, 1_999_999])
    attitudes, known = track.at(times)
    assert known.all()
    for t, q in zip(times, attitudes, strict=True):
        assert angle_between(tuple(q), turned(0.5 * t * 1e-6)) < 1e-9


def test_across_a_gap_nothing_is_known():
    track = track_of([*range(0, 500_001, 50_000), *range(5_000_000, 5_500_001, 50_000)])
    _, known = track.at(np.array([400_000, 2_000_000, 4_800_000, 4_950_000, 5_100_000]))
    assert known.tolist() == [True, False, False, True, True]


def test_a_slow_reference_may_be_interpolated_over_its_own_period():
    _, known = track_of(range(0, 10_000_001, 1_000_000)).at(np.array([1_500_000, 9_999_999]))
    assert known.all()


@pytest.mark.parametrize(("gap_us", "is_known"), [(2_400_000, True), (2_600_000, False)])
def test_two_and_a_half_periods_of_a_slow_reference_are_no_gap(gap_us, is_known):
    times = [*range(0, 5_000_001, 1_000_000), *range(5_000_000 + gap_us, 12_000_000, 1_000_000)]
    _, known = track_of(times).at(np.array([6_200_000]))
    assert known.tolist() == [is_known]


def test_the_message_that_says_most_is_used_and_messages_do_not_mix():
    track = track_of(range(0, 1_000_001, 100_000), "ATTITUDE")
    for t in range(0, 1_000_001, 20_000):
        away = turned(3.0)
        track.add(ReferenceAttitude(VEHICLE, t, t, "autopilot", "ATTITUDE_QUATERNION", away))
    attitudes, _ = track.at(np.array([500_000]))
    assert track.message == "ATTITUDE_QUATERNION"
    assert angle_between(tuple(attitudes[0]), turned(3.0)) < 1e-9


@pytest.mark.parametrize("times", [[], [1_000_000]])
def test_too_few_samples_answer_only_beside_themselves(times):
    _, known = track_of(times).at(np.array([950_000, 1_000_000, 1_200_000]))
    assert known.tolist() == [bool(times), bool(times), False]
