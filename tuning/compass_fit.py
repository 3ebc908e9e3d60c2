"""What iron in the vehicle does to its compass, from a flight and the World Magnetic Model.

S (m - b) is to have the model's strength and, along the vertical that the estimate knows, the
model's vertical part. Headings are not asked: they may come from that compass. b is the hard iron,
the symmetric S the soft iron, which is taken only if it fits stretches left out better, by more
than one standard error of that. So is c I, the field of the battery's current I, where that is
known.
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from estimator.geometry.earth import PlaceField
from estimator.types import Bools, Floats, Ints

BLOCKS, MOST_SAMPLES = 10, 1000  # stretches of time, which are left out in turn
MODEL_GAUSS = 1.5e-3  # sigma of the model beside a place: its report has 138 nT, 0.2 deg of dip
MOST_STEPS = 30  # of a solution; 10 are usual, without turns there is no end
SURE = 3.0  # sigma
NEAR = np.cos(np.pi / 4)
LEAST_CURRENT_A = 1.0  # between the least and the largest: less shows nothing
NORMAL = 1.4826  # sigma of a normal variable over its median size
SIDES = ("nose", "right", "bottom", "tail", "left", "top")
# Of the twelve numbers p: b, c, and S in its six
HARD, CURRENT, SOFT = np.split(np.arange(12), [3, 6])
_I, _J = np.triu_indices(3)
BASIS = np.zeros((6, 3, 3))
BASIS[range(6), _I, _J] = BASIS[range(6), _J, _I] = 1.0
NO_IRON = np.concatenate([np.zeros(6), _I == _J])


class CompassFit(NamedTuple):
    """The iron found: m_true = matrix (m - offset - current I); gauss, body axes.

    What the turns do not show is None.
    """

    offset_gauss: Floats  # (3,)
    offset_covariance: Floats  # (3, 3)
    current_gauss_a: Floats | None  # (3,)
    current_sigma_gauss_a: Floats | None  # (3,)
    matrix: Floats | None  # (3, 3)
    matrix_sigma: Floats | None  # (3, 3)
    unseen: tuple[str, ...]  # sides of the vehicle that the field never came within 45 deg of
    misfit_gauss: tuple[float, float]  # the median, before and after


class _Readings(NamedTuple):
    """Readings of a flight, and the field of its place."""

    mag: Floats  # (N, 3)
    down: Floats  # (N, 3), the vertical in body axes
    current: Floats  # (N, 1), a share of the largest
    field: PlaceField
    scale: float  # the usual misfit, gauss

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

    def usual_misfit(self, p: Floats) -> float:
        """The median, gauss."""
        return float(np.median(np.abs(self.misfit(p))))

    def corrected(self, p: Floats) -> Floats:
        """S (m - b - c I), (N, 3)."""
        own = p[HARD] + self.current * p[CURRENT]
        return np.asarray((self.mag - own) @ _matrix(p))  # S is symmetric

    def part(self, chosen: Bools) -> "_Readings":
        """The samples chosen alone."""
        readings = {name: getattr(self, name)[chosen] for name in ("mag", "down", "current")}
        return self._replace(**readings)

    def solved(self, free: Ints, start: Floats) -> tuple[Floats, Floats]:
        """The numbers, and derivatives by those ``free`` times the roots of the weights."""

        def whole(x: Floats) -> Floats:
            p = start.copy()
            p[free] = x
            return p

        robust = {"loss": "soft_l1", "f_scale": self.scale, "max_nfev": MOST_STEPS}
        found = least_squares(lambda x: self.misfit(whole(x)), start[free], **robust)
        return whole(found.x), found.jac


def _matrix(p: Floats) -> Floats:
    """S, (3, 3)."""
    return np.asarray(np.tensordot(p[SOFT], BASIS, 1))


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
    if len(near) < BLOCKS:
        return None
    current = np.zeros((len(near), 1)) if current_a is None else current_a[near, None]
    largest_a = float(np.ptp(current))
    has_current = largest_a > LEAST_CURRENT_A
    current = current / largest_a if has_current else np.zeros_like(current)
    readings = _Readings(mag_gauss[near], down[near], current, field, field.strength_gauss)
    p = NO_IRON
    for _ in range(2):  # the usual misfit is known after a first time
        p, _ = readings.solved(HARD, p)
        readings = readings._replace(scale=max(NORMAL * readings.usual_misfit(p), 1e-6))
    found = _solution(readings, HARD, p)
    if found.is_vague:
        return None
    for more in (CURRENT, SOFT) if has_current else (SOFT,):
        rich = _solution(readings, np.concatenate([found.free, more]), found.p)
        gains = found.losses - rich.losses
        is_better = gains.mean() > gains.std(ddof=1) / np.sqrt(BLOCKS)  # by one standard error
        found = rich if is_better and not rich.is_vague else found
    return _fit_of(readings, found, largest_a)


class _Solution(NamedTuple):
    """The numbers found, the covariance of those free, and the loss on each block by all others."""

    free: Ints
    p: Floats
    covariance: Floats
    losses: Floats
    is_vague: bool  # a heading by that offset may be off by 45 deg


def _solution(readings: _Readings, free: Ints, start: Floats) -> _Solution:
    """The solution with the jackknife's covariance, as samples near in time err alike.

    What the turns do not show at all is added: for that a stretch of time counts as one reading,
    no better than the model is, and before the flight an offset is supposed within the field's
    strength, S within one of identity.
    """
    n, scale, field = len(readings.mag), readings.scale, readings.field
    block, (p, slope) = np.arange(n) * BLOCKS // n, readings.solved(free, start)
    others = np.array([readings.part(block != k).solved(free, p)[0] for k in range(BLOCKS)])
    left = [readings.part(block == k).misfit(other) for k, other in enumerate(others)]
    losses = np.array([np.sqrt(1.0 + (each / scale) ** 2).mean() for each in left])
    apart = others.take(free, axis=1)
    apart -= apart.mean(0)
    jackknife = (BLOCKS - 1) / BLOCKS * apart.T @ apart
    supposed = np.where(np.isin(free, SOFT), 1.0, field.strength_gauss)
    weight = BLOCKS / n / max(scale, MODEL_GAUSS) ** 2
    shown = weight * slope.T @ slope + np.diag(supposed**-2.0)
    covariance = jackknife + np.linalg.inv(shown)
    worst = np.linalg.eigvalsh(covariance[:3, :3])[-1]
    is_vague = SURE**2 * worst > (field.strength_gauss * np.cos(field.dip_rad)) ** 2
    return _Solution(free, p, covariance, losses, bool(is_vague))


def _fit_of(readings: _Readings, found: _Solution, largest_a: float) -> CompassFit:
    free, p, covariance, *_ = found
    has_current, has_matrix = (np.isin(part, free).all() for part in (CURRENT, SOFT))
    sigma = np.zeros(len(p))
    sigma[free] = np.sqrt(np.diag(covariance))
    seen = readings.corrected(p)
    unit = seen / np.maximum(np.linalg.norm(seen, axis=1), 1e-12)[:, None]
    nearest = np.concatenate([unit.max(0), -unit.min(0)])
    return CompassFit(
        p[HARD],
        covariance[:3, :3],
        p[CURRENT] / largest_a if has_current else None,
        sigma[CURRENT] / largest_a if has_current else None,
        _matrix(p) if has_matrix else None,
        _matrix(sigma) if has_matrix else None,
        tuple(side for side, cosine in zip(SIDES, nearest, strict=True) if cosine < NEAR),
        (readings.usual_misfit(NO_IRON), readings.usual_misfit(p)),
    )
