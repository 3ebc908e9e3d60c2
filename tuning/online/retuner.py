"""When a profile is retuned, by what proof, and when that is taken back.

A pure machine: segments in, decisions out, no clock. The same segments give the same decisions, so
a log that is replayed is retuned as it would be again.

* It rests while the readings' noise is what was learnt. It starts when that has moved, and both
  segments of the window agree on what it is now; never during a silence, a pull-in or while the
  field is disturbed.
* The colony searches on the earlier segment. Its best, and the base profile, are judged on the
  later: a winner is at least 5 % cheaper than what is in force, and beyond chance.
* After a move what was in force before it is judged in the same way, and comes back if it wins.
"""

from collections.abc import Callable
from math import sqrt
from typing import NamedTuple

import numpy as np

from estimator.arrays import Floats
from estimator.profile import Profile, profile_to_json
from tuning.colony import Colony
from tuning.online.cost import Cost, cost_on
from tuning.online.noise import Noise, has_moved, is_disturbed, noise_of
from tuning.online.numbers import numbers_of, space_around, update_of, with_factors
from tuning.online.segment import Segment, rows_of_all
from tuning.prediction import readings_of
from tuning.space import Space, decode, encode

LEAST_GAIN = 0.05
# Student's t of the paired half seconds; chance exceeds it once in thirty.
LEAST_T = 2.0
# A candidate that seems to win is judged on so many segments at most, until it does beyond chance.
MOST_SEGMENTS = 4
# Half a second in which the vectors are 60 deg from what was foretold is an event, and no noise.
EVENT = 0.25
# Segments that a decision may take until it is in force.
MOST_FOREIGN = 2
# Windows without a search behind one that found nothing, and after a move that was taken back.
PATIENCE = 6
FOOD_SOURCES = 6
CYCLES = 2
# Why a candidate is one.
CHANGED, BACK = "noise has changed", "taken back"

# Segments in sequence: a candidate is found on the earlier, and judged on the later.
Window = tuple[Segment, Segment]
Evaluate = Callable[[Floats], Floats]  # factors (C, D) to costs (C,)
# Search in a space, from kept factors (M, D): what was tried, its costs, what to keep
Look = Callable[[Space, Floats, Evaluate, np.random.Generator], tuple[Floats, Floats, Floats]]


