"""What iron in the vehicle does to its compass, from a flight and the World Magnetic Model.

S (m - b) is to have the model's strength and, along the vertical that the estimate knows, the
model's vertical part. Headings are not asked: they may come from that compass. b is the hard iron,
the symmetric S the soft iron, which is taken only if it says more of stretches left out, by more
than one standard error of that. So is c I, the field of the battery's current I, where that is
known.
"""

from itertools import permutations, product
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from estimator.arrays import Floats
from estimator.geometry.earth import PlaceField

BLOCKS = 10  # stretches of time that are left out in turn
MOST_SAMPLES = 1000
MODEL_GAUSS = 1.5e-3  # sigma of the model beside a place: its report says 138 nT, 0.2 deg of dip
MOST_STEPS = 30  # of a solution; 10 are usual, without turns there is no end
SURE = 3.0  # sigma
NEAR = np.cos(np.pi / 4)
LEAST_CURRENT_A = 1.0  # between the least and the largest: less shows nothing
NORMAL = 1.4826  # sigma of a normal variable over its median size
SIDES = ("nose", "right", "bottom", "tail", "left", "top")
# S in its six numbers
_I, _J = np.triu_indices(3)
BASIS = np.zeros((6, 3, 3))
BASIS[range(6), _I, _J] = BASIS[range(6), _J, _I] = 1.0
PLAIN = (_I == _J).astype(float)

LEAST_READINGS = 50
# A right angle moves the field's horizontal part by more than this share of its strength where the
# vehicle turns; less shows nothing, and is iron.
LEAST_MISFIT = 0.15
CLEAR = 0.5  # of the misfit of any other way, at most

# The signed permutations of axes; as given first.
TURNS: Floats = np.array(
    [
        np.diag(signs) @ np.eye(3)[list(order)]
        for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3))
    ]
)
RIGHT_ANGLED: Floats = TURNS[np.linalg.det(TURNS) > 0.0]  # the first turns nothing


class CompassFit(NamedTuple):
    """The iron found: m_true = matrix (m - offset); gauss, body axes.

    ``matrix`` is None where the turns do not show it. ``unseen`` names the sides of the vehicle
    that the field has never come within 45 deg of. ``misfit_gauss`` is the median misfit
    before and after.
    """

    offset_gauss: Floats  # (3,)
    offset_covariance: Floats  # (3, 3)
    current_gauss_a: Floats | None  # (3,) for each ampere; None where it shows nothing
    current_sigma_gauss_a: Floats | None  # (3,)
    matrix: Floats | None  # (3, 3)
    matrix_sigma: Floats | None  # (3, 3)
    unseen: tuple[str, ...]
    misfit_gauss: tuple[float, float]


class _Problem(NamedTuple):
    """Readings (N, 3), the vertical in body axes (N, 3), and what the place has."""

    mag: Floats
    down: Floats
    field: PlaceField
    current: Floats  # (N, 1), a share of the largest; (N, 0) where it does not count
    scale: float  # the usual misfit, gauss

    def misfit(self, p: Floats) -> Floats:
        """Of strength and vertical part, (2N,) gauss, as an error of the reading.

        Divided by how far a reading's own noise moves it, or noise would pay for a smaller S.
        """
        s, place = self.matrix(p), self.field
        v = self.corrected(p)
        size = np.maximum(np.linalg.norm(v, axis=1), 1e-12)
        strength = (size - place.strength_gauss) / np.linalg.norm(v @ s / size[:, None], axis=1)
        vertical = (v * self.down).sum(1) - place.strength_gauss * np.sin(place.dip_rad)
        return np.concatenate([strength, vertical / np.linalg.norm(self.down @ s, axis=1)])

    def usual_misfit(self, p: Floats) -> float:
        """The median, gauss."""
        return float(np.median(np.abs(self.misfit(p))))

    def corrected(self, p: Floats) -> Floats:
        """S (m - b - c I), (N, 3)."""
        own = p[:3] + self.current @ p[3 : self.irons].reshape(-1, 3)
        return (self.mag - own) @ self.matrix(p)  # S is symmetric

    @property
    def irons(self) -> int:
        """How many of the numbers are b and c."""
        columns: int = self.current.shape[1]
        return 3 + 3 * columns

    def matrix(self, p: Floats) -> Floats:
        """S, (3, 3)."""
        return np.asarray(np.tensordot(p[self.irons :] if len(p) > self.irons else PLAIN, BASIS, 1))

    def part(self, chosen: Floats) -> "_Problem":
        """The samples chosen alone."""
        readings = {name: getattr(self, name)[chosen] for name in ("mag", "down", "current")}
        return self._replace(**readings)

    def solved(self, start: Floats) -> Any:
        """SciPy's result: numbers ``x``, and derivatives ``jac`` times the roots of the weights."""
        robust = {"loss": "soft_l1", "f_scale": self.scale}
        return least_squares(self.misfit, start, **robust, max_nfev=MOST_STEPS)


