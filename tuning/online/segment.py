"""The last seconds of a vehicle, as calls to its estimator that can be repeated."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from estimator.aiding.phase import Phase
from estimator.estimator import Estimator
from estimator.geometry.quaternion import multiply
from estimator.live.core import Snapshot, with_attitude
from estimator.live.rows import Rows, cut, rows_of
from estimator.profile import Profile
from estimator.types import ImuSample, Quaternion
from tuning.calls import Call, Calls, Course, course_of, split_calls

SEGMENT_S = 5.0
# In a silence longer than this nobody knows what the vehicle has done.
LONGEST_GAP_S = 0.5


class Segment(NamedTuple):
    """Some five seconds: the state before them, the profile in force, and what came in them.

    ``calls[k]`` are those before sample k; ``fixed_gain`` stands in for the profile's gain.
    """

    before: Snapshot
    profile: Profile
    samples: tuple[ImuSample, ...]
    calls: Calls
    fixed_gain: float | None = None

    @property
    def is_broken(self) -> bool:
        """Whether it began without an attitude, or there was a gap or a restart in it."""
        gaps_us = (b.time_us - a.time_us for a, b in pairwise(self.samples))
        return (
            self.before.context.phase is Phase.EMPTY
            or any(gap_us > 1e6 * LONGEST_GAP_S for gap_us in gaps_us)
            or any(call.method == "restart" for calls in self.calls.values() for call in calls)
        )

    def follows(self, earlier: "Segment") -> bool:
        """Whether nothing was left out between them."""
        gap_us = self.samples[0].time_us - earlier.samples[-1].time_us
        return gap_us <= 1e6 * LONGEST_GAP_S


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
    before = segments[0].before
    if wrong_ned is not None:
        turned = multiply(wrong_ned, before.core.filter.q_ned_frd)
        before = before._replace(core=with_attitude(before.core, turned))
    estimator = Estimator(segments[0].profile, segments[0].fixed_gain)
    estimator.snapshot = before
    estimator.replace_profile(profile)
    calls: dict[int, Sequence[Call]] = {}
    first = 0
    for segment in segments:
        calls |= {first + k: each for k, each in segment.calls.items()}
        first += len(segment.samples)
    reports, others = split_calls(calls)
    return course_of(estimator, cut(rows_of_all(segments), 0, most), others, reports=reports)


def rows_of_all(segments: tuple[Segment, ...]) -> Rows:
    """Their samples as arrays."""
    samples = [sample for segment in segments for sample in segment.samples]
    times_us, gyr, acc, mag, has_mag = map(np.array, zip(*samples, strict=True))
    return rows_of(times_us, gyr, acc, mag, has_mag)
