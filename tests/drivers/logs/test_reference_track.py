import numpy as np
import pytest

from drivers.events import ReferenceAttitude
from drivers.logs.reference_track import ReferenceTrack
from estimator.geometry.quaternion import angle_between, exp
from tests.drivers.mavlink.messages import VEHICLE, S

GAP = [*range(0, 500_001, 50_000), *range(5 * S, 5_500_001, 50_000)]


def turned(yaw_rad):
    return exp((0.0, 0.0, yaw_rad))


def add(track, times_us, message="ATTITUDE", attitude=lambda t: turned(0.5e-6 * t)):
    for t in times_us:
        track.add(ReferenceAttitude(VEHICLE, t, t, "autopilot", message, attitude(t)))
    return track


def slow(gap_us):
    """One a second, and a gap behind the fifth."""
    return add(ReferenceTrack(), [*range(0, 5 * S + 1, S), *range(5 * S + gap_us, 12 * S, S)])


def test_the_reference_is_interpolated_along_the_arc_and_the_last_holds_for_a_moment():
    times = np.array([0, 50_000, 123_456, 1_999_999, 2_090_000])
    attitudes = add(ReferenceTrack(), range(0, 2 * S + 1, 100_000)).at(times)
    for t, q in zip(times, attitudes, strict=True):
        assert angle_between(tuple(q), turned(0.5e-6 * min(t, 2 * S))) < 1e-9


@pytest.mark.parametrize(
    ("track", "times_us", "expected"),
    [
        (add(ReferenceTrack(), GAP), (4e5, 2e6, 4.8e6, 4.95e6, 5.1e6), [1, 0, 0, 1, 1]),
        (slow(S), (1.5e6, 10.5e6), [1, 1]),
        (slow(2_400_000), (6.2e6,), [1]),
        (slow(2_600_000), (6.2e6,), [0]),
        (add(ReferenceTrack(), range(0, S + 1, 100_000)), (1.09e6, 1.11e6), [1, 0]),
        (ReferenceTrack(), (0.95e6, 1e6), [0, 0]),
        (add(ReferenceTrack(), [S]), (0.95e6, 1e6, 1.2e6), [1, 1, 0]),
    ],
)
def test_what_is_known_around_gaps_and_at_the_ends(track, times_us, expected):
    """A gap is two and a half periods long, and half a second; a tenth beside it is near."""
    known = np.isfinite(track.at(np.array(times_us, int))).all(axis=1)
    assert known.tolist() == list(map(bool, expected))


def test_the_most_frequent_message_is_used_and_messages_do_not_mix():
    track = add(ReferenceTrack(), range(0, S + 1, 100_000))
    add(track, range(0, S + 1, 20_000), "ATTITUDE_QUATERNION", lambda _: turned(3.0))
    assert track.message == "ATTITUDE_QUATERNION"
    assert angle_between(tuple(track.at(np.array([500_000]))[0]), turned(3.0)) < 1e-9