def fit_compass(
    mag_gauss: Floats, down: Floats, field: PlaceField, current_a: Floats | None = None
) -> CompassFit | None:
    """The iron in readings (N, 3) in order of time; None where turns show no offset.

    ``down`` (N, 3) is the vertical in body axes, a unit vector; ``current_a`` (N,) the battery's.
    """
    # two readings of one field are at most twice its strength apart
    apart = np.linalg.norm(mag_gauss - np.median(mag_gauss, axis=0), axis=1)
    near = np.flatnonzero(apart <= 2.0 * field.strength_gauss)
    near = near[:: -(-len(near) // MOST_SAMPLES) or 1]
    none = np.zeros((len(near), 0))
    problem = _Problem(mag_gauss[near], down[near], field, none, field.strength_gauss)
    if len(near) < BLOCKS:
        return None
    hard = np.zeros(3)
    for _ in range(2):  # the usual misfit is known after a first time
        hard = problem.solved(hard).x
        problem = problem._replace(scale=max(NORMAL * problem.usual_misfit(hard), 1e-6))
    found = _solution(problem, hard)
    if found.is_vague:
        return None
    current = np.zeros((len(near), 1)) if current_a is None else current_a[near, None]
    largest_a = float(np.ptp(current))
    if largest_a > LEAST_CURRENT_A:
        found = _better(found, problem._replace(current=current / largest_a), np.zeros(3))
    problem, p, covariance, _ = _better(found, found.problem, PLAIN)
    irons, sigma = problem.irons, np.sqrt(np.diag(covariance))
    has_current, has_matrix = irons > 3, len(p) > irons
    seen = problem.corrected(p)
    unit = seen / np.maximum(np.linalg.norm(seen, axis=1), 1e-12)[:, None]
    nearest = np.concatenate([unit.max(0), -unit.min(0)])
    return CompassFit(
        p[:3],
        covariance[:3, :3],
        p[3:6] / largest_a if has_current else None,
        sigma[3:6] / largest_a if has_current else None,
        problem.matrix(p) if has_matrix else None,
        np.tensordot(sigma[irons:], BASIS, 1) if has_matrix else None,
        tuple(side for side, cosine in zip(SIDES, nearest, strict=True) if cosine < NEAR),
        (problem.usual_misfit(np.zeros(irons)), problem.usual_misfit(p)),
    )


class _Solution(NamedTuple):
    """The numbers found, their covariance, and the loss on each block by all others."""

    problem: _Problem
    p: Floats
    covariance: Floats
    losses: Floats

    @property
    def is_vague(self) -> bool:
        """Whether a heading by that offset may be off by 45 deg."""
        field, worst = self.problem.field, np.linalg.eigvalsh(self.covariance[:3, :3])[-1]
        return bool(SURE**2 * worst > (field.strength_gauss * np.cos(field.dip_rad)) ** 2)


def _solution(problem: _Problem, start: Floats) -> _Solution:
    """The solution with the jackknife's covariance, as samples near in time err alike.

    What the turns do not show at all is added: for that a stretch of time counts as one reading,
    no better than the model is, and before the flight an offset is supposed within the field's
    strength, S within one of identity.
    """
    n, scale = len(problem.mag), problem.scale
    block, found = np.arange(n) * BLOCKS // n, problem.solved(start)
    others = np.array([problem.part(block != k).solved(found.x).x for k in range(BLOCKS)])
    left = [problem.part(block == k).misfit(other) for k, other in enumerate(others)]
    losses = np.array([np.sqrt(1.0 + (each / scale) ** 2).mean() for each in left])
    apart = others - others.mean(0)
    jackknife = (BLOCKS - 1) / BLOCKS * apart.T @ apart
    supposed = np.ones(len(found.x))
    supposed[: problem.irons] = problem.field.strength_gauss
    weight = BLOCKS / n / max(scale, MODEL_GAUSS) ** 2
    shown = weight * found.jac.T @ found.jac + np.diag(supposed**-2.0)
    return _Solution(problem, found.x, jackknife + np.linalg.inv(shown), losses)


def _better(simple: _Solution, problem: _Problem, more: Floats) -> _Solution:
    """The solution with more numbers, if they reduce the losses and leave the offset known.

    Losses on blocks left out have to fall by more than one standard error of that.
    """
    rich = _solution(problem, np.concatenate([simple.p, more]))
    gains = simple.losses - rich.losses
    is_better = gains.mean() > gains.std(ddof=1) / np.sqrt(BLOCKS)
    return rich if is_better and not rich.is_vague else simple


def compass_turn(mag_gauss: Floats, expected_gauss: Floats) -> Floats | None:
    """The rotation (3, 3) that takes readings (N, 3) into the body's axes; None for none.

    ``expected_gauss`` (N, 3) is the place's field in the body's axes by an attitude whose heading
    the compass has not shown. A constant offset is left to the search for iron.
    """
    if len(mag_gauss) < LEAST_READINGS:
        return None
    misfits = np.array([_apart(mag_gauss, expected_gauss @ R) for R in RIGHT_ANGLED])
    best, second = (int(k) for k in np.argsort(misfits)[:2])
    strength = float(np.median(np.linalg.norm(expected_gauss, axis=1)))
    is_clear = misfits[best] < CLEAR * misfits[second]
    if best == 0 or not is_clear or misfits[0] < LEAST_MISFIT * strength:
        return None
    return np.asarray(RIGHT_ANGLED[best])


def _apart(mag: Floats, seen: Floats) -> float:
    """Median distance between readings and what would be seen, beyond a constant offset."""
    off = mag - seen
    return float(np.median(np.linalg.norm(off - np.median(off, axis=0), axis=1)))
