"""When a profile is retuned while it runs, and by what proof, without a truth.

Segments in, decisions out, no clock: the same segments give the same decisions. It rests while the
readings' noise is what was learnt. Where that has moved, and two segments in a row agree on what it
is now, the colony searches on the earlier of them. Its best, the base profile and what was in force
before the last move are judged on the later one and on those that follow: a winner is at least 5 %
cheaper than what is in force, and beyond chance. After a move that is not back it searches once
more.
"""

from collections.abc import Callable
from math import sqrt
from typing import NamedTuple

import numpy as np

from estimator.profile import Profile, merge_profile, profile_to_json
from estimator.reasons import Reason
from estimator.types import Floats, ImuSample
from tuning.calls import LoggedEstimator
from tuning.online.segment import SEGMENT_S, Segment, cost_on, has_moved, joined, noise_of
from tuning.optimizers import bees
from tuning.search import Search, SearchOptions
from tuning.space import Parameter, Space, decode, encode

LEAST_GAIN = 0.05
LEAST_T = 2.0  # Student's t of the paired half seconds; chance exceeds it once in thirty
MOST_SEGMENTS = 4  # that a candidate is judged on, while it may win
EVENT = 0.25  # half a second in which vectors are 60 deg from what was predicted; it is no noise
FOOD_SOURCES, CYCLES = 6, 2
CHANGED, BACK = "noise has changed", "taken back"  # why a candidate is one
MOST_FACTOR, MOST_MOVE = 30.0, 3.0  # in all, and in one move

# Search from kept positions (M, D); returns those to keep
Look = Callable[[Search, Floats, np.random.Generator], Floats]
# Keys of a profile (section, key, power) that are multiplied by powers of one factor, by its name.
Numbers = dict[str, tuple[tuple[str, str, float], ...]]

# With raw vectors the confidences scale the gain, floor and all. How they share it out is
# not searched: what the vectors' own biases do is in no prediction.
RAW: Numbers = {
    "gain": tuple(("confidence", key, 1.0) for key in ("gravity", "magnetic", "cross")),
    "gamma": (("filter", "gamma", 1.0),),
}
CONDITIONED: Numbers = {
    "gyroscope": (("aiding", "gyr_slow_noise_1_s", 1.0),),
    "accelerometer": (("aiding", "acc_noise", 1.0),),
    "gravity time": (("conditioning", "gravity_tau_s", 1.0),),
    "heading": (("aiding", "heading_noise", 1.0), ("conditioning", "heading_noise_rad2_s", 2.0)),
}


def numbers_of(base: Profile) -> Numbers:
    """The numbers of a profile that are retuned, but for zeros, which have no factor."""
    tree = profile_to_json(base)
    chosen = CONDITIONED if base.conditioned else RAW
    return {
        name: keys
        for name, keys in chosen.items()
        if all(tree[section][key] > 0.0 for section, key, _ in keys)
    }


def update_of(base: Profile, factors: Floats) -> dict[str, dict[str, float]]:
    """The partial profile that ``factors`` (D,) on the base's numbers mean."""
    tree = profile_to_json(base)
    update: dict[str, dict[str, float]] = {}
    for keys, factor in zip(numbers_of(base).values(), factors.tolist(), strict=True):
        for section, key, power in keys:
            update.setdefault(section, {})[key] = tree[section][key] * factor**power
    return update


def space_around(base: Profile, factors: Floats) -> Space:
    """What can be reached in one move from ``factors`` (D,), by their logarithm."""
    low = np.maximum(factors / MOST_MOVE, 1.0 / MOST_FACTOR)
    high = np.minimum(factors * MOST_MOVE, MOST_FACTOR)
    return tuple(map(Parameter, numbers_of(base), low.tolist(), high.tolist()))


class Decision(NamedTuple):
    """A change of the profile in force, and why."""

    update: dict[str, dict[str, float]]  # a partial profile
    reason: str
    gain: float  # the share of the cost that it saved where it was judged
    summary: str  # a line with the factors of the base profile's numbers


class Trial(NamedTuple):
    """A candidate, and what is in force and it cost in half seconds (2, B) of each segment."""

    factors: Floats
    reason: str
    costs: tuple[Floats, ...] = ()

    @property
    def share(self) -> float:
        """The share of the cost that it saves."""
        old, new = np.concatenate(self.costs, axis=1)
        return 1.0 - float(new.sum()) / float(old.sum())

    @property
    def has_won(self) -> bool:
        """Whether it is cheaper by enough, and beyond chance by Student's t of the pairs."""
        saved = np.subtract(*np.concatenate(self.costs, axis=1))
        beyond = sqrt(len(saved)) * saved.mean() > LEAST_T * saved.std(ddof=1)
        return self.share > LEAST_GAIN and len(saved) > 1 and bool(beyond)

    @property
    def is_open(self) -> bool:
        """Whether more segments may decide."""
        return len(self.costs) < MOST_SEGMENTS and self.share > LEAST_GAIN