def colony_search(
    space: Space, kept: Floats, evaluate: Evaluate, generator: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Evaluate the kept food sources on the present window, and go on from them for two cycles."""
    colony = Colony(
        space,
        food_sources=FOOD_SOURCES,
        limit=FOOD_SOURCES * space.dimensions,
        generator=generator,
        first=encode(space, np.clip(kept, space.lower, space.upper)),
    )
    tried, costs = [], []
    while colony.cycles < CYCLES:
        factors = decode(space, colony.ask())
        found = evaluate(factors)
        tried.append(factors)
        costs.append(found)
        colony.tell(found)
    return np.concatenate(tried), np.concatenate(costs), decode(space, colony.sources.positions)


class Decision(NamedTuple):
    """A change of the profile in force: what it becomes, as a partial profile, and why.

    ``factors`` are what that means, by name, on the base profile's numbers; ``gain`` is the share
    of the cost that it saved where it was judged.
    """

    update: dict[str, dict[str, float]]
    reason: str
    gain: float
    factors: dict[str, float]

    @property
    def summary(self) -> str:
        """One line for a person."""
        numbers = ", ".join(f"{name} x{factor:.2f}" for name, factor in self.factors.items())
        return f"{numbers} ({self.reason})"


class Trial(NamedTuple):
    """A candidate beside what is in force, on segments that it was not searched on."""

    factors: Floats
    reason: str
    old: tuple[Cost, ...] = ()
    new: tuple[Cost, ...] = ()

    def with_costs(self, old: Cost, new: Cost) -> "Trial":
        """The trial with the costs of one more segment: in force (old) and candidate (new)."""
        return self._replace(old=(*self.old, old), new=(*self.new, new))

    @property
    def share(self) -> float:
        """The share of the cost that it saves."""
        old, new = (sum(cost.total for cost in costs) for costs in (self.old, self.new))
        return (old - new) / old if old > 0.0 else 0.0

    @property
    def _t(self) -> float:
        """Student's t of what the candidate saves, each half second compared with itself.

        The spread is that of the half seconds alone: chance does not move noise and pull-in.
        """
        old, new = (np.concatenate([c.blocks for c in costs]) for costs in (self.old, self.new))
        off = old - new
        won = float(np.mean([o.total - n.total for o, n in zip(self.old, self.new, strict=True)]))
        spread = float(np.std(off, ddof=1)) / sqrt(len(off)) if len(off) > 1 else 0.0
        return won / spread if spread > 0.0 else 0.0

    @property
    def has_won(self) -> bool:
        """Whether it is cheaper by enough, and beyond chance."""
        return self.share > LEAST_GAIN and self._t > LEAST_T

    @property
    def is_open(self) -> bool:
        """Whether more segments may decide."""
        return len(self.old) < MOST_SEGMENTS and self.share > LEAST_GAIN


class Retuner:
    """The decisions about one vehicle, from segment to segment."""

    def __init__(self, base: Profile, seed: int = 0, look: Look = colony_search) -> None:
        self._look = look
        self._generator = np.random.default_rng(seed)
        self._begin(base)

    def _begin(self, base: Profile) -> None:
        """Forget all but the base profile."""
        self._base = base
        ones = np.ones(len(numbers_of(base)))
        self._now = ones  # factors in force
        self._kept = ones[None, :]  # the colony's food sources
        self._learnt: Noise | None = None
        self._last: Segment | None = None
        self._foreign = 0  # segments in a row that another profile was in force in
        self._wait = 0
        self._trials: list[Trial] = []
        self._is_checking = False  # whether the one trial is of what was before a move

    @property
    def profile(self) -> Profile:
        """What should be in force."""
        return with_factors(self._base, self._now)

    def take(self, segment: Segment) -> Decision | None:
        """The next segment; what follows from it."""
        if profile_to_json(segment.profile) != profile_to_json(self.profile):
            self._follow(segment.profile)
            return None
        earlier, self._last = self._last, None if segment.silent else segment
        self._foreign = 0
        noise = noise_of(readings_of(rows_of_all((segment,))))
        if segment.silent or noise is None or not len(self._now):
            return None
        if self._learnt is None:
            self._learnt = noise
        if is_disturbed(self._learnt, noise):
            self._last = None
            return None
        return None if earlier is None else self._consider((earlier, segment), noise)

    def _follow(self, profile: Profile) -> None:
        """Another profile is in force: a decision has not arrived yet, or somebody has replaced it.

        Somebody's own profile is the base from now on.
        """
        self._last = None
        self._foreign += 1
        if self._foreign > MOST_FOREIGN:
            self._begin(profile)

    def _consider(self, window: Window, later: Noise) -> Decision | None:
        assert self._learnt is not None
        if not self._trials:
            self._wait = max(0, self._wait - 1)
            earlier = noise_of(readings_of(rows_of_all(window[:1])))
            is_steady = earlier is not None and not has_moved(earlier, later)
            if self._wait or not is_steady or not has_moved(self._learnt, later):
                return None
        now = self._cost(self._now, *window)
        if now.blocks.max() > EVENT:
            return None
        if not self._trials:
            self._learnt = later
            self._trials = self._search(window)
        decision = self._judge(window, now)
        if self._is_checking and not self._trials:  # the move holds, and may not go far enough
            self._is_checking = False
            self._trials = self._search(window)
            decision = self._judge(window, now)
        return decision

    def _search(self, window: Window) -> list[Trial]:
        """Candidates by the earlier segment; the later one is the first that judges them."""
        space = space_around(self._base, self._now)

        def evaluate(factors: Floats) -> Floats:
            return np.array([self._cost(row, window[0]).total for row in factors])

        base = np.ones(len(self._now))
        known = (self._now, base, *self._kept)
        first = np.array(list({tuple(row.tolist()): row for row in known}.values()))[:FOOD_SOURCES]
        tried, costs, self._kept = self._look(space, first, evaluate, self._generator)
        rivals = (tried[int(np.argmin(costs))], base)
        return [Trial(rival, CHANGED) for rival in rivals if np.any(rival != self._now)]

    def _judge(self, window: Window, now: Cost) -> Decision | None:
        """Compare each rival with what is in force, on all that it was not searched on."""
        tried = [t.with_costs(now, self._cost(t.factors, *window)) for t in self._trials]
        won = max((t for t in tried if t.has_won), key=lambda t: t.share, default=None)
        if won is not None:
            return self._move(won)
        self._trials = [trial for trial in tried if trial.is_open]
        if not self._trials and not self._is_checking:
            self._wait = PATIENCE
        return None

    def _move(self, won: Trial) -> Decision:
        """Put it in force; what was before comes back if the same proof speaks for it."""
        self._is_checking = won.reason == CHANGED
        self._trials = [Trial(self._now, BACK)] if self._is_checking else []
        self._wait = 0 if self._is_checking else PATIENCE
        self._now, self._last = won.factors, None
        return Decision(
            update=update_of(self._base, self._now),
            reason=won.reason,
            gain=won.share,
            factors=dict(zip(numbers_of(self._base), self._now.tolist(), strict=True)),
        )

    def _cost(self, factors: Floats, *segments: Segment) -> Cost:
        return cost_on(with_factors(self._base, factors), *segments)
