"""What iron in the vehicle does to its compass, from a flight and the World Magnetic Model.

S (m - b) is to have the model's strength and, along the vertical that the estimate knows, the
model's vertical part. Headings are not asked: they may come from that compass. b is the hard iron,
the symmetric S the soft iron, which is taken only if it says more of stretches left out.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from estimator.geometry.earth import PlaceField

Floats = NDArray[np.float64]

BLOCKS = 10  # stretches of time that are left out in turn
MOST_SAMPLES = 1000
MODEL_GAUSS = 1.5e-3  # sigma of the model beside a place: its report says 138 nT, 0.2 deg of dip
MOST_STEPS = 30  # of a solution; 10 are usual, without turns there is no end
SURE = 3.0  # sigma
NEAR = np.cos(np.pi / 4)
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
    matrix: Floats | None  # (3, 3)
    matrix_sigma: Floats | None  # (3, 3)
    unseen: tuple[str, ...]
    misfit_gauss: tuple[float, float]


class _Problem(NamedTuple):
    """Readings (N, 3), the vertical in body axes (N, 3), and what the place has."""

    mag: Floats
    down: Floats
    field: PlaceField

    def misfit(self, p: Floats) -> Floats:
        """Of strength and vertical part, (2N,) gauss, as an error of the reading.

        Divided by how far a reading's own noise moves it, or noise would pay for a smaller S.
        """
        s, place = _matrix(p), self.field
        v = self.corrected(p)
        size = np.maximum(np.linalg.norm(v, axis=1), 1e-12)
        strength = (size - place.strength_gauss) / np.linalg.norm(v @ s / size[:, None], axis=1)
        vertical = (v * self.down).sum(1) - place.strength_gauss * np.sin(place.dip_rad)
        return np.concatenate([strength, vertical / np.linalg.norm(self.down @ s, axis=1)])

    def corrected(self, p: Floats) -> Floats:
        """S (m - b), (N, 3)."""
        return (self.mag - p[:3]) @ _matrix(p)  # S is symmetric

    def part(self, chosen: Floats) -> "_Problem":
        """The samples chosen alone."""
        return self._replace(mag=self.mag[chosen], down=self.down[chosen])


def fit_compass(mag_gauss: Floats, down: Floats, field: PlaceField) -> CompassFit | None:
    """The iron in readings (N, 3) in order of time; None where turns show no offset.

    ``down`` (N, 3) is the vertical in body axes, a unit vector.
    """
    # two readings of one field are at most twice its strength apart
    apart = np.linalg.norm(mag_gauss - np.median(mag_gauss, axis=0), axis=1)
    near = apart <= 2.0 * field.strength_gauss
    step = -(-int(near.sum()) // MOST_SAMPLES) or 1
    problem = _Problem(mag_gauss[near][::step], down[near][::step], field)
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
    (soft, others), soft_loss = _left_out(problem, block, np.concatenate([p, PLAIN]), scale)
    soft_covariance = _covariance(problem, soft, others, scale)
    shows_matrix = soft_loss < loss and not _is_vague(soft_covariance, field)
    sigma = np.sqrt(np.diag(soft_covariance))[3:]
    if shows_matrix:
        p, covariance = soft, soft_covariance
    return CompassFit(
        p[:3],
        covariance[:3, :3],
        _matrix(p) if shows_matrix else None,
        np.tensordot(sigma, BASIS, 1) if shows_matrix else None,
        _unseen((problem.mag - p[:3]) @ _matrix(p)),
        (_usual(problem.misfit(np.zeros(3))), _usual(problem.misfit(p))),
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
) -> tuple[tuple[Floats, Floats], float]:
    """The solution, those without each block in turn, and their loss on the blocks left out."""
    p = _solved(problem, start, scale)
    others = np.array([_solved(problem.part(block != k), p, scale) for k in range(BLOCKS)])
    left = [problem.part(block == k).misfit(other) for k, other in enumerate(others)]
    return (p, others), float(np.sqrt(1.0 + (np.concatenate(left) / scale) ** 2).mean())


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
    supposed[:3] = problem.field.strength_gauss
    shown = (slope * weight[:, None]).T @ slope + np.diag(supposed**-2.0)
    covariance: Floats = jackknife + np.linalg.inv(shown)
    return covariance


def _is_vague(covariance: Floats, field: PlaceField) -> bool:
    """Whether a heading by that offset may be off by 45 deg."""
    worst = np.linalg.eigvalsh(covariance[:3, :3])[-1]
    return bool(SURE**2 * worst > (field.strength_gauss * np.cos(field.dip_rad)) ** 2)


def _matrix(p: Floats) -> Floats:
    matrix: Floats = np.tensordot(p[3:] if len(p) > 3 else PLAIN, BASIS, 1)
    return matrix


def _unseen(field: Floats) -> tuple[str, ...]:
    unit = field / np.maximum(np.linalg.norm(field, axis=1), 1e-12)[:, None]
    nearest = np.concatenate([unit.max(0), -unit.min(0)])
    return tuple(side for side, cosine in zip(SIDES, nearest, strict=True) if cosine < NEAR)


def _usual(misfit: Floats) -> float:
    return float(np.median(np.abs(misfit)))
