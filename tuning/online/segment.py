"""The last seconds of a vehicle, as calls to its estimator that can be repeated."""

from typing import NamedTuple

import numpy as np

from estimator.estimator import Estimator
from estimator.geometry.quaternion import multiply
from estimator.live.core import Snapshot, with_attitude
from estimator.live.rows import Rows, cut, rows_of
from estimator.profile import Profile
from estimator.types import ImuSample, Quaternion
from tuning.course import Course, course_of, split_calls
from tuning.logged_calls import Call

SEGMENT_S = 5.0
# In a silence longer than this nobody knows what the vehicle has done.
LONGEST_GAP_S = 0.5


class Segment(NamedTuple):
    """Some five seconds: the state before them, the profile in force, and what was told in them.

    ``calls[k]`` are those before sample k. ``silent`` shows that there
    was a gap inside, or a restart.
    """

    before: Snapshot
    profile: Profile
    samples: tuple[ImuSample, ...]
    calls: tuple[tuple[Call, ...], ...]
    silent: bool
    fixed_gain: float | None = None  # instead of the profile's


def fly_segments(
    profile: Profile,
    segments: tuple[Segment, ...],
    wrong_ned: Quaternion | None = None,
    most: int | None = None,
) -> Course:
    """The segments again with another profile, from the state before the first of them.

    With a ``wrong_ned`` turn the filter's attitude is turned by it at the beginning. At most
    ``most`` samples.
    """
    first = segments[0]
    before = first.before
    if wrong_ned is not None:
        turned = multiply(wrong_ned, before.core.filter.q_ned_frd)
        before = before._replace(core=with_attitude(before.core, turned))
    estimator = Estimator(first.profile, first.fixed_gain)
    estimator.snapshot = before
    estimator.replace_profile(profile)
    calls = [told for segment in segments for told in segment.calls]
    told, others = split_calls({k: each for k, each in enumerate(calls) if each})
    return course_of(estimator, cut(rows_of_all(segments), 0, most), others, told=told)


def rows_of_all(segments: tuple[Segment, ...]) -> Rows:
    """Their samples as arrays."""
    samples = [sample for segment in segments for sample in segment.samples]
    times_us, gyr, acc, mag, has_mag = map(np.array, zip(*samples, strict=True))
    return rows_of(times_us, gyr, acc, mag, has_mag)