class Retuner:
    """The decisions about one vehicle, from segment to segment."""

    def __init__(self, base: Profile, seed: int = 0, look: Look = bees) -> None:
        self._base, self._look, self._generator = base, look, np.random.default_rng(seed)
        ones = np.ones(len(numbers_of(base)))
        self._now = self._before = ones  # factors in force, and before the last move
        self._kept = ones[None, :]  # the colony's food sources
        self._last: tuple[Segment, Floats] | None = None  # with its noise
        self._learnt: Floats | None = None  # the noise that the factors in force are for
        self._is_fresh = False  # whether they have come by the last search
        self._trials: list[Trial] = []

    @property
    def profile(self) -> Profile:
        """What should be in force."""
        return self._by(self._now)

    def take(self, segment: Segment) -> Decision | None:
        """The next segment; what follows from it.

        Nothing does where another profile was in force: a decision has not arrived yet.
        """
        earlier, self._last = self._last, None
        noise = noise_of(segment.rows)
        is_own = profile_to_json(segment.profile) == profile_to_json(self.profile)
        if segment.is_broken or noise is None or not is_own or not len(self._now):
            return None
        self._last = segment, noise
        self._learnt = noise if self._learnt is None else self._learnt
        if earlier is None:
            return None
        has_settled = not has_moved(earlier[1], noise)
        is_due = self._is_fresh or (has_settled and has_moved(self._learnt, noise))
        if not (self._trials or is_due) or (both := joined(earlier[0], segment)).is_broken:
            return None
        now = cost_on(self.profile, segment, both)
        if now.max() > EVENT:
            return None
        if not self._trials:
            self._learnt, self._is_fresh = noise, False
            self._trials = self._search(earlier[0])
        return self._judge(segment, both, now)

    def _judge(self, segment: Segment, both: Segment, now: Floats) -> Decision | None:
        """The best that has won, if any, by one more segment, which costs ``now`` as it is."""
        tried: list[Trial] = []
        for trial in self._trials:
            costs = np.array([now, cost_on(self._by(trial.factors), segment, both)])
            tried.append(trial._replace(costs=(*trial.costs, costs)))
        won = max((t for t in tried if t.has_won), key=lambda t: t.share, default=None)
        if won is None:
            self._trials = [trial for trial in tried if trial.is_open]
            return None
        self._before, self._now = self._now, won.factors
        self._trials, self._last, self._is_fresh = [], None, won.reason == CHANGED
        factors = zip(numbers_of(self._base), self._now.tolist(), strict=True)
        summary = ", ".join(f"{name} x{factor:.2f}" for name, factor in factors)
        update = update_of(self._base, self._now)
        return Decision(update, won.reason, won.share, f"{summary} ({won.reason})")

    def _search(self, segment: Segment) -> list[Trial]:
        """The colony's best, the base, and what was in force before."""
        space = space_around(self._base, self._now)

        def evaluate(factors: Floats) -> Floats:
            return np.array([cost_on(self._by(row), segment).mean() for row in factors])

        back = [self._before, np.ones(len(self._now))]
        known = [tuple(each.tolist()) for each in (self._now, *back, *self._kept)]
        first = np.array([*dict.fromkeys(known)][:FOOD_SOURCES])
        options = SearchOptions("abc", FOOD_SOURCES, CYCLES, FOOD_SOURCES * len(space), seed=0)
        search = Search(space, options, evaluate)
        self._kept = decode(space, self._look(search, encode(space, first), self._generator))
        candidates = [Trial(search.best_values, CHANGED), *(Trial(each, BACK) for each in back)]
        return [each for each in candidates if np.any(each.factors != self._now)]

    def _by(self, factors: Floats) -> Profile:
        return merge_profile(self._base, update_of(self._base, factors))


class RetunedEstimator(LoggedEstimator):
    """Retuned on the spot every five seconds of the vehicle's time, or by ``on_segment``.

    A segment ends early, and is dropped, when somebody replaces the profile.
    """

    def __init__(
        self,
        profile: Profile,
        fixed_gain: float | None = None,
        on_segment: Callable[[Segment], object] | None = None,
        retuner: Retuner | None = None,
    ) -> None:
        super().__init__(profile, fixed_gain)
        self.retuner = Retuner(profile) if retuner is None else retuner
        self.decisions: list[tuple[int, Decision]] = []  # with the vehicle's times, us
        self._on_segment = on_segment or self._decide

    def begin_log(self) -> None:
        """See :class:`LoggedEstimator`: a segment begins."""
        super().begin_log()
        self._before = self.snapshot
        self._samples: list[ImuSample] = []

    def update(self, sample: ImuSample) -> Reason | None:
        """See :class:`Estimator`."""
        reason = super().update(sample)
        if reason is None:
            self._samples.append(sample)
            if sample.time_us - self._samples[0].time_us >= 1e6 * SEGMENT_S:
                now = self._before, self.profile, tuple(self._samples), self.calls
                segment = Segment(*now, self.fixed_gain)
                self.begin_log()
                self._on_segment(segment)
        return reason

    def replace_profile(self, profile: Profile) -> None:
        """See :class:`Estimator`. Somebody's own profile is the base from now on."""
        if profile_to_json(profile) != profile_to_json(self.retuner.profile):
            self.retuner = Retuner(profile)
        super().replace_profile(profile)
        self.begin_log()

    def _decide(self, segment: Segment) -> None:
        decision = self.retuner.take(segment)
        if decision is not None:
            self.decisions.append((segment.samples[-1].time_us, decision))
            self.replace_profile(self.retuner.profile)
