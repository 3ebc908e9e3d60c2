"""What iron in the vehicle does to its compass, from a flight and the World Magnetic Model.

S (m - b) is to have the model's strength and, along the vertical that the estimate knows, the
model's vertical part. Headings are not asked: they may come from that compass. b is the hard iron,
the symmetric S the soft iron, which is taken only if it says more of stretches left out, by more
than one standard error of that. So is c I, the field of the battery's current I, where that is
known.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
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
BASIS = np.zeros((6, 3, 3))
for _k, (_i, _j) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
    BASIS[_k, _i, _j] = BASIS[_k, _j, _i] = 1.0
PLAIN = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])


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
        matrix: Floats = np.tensordot(p[self.irons :] if len(p) > self.irons else PLAIN, BASIS, 1)
        return matrix

    def part(self, chosen: Floats) -> "_Problem":
        """The samples chosen alone."""
        readings = (self.mag[chosen], self.down[chosen])
        return _Problem(*readings, self.field, self.current[chosen])


def fit_compass(
    mag_gauss: Floats, down: Floats, field: PlaceField, current_a: Floats | None = None
) -> CompassFit | None:
    """The iron in readings (N, 3) in order of time; None where turns show no offset.

    ``down`` (N, 3) is the vertical in body axes, a unit vector; ``current_a`` (N,) the battery's.
    """
    # two readings of one field are at most twice its strength apart
    apart = np.linalg.norm(mag_gauss - np.median(mag_gauss, axis=0), axis=1)
    near = apart <= 2.0 * field.strength_gauss
    step = -(-int(near.sum()) // MOST_SAMPLES) or 1
    none = np.zeros((-(-int(near.sum()) // step), 0))
    problem = _Problem(mag_gauss[near][::step], down[near][::step], field, none)
    if len(problem.mag) < BLOCKS:
        return None
    block = np.arange(len(problem.mag)) * BLOCKS // len(problem.mag)
    scale = field.strength_gauss
    hard = np.zeros(3)
    for _ in range(2):  # what is usual is known after a first time
        hard = _solved(problem, hard, scale)
        scale = max(NORMAL * _usual(problem.misfit(hard)), 1e-6)
    (p, others), loss = _left_out(problem, block, hard, scale)
    covariance = _covariance(problem, p, others, scale)
    if _is_vague(covariance, field):
        return None
    largest_a = 0.0
    if current_a is not None:
        current = current_a[near][::step, None]
        largest_a = float(np.ptp(current))
    if largest_a > LEAST_CURRENT_A:
        powered = problem._replace(current=current / largest_a)
        start = np.concatenate([p, np.zeros(3)])
        (with_c, c_others), c_loss = _left_out(powered, block, start, scale)
        c_covariance = _covariance(powered, with_c, c_others, scale)
        if _says_more(c_loss, loss) and not _is_vague(c_covariance, field):
            problem, p, loss, covariance = powered, with_c, c_loss, c_covariance
    (soft, others), soft_loss = _left_out(problem, block, np.concatenate([p, PLAIN]), scale)
    soft_covariance = _covariance(problem, soft, others, scale)
    shows_matrix = _says_more(soft_loss, loss) and not _is_vague(soft_covariance, field)
    sigma = np.sqrt(np.diag(soft_covariance))[problem.irons :]
    if shows_matrix:
        p, covariance = soft, soft_covariance
    return CompassFit(
        p[:3],
        covariance[:3, :3],
        p[3:6] / largest_a if problem.irons > 3 else None,
        np.sqrt(np.diag(covariance))[3:6] / largest_a if problem.irons > 3 else None,
        problem.matrix(p) if shows_matrix else None,
        np.tensordot(sigma, BASIS, 1) if shows_matrix else None,
        _unseen(problem.corrected(p)),
        (_usual(problem.misfit(np.zeros(problem.irons))), _usual(problem.misfit(p))),
    )


def _solved(problem: _Problem, start: Floats, scale: float) -> Floats:
    found: Floats = least_squares(
        problem.misfit, start, loss="soft_l1", f_scale=scale, max_nfev=MOST_STEPS
    ).x
    return found


def _slope(problem: _Problem, p: Floats) -> Floats:
    """The misfit's derivatives, (2N, len(p))."""
    step = 1e-6
    ways = step * np.eye(len(p))
    columns = [problem.misfit(p + way) - problem.misfit(p - way) for way in ways]
    return np.column_stack(columns) / (2.0 * step)


def _left_out(
    problem: _Problem, block: NDArray[np.int_], start: Floats, scale: float
) -> tuple[tuple[Floats, Floats], Floats]:
    """The solution, those without each block in turn, and their losses on the blocks left out."""
    p = _solved(problem, start, scale)
    others = np.array([_solved(problem.part(block != k), p, scale) for k in range(BLOCKS)])
    left = [problem.part(block == k).misfit(other) for k, other in enumerate(others)]
    return (p, others), np.array([np.sqrt(1.0 + (each / scale) ** 2).mean() for each in left])


def _says_more(after: Floats, before: Floats) -> bool:
    """Whether losses on blocks left out have fallen by more than one standard error of that."""
    gains = before - after
    return bool(gains.mean() > gains.std(ddof=1) / np.sqrt(BLOCKS))


def _covariance(problem: _Problem, p: Floats, others: Floats, scale: float) -> Floats:
    """The jackknife's (samples near in time err alike), and what the turns do not show at all.

    For that a stretch of time counts as one reading, no better than the model is.

    Before the flight an offset is supposed within the field's strength, S within one of identity.
    """
    apart = others - others.mean(0)
    jackknife = (BLOCKS - 1) / BLOCKS * apart.T @ apart
    slope = _slope(problem, p)
    weight = 1.0 / np.sqrt(1.0 + (problem.misfit(p) / scale) ** 2) / max(scale, MODEL_GAUSS) ** 2
    weight *= BLOCKS / len(problem.mag)
    supposed = np.ones(len(p))
    supposed[: problem.irons] = problem.field.strength_gauss
    shown = (slope * weight[:, None]).T @ slope + np.diag(supposed**-2.0)
    covariance: Floats = jackknife + np.linalg.inv(shown)
    return covariance


def _is_vague(covariance: Floats, field: PlaceField) -> bool:
    """Whether a heading by that offset may be off by 45 deg."""
    worst = np.linalg.eigvalsh(covariance[:3, :3])[-1]
    return bool(SURE**2 * worst > (field.strength_gauss * np.cos(field.dip_rad)) ** 2)


def _unseen(field: Floats) -> tuple[str, ...]:
    unit = field / np.maximum(np.linalg.norm(field, axis=1), 1e-12)[:, None]
    nearest = np.concatenate([unit.max(0), -unit.min(0)])
    return tuple(side for side, cosine in zip(SIDES, nearest, strict=True) if cosine < NEAR)


def _usual(misfit: Floats) -> float:
    return float(np.median(np.abs(misfit)))
