"""The last seconds of a vehicle, as calls to its estimator that can be repeated, and their cost.

The cost of a profile needs no truth. It is sin^2 of half the angle between the vectors that the
estimate predicts half a second ahead by the gyroscope alone, and those measured then. A wrong
start's mean e over the second behind it is added, as if there were one each five minutes.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimator.aiding.phase import Phase
from estimator.estimator import Estimator
from estimator.geometry.metrics import batch_angle_errors
from estimator.geometry.quaternion import multiply
from estimator.geometry.rotations import exp, rotate
from estimator.live.core import Snapshot, with_attitude
from estimator.live.rows import Rows, rows_of
from estimator.profile import Profile
from estimator.types import Floats, ImuSample, Quaternion
from tuning.calls import WRONG_TURN, Calls, Course, course_of, split_calls
from tuning.prediction import heading_errors, predicted_vectors

SEGMENT_S = 5.0
LONGEST_GAP_S = 0.5  # in a longer silence nobody knows what the vehicle has done
PULL_IN_S, PULL_IN_WEIGHT = 1.0, 1.0 / 300.0
BLOCK_S = 0.5  # errors of different blocks are nearly independent
LONGEST_STEP_S = 0.15  # two readings further apart show about motion, not about noise
LEAST_NOISE = 1e-6  # less counts as none: (1 mrad)^2, and (1 mrad/s)^2
CHANGED = 2.0  # of a mean square; noise twice as large changes it by four


@dataclass(frozen=True)
class Segment:
    """Some five seconds: the state before them, the profile in force, and what came in them.

    ``calls[k]`` are those before sample k; ``fixed_gain`` stands in for the profile's gain.
    """

    before: Snapshot
    profile: Profile
    samples: tuple[ImuSample, ...]
    calls: Calls
    fixed_gain: float | None = None

    @cached_property
    def rows(self) -> Rows:
        """The samples as arrays; who flies it makes them, and not the loop that hands it over."""
        return rows_of(*map(np.array, zip(*self.samples, strict=True)))

    @property
    def is_broken(self) -> bool:
        """Whether it began without an attitude, or there was a gap or a restart in it."""
        return (
            self.before.context.phase is Phase.EMPTY
            or bool((np.diff(self.rows.times_us) > 1e6 * LONGEST_GAP_S).any())
            or any(call.method == "restart" for calls in self.calls.values() for call in calls)
        )


def joined(earlier: Segment, later: Segment) -> Segment:
    """Two that follow each other as one, which begins as the first did."""
    first, samples = len(earlier.samples), earlier.samples + later.samples
    calls = {**earlier.calls, **{first + k: each for k, each in later.calls.items()}}
    return replace(earlier, samples=samples, calls=calls)


def fly_again(profile: Profile, segment: Segment, wrong_ned: Quaternion | None = None) -> Course:
    """The segment again with another profile, from the state before it, turned if that is given."""
    before = segment.before
    if wrong_ned is not None:
        turned = multiply(wrong_ned, before.core.filter.q_ned_frd)
        before = before._replace(core=with_attitude(before.core, turned))
    estimator = Estimator(segment.profile, segment.fixed_gain)
    estimator.snapshot = before
    estimator.replace_profile(profile)
    reports, others = split_calls(segment.calls)
    return course_of(estimator, segment.rows, others, reports)


def cost_on(profile: Profile, segment: Segment, whole: Segment | None = None) -> Floats:
    """The cost (B,) of each half second of a segment, flown as the end of a ``whole`` if given."""
    whole = segment if whole is None else whole
    rows, flown = whole.rows, fly_again(profile, whole)
    first = len(whole.samples) - len(segment.samples)
    down, field = predicted_vectors(rows, flown.q_ned_frd, flown.bias_rad_s, first)
    off = 0.5 * (1.0 - down[:, 2])
    # of the field that it keeps its azimuth: a magnet turns it as a whole
    off_north = np.sin(0.5 * heading_errors(field)) ** 2
    off = np.where(np.isfinite(off_north), 0.5 * (off + off_north), off)
    known = np.isfinite(off)
    block = (1e-6 * (rows.times_us[known] - rows.times_us[0]) / BLOCK_S).astype(int)
    found = [float(off[known][block == b].mean()) for b in np.unique(block)]
    # e between an estimate that begins 170 deg off and one that does not, over a second
    end_us = segment.samples[0].time_us + 1e6 * PULL_IN_S
    count = max(1, sum(sample.time_us <= end_us for sample in segment.samples))
    begin = replace(segment, samples=segment.samples[:count])
    both = (fly_again(profile, begin, turn) for turn in (WRONG_TURN, None))
    angles = batch_angle_errors(*(each.q_ned_frd for each in both))[:, 0]
    pull_in = float(np.mean(np.sin(0.5 * angles) ** 2))
    return np.array(found or [0.0]) + PULL_IN_WEIGHT * pull_in


def noise_of(rows: Rows) -> Floats | None:
    """Mean squares (3,) of the noise: of rate, (rad/s)^2, and of force and field as unit vectors.

    From how far a reading is from the one before, turned on by the gyroscope. None if they come
    too slowly to show it.
    """
    step_s = 1e-6 * np.diff(rows.times_us)
    is_fast = step_s <= LONGEST_STEP_S
    if 2 * is_fast.sum() < len(step_s):
        return None
    turn = exp(-rows.gyr_rad_s[1:] * step_s[:, None])
    # by how much each is another than the one before, turned against the body
    changes = [np.diff(rows.gyr_rad_s, axis=0)]
    for vectors in (rows.acc_m_s2, rows.mag_gauss):
        length = np.linalg.norm(vectors, axis=1, keepdims=True)
        unit = vectors / np.maximum(length, LEAST_NOISE)
        changes.append(unit[1:] - rotate(turn, unit[:-1]))
    has_field = is_fast & rows.has_mag[1:] & rows.has_mag[:-1]
    pairs = zip(changes, (is_fast, is_fast, has_field), strict=True)
    # a change has the noise of two readings
    return np.array([0.5 * np.sum(c[k] ** 2) / max(1, k.sum()) for c, k in pairs])


def has_moved(learnt: Floats, now: Floats) -> bool:
    """Whether any noise is another than was learnt."""
    ratio = np.log((now + LEAST_NOISE) / (learnt + LEAST_NOISE))
    return bool(np.any(np.abs(ratio) > np.log(CHANGED)))
