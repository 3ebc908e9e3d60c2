"""The last seconds of a vehicle, as its estimator was told of them, to be flown again."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.estimator import Estimator
from estimator.geometry.quaternion import exp, multiply, scale
from estimator.live.core import with_attitude
from estimator.live.snapshot import Snapshot
from estimator.profile import Profile
from estimator.types import ImuSample, Quaternion
from tuning.prediction import Readings
from tuning.told import Call

Array = NDArray[np.float64]

SEGMENT_S = 5.0
# In a silence longer than this nobody knows what the vehicle has done.
LONGEST_GAP_S = 0.5


class Segment(NamedTuple):
    """Some five seconds: the state before them, the profile in force, and what was told in them.

    ``calls[k]`` are those up to and including the one with sample k. ``silent`` tells that there
    was a gap inside, or a restart.
    """

    before: Snapshot
    profile: Profile
    samples: tuple[ImuSample, ...]
    calls: tuple[tuple[Call, ...], ...]
    silent: bool
    fixed_gain: float | None = None  # instead of the profile's


class Window(NamedTuple):
    """Two segments in sequence: a candidate is found on the earlier, and judged on the later."""

    earlier: Segment
    later: Segment

    @property
    def samples(self) -> tuple[ImuSample, ...]:
        """All samples in sequence."""
        return self.earlier.samples + self.later.samples


class Flown(NamedTuple):
    """Attitudes (N, 4) and gyroscope's biases (N, 3) behind each sample."""

    q_ned_frd: Array
    bias_rad_s: Array


def fly_segments(
    profile: Profile, segments: tuple[Segment, ...], wrong: Quaternion | None = None, most: int = -1
) -> Flown:
    """The segments again with another profile, from the state before the first of them.

    With a ``wrong`` turn (NED) the filter's attitude is turned by it at the beginning. At
    most ``most`` samples.
    """
    first = segments[0]
    estimator = Estimator(first.profile, first.fixed_gain)
    estimator.snapshot = first.before
    estimator.replace_profile(profile)
    if wrong is not None:
        core = estimator.snapshot.core
        turned = with_attitude(core, multiply(wrong, core.filter.q_ned_frd))
        estimator.snapshot = first.before._replace(core=turned)
        estimator.replace_profile(profile)
    rows: list[tuple[float, ...]] = []
    for segment in segments:
        for sample, calls in zip(segment.samples, segment.calls, strict=True):
            if len(rows) == most:
                break
            for call in calls:
                call(estimator)
            said = estimator.attitude(sample.time_us)
            rows.append((*said.q_ned_frd, *said.gyro_bias_rad_s))
    table = np.array(rows).reshape(-1, 7)
    return Flown(table[:, :4], table[:, 4:])


WRONG_TURN = exp(scale(np.radians(170.0), (3**-0.5, 3**-0.5, 3**-0.5)))


def readings_of(samples: tuple[ImuSample, ...]) -> Readings:
    """Samples as arrays; times from the first."""
    times_us = np.array([sample.time_us for sample in samples], dtype=np.int64)
    return Readings(
        time_s=1e-6 * (times_us - times_us[0]),
        gyr_rad_s=np.array([sample.gyr_rad_s for sample in samples]),
        acc_m_s2=np.array([sample.acc_m_s2 for sample in samples]),
        mag=np.array([sample.mag_gauss for sample in samples]),
        has_mag=np.array([sample.has_mag for sample in samples]),
    )
