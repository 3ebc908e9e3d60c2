"""A recording's trajectory, and how it and the constants explain what was read.

A node has errors of its attitude (R exp [turn]x), velocity and place. Residuals of a span, three
numbers each: its turn, its push, its way, the field at its begin, and how far the place is from
the middle, where no velocity is reported.
"""

import numpy as np
from scipy.linalg import solveh_banded
from scipy.spatial.transform import Rotation

from estimator.types import STANDARD_GRAVITY_M_S2, Floats, Ints
from tuning.calibration.spans import (
    CONSTANTS,
    GYR,
    SPAN_S,
    Recording,
    cross_matrix,
    rotation,
    spans_of,
    times,
)

NODE = 9
BOTH = 2 * NODE  # of a span: the nodes at its begin and its end
# Behind the constants: the place's field beside that supposed, lags of velocity, accelerometer and
# compass behind the gyroscope.
OWN = 6
OWN_FIELD, VELOCITY_LAG, ACC_LAG, MAG_LAG = slice(0, 3), 3, 4, 5
SHOWN = CONSTANTS + OWN  # numbers that a recording shows
COLUMNS = BOTH + SHOWN
TURN, PUSH, WAY, FIELD, PLACE, VELOCITY = range(6)
KINDS = 5  # of a span; velocities stand alone
GRAVITY_NED = np.array([0.0, 0.0, STANDARD_GRAVITY_M_S2])

# Sigmas that a recording's own numbers have before it is read
LAGS_S, KNOWN_FIELD = (0.15, 0.01, 0.02), 0.03
FOREIGN = 6.0  # sigma: a field further from its place's shows nothing of the compass
# Sigmas of residuals at first, and the least later: rad, m/s, m, share of the field, m, m/s
FIRST = (2e-3, 0.05, 0.03, 0.03, 1.0, 0.3)
LEAST = (1e-3, 0.01, 0.01, 0.01, 1.0, 0.05)
TOO_GOOD = 0.1  # of the least: no reading is better, and the equations could not be solved
ROBUST = 2.0  # sigma: what is further off counts less and less (Cauchy)
LONGEST_ALIKE_S = 5.0  # for so long a residual may be like the one before
# What keeps a node that nothing shows where it is: 1 over the square of rad, m/s and m
HELD = np.array([1.0] * 3 + [1e-4] * 3 + [1e-6] * 3)


class Trajectory:
    """The nodes of a recording, its constants ``x`` (36,) and its own numbers.

    ``has_rates`` is whether a velocity is known, ``is_heard`` whether the compass counts.
    """

    def __init__(self, recording: Recording) -> None:
        self._recording, time_s = recording, recording.time_s
        step = max(1, round(SPAN_S / max(float(np.median(np.diff(time_s))), 1e-6)))
        self._rows = np.arange(0, len(time_s), step)
        q = recording.q_ned_frd[self._rows]
        self._R: Floats = Rotation.from_quat(np.roll(q, -1, axis=1)).as_matrix()
        self._times_s = time_s[self._rows]
        self.has_rates = len(recording.velocity_time_s) > 0
        self._v, self._p = np.zeros((2, len(q), 3))
        if self.has_rates:
            for own, reported in zip(self._v.T, recording.velocity_ned_m_s.T, strict=True):
                own[:] = np.interp(self._times_s, recording.velocity_time_s, reported)
        self.x, self._own = np.zeros(CONSTANTS), np.zeros(OWN)
        self.linearise()
        seen = times(self._R[:-1], self._spans.field)[self._spans.has_field]
        self.field_ned_gauss = np.median(seen, axis=0) if len(seen) else np.zeros(3)
        if recording.field_ned_gauss is not None:
            self.field_ned_gauss = recording.field_ned_gauss
        self.strength_gauss = max(float(np.linalg.norm(self.field_ned_gauss)), 1e-6)
        share = 1.0 if recording.field_ned_gauss is None else KNOWN_FIELD
        self._own_sigma = np.array([share * self.strength_gauss] * 3 + [*LAGS_S])
        self.is_heard = True
        of_field = np.where(np.arange(len(FIRST)) == FIELD, self.strength_gauss, 1.0)
        self._variance = (np.array(FIRST) * of_field) ** 2  # of one that stands alone
        self._seen = self._variance.copy()
        self._sizes, self._least = np.sqrt(self._variance), np.array(LEAST) * of_field

    @property
    def lags_s(self) -> Floats:
        """Of velocity, accelerometer and compass, (3,)."""
        return self._own[VELOCITY_LAG:]

    @property
    def field_misfit(self) -> float | None:
        """Of the field, as a share of its strength; None if no compass counts."""
        is_read = self.is_heard and self._spans.has_field.any()
        return float(self._sizes[FIELD]) / self.strength_gauss if is_read else None

    def leave_foreign_field(self) -> None:
        """Leave out a field that is none of the place: iron all around has turned it."""
        off = self._own[OWN_FIELD] / self._own_sigma[OWN_FIELD]
        self.is_heard = bool(np.linalg.norm(off) <= FOREIGN)

    def linearise(self) -> None:
        """Sum up the readings anew, by the constants as they are now."""
        self._summed_x = self.x
        self._spans = spans_of(self._recording, self._rows, self.x)

    def normal_equations(self) -> tuple[Floats, Floats]:
        """Matrix (42, 42) and gradient (42,) of constants and own numbers, the nodes eliminated."""
        H, g = self._squares()
        n = NODE * len(self._R)
        nodes = np.zeros((len(self._R), NODE, NODE)) + np.diag(HELD)
        nodes[:-1] += H[:, :NODE, :NODE]
        nodes[1:] += H[:, NODE:BOTH, NODE:BOTH]
        band = np.zeros((BOTH, n))  # in the lower form: row i - j, column j
        for i, j in np.ndindex(NODE, NODE):
            if j <= i:
                band[i - j, j::NODE] = nodes[:, i, j]
            band[NODE + i - j, j:-NODE:NODE] = H[:, NODE + i, j]
        rest = np.zeros((len(self._R), NODE, SHOWN + 1))
        for part, at in ((rest[:-1], slice(0, NODE)), (rest[1:], slice(NODE, BOTH))):
            part[:, :, :-1] += H[:, at, BOTH:]
            part[:, :, -1] += g[:, at]
        coupled: Floats = rest.reshape(n, -1)
        self._solved = solveh_banded(band, coupled, lower=True)
        eliminated = coupled[:, :-1].T @ self._solved
        normal = H[:, BOTH:, BOTH:].sum(axis=0) - eliminated[:, :-1]
        gradient = g[:, BOTH:].sum(axis=0) - eliminated[:, -1]
        normal[CONSTANTS:, CONSTANTS:] += np.diag(self._own_sigma**-2)
        gradient[CONSTANTS:] += self._own / self._own_sigma**2
        return normal, gradient

    def move(self, step: Floats) -> None:
        """Move by a step (42,) of constants and own numbers, the nodes as these ask."""
        nodes = -(self._solved[:, -1] + self._solved[:, :-1] @ step).reshape(-1, NODE)
        self._R = self._R @ rotation(nodes[:, :3])
        self._v, self._p = self._v + nodes[:, 3:6], self._p + nodes[:, 6:]
        self.x, self._own = self.x + step[:CONSTANTS], self._own + step[CONSTANTS:]

    def learn_sigmas(self) -> None:
        """How far readings are off, by what is left of them, and for how long alike."""
        r, _ = self._residuals()
        whole, velocity_s = self._spans.is_whole, self._recording.velocity_time_s
        shown = {kind: (r[whole, kind], SPAN_S) for kind in (TURN, PUSH, WAY)}
        shown[FIELD] = r[self._spans.has_field, FIELD], SPAN_S
        if self.has_rates:
            shown[VELOCITY] = self._velocity_residuals()[1], float(np.median(np.diff(velocity_s)))
        for kind, (left, step_s) in shown.items():
            if len(left):
                self._sizes[kind], self._seen[kind] = _learnt(left, step_s)
        self._seen = np.maximum(self._seen, (TOO_GOOD * self._least) ** 2)
        self._variance = np.maximum(self._seen, self._least**2)
        self._sizes[:KINDS] *= np.sqrt(self._variance / self._seen)[:KINDS]

    def believe_sigmas(self) -> None:
        """Weigh readings by what is seen of their errors, however small: for sigmas alone."""
        self._variance = self._seen

    def _squares(self) -> tuple[Floats, Floats]:
        """J^T W J (K, COLUMNS, COLUMNS) and J^T W r (K, COLUMNS) of all residuals of a span."""
        r, J = self._residuals()
        k = len(r)
        weighted = (J * self._weights(r)[:, :, None, None]).reshape(k, -1, COLUMNS)
        weighted = np.swapaxes(weighted, 1, 2)
        H = weighted @ J.reshape(k, -1, COLUMNS)
        g = times(weighted, r.reshape(k, -1))
        if self.has_rates:
            at, r, J = self._velocity_residuals()
            w = _robust(r / self._sizes[VELOCITY]) / self._variance[VELOCITY]
            weighted = np.swapaxes(J, 1, 2) * w[:, None, None]
            np.add.at(H, at, weighted @ J)
            np.add.at(g, at, times(weighted, r))
        return H, g

    def _weights(self, r: Floats) -> Floats:
        """One over the variance (K, 5)."""
        w = _robust(r / self._sizes[:KINDS, None]) / self._variance[:KINDS]
        w[:, :PLACE] *= self._spans.is_whole[:, None]
        w[:, FIELD] *= self._spans.has_field & self.is_heard
        w[:, PLACE] *= not self.has_rates
        return np.asarray(w)

    def _residuals(self) -> tuple[Floats, Floats]:
        """Of all spans (K, 5, 3), and their derivatives (K, 5, 3, COLUMNS)."""
        s, v, p, one = self._spans, self._v, self._p, np.eye(3)
        x, dt = self.x, s.lasts_s[:, None]
        d = x - self._summed_x
        back = np.swapaxes(self._R[:-1], 1, 2)
        k = len(back)
        r, J = np.zeros((k, KINDS, 3)), np.zeros((k, KINDS, 3, COLUMNS))
        of_x, own = J[..., BOTH : BOTH + CONSTANTS], J[..., BOTH + CONSTANTS :]
        turn = s.turn @ rotation(s.turn_by_gyr @ d[GYR])
        apart = np.swapaxes(turn, 1, 2) @ back @ self._R[1:]  # less than half a turn
        r[:, TURN] = Rotation.from_matrix(apart).as_rotvec()
        log_by = one + 0.5 * cross_matrix(r[:, TURN])  # of small rotations
        J[:, TURN, :, NODE : NODE + 3] = log_by
        J[:, TURN, :, :3] = -log_by @ np.swapaxes(self._R[1:], 1, 2) @ self._R[:-1]
        of_x[:, TURN, :, GYR] = -np.swapaxes(log_by, 1, 2) @ s.turn_by_gyr
        change = times(back, v[1:] - v[:-1] - dt * GRAVITY_NED)
        r[:, PUSH] = change - s.push - s.push_by_gyr @ d[GYR] - s.push_by_acc @ d[12:24]
        r[:, PUSH] -= s.push_by_lag * self._own[ACC_LAG]
        J[:, PUSH, :, :3] = cross_matrix(change)
        J[:, PUSH, :, 3:6], J[:, PUSH, :, NODE + 3 : NODE + 6] = -back, back
        of_x[:, PUSH, :, :12], of_x[:, PUSH, :, 12:24] = -s.push_by_gyr, -s.push_by_acc
        own[:, PUSH, :, ACC_LAG] = -s.push_by_lag
        r[:, WAY] = p[1:] - p[:-1] - 0.5 * dt * (v[1:] + v[:-1])
        J[:, WAY, :, 6:9], J[:, WAY, :, NODE + 6 : BOTH] = -one, one
        J[:, WAY, :, 3:6] = J[:, WAY, :, NODE + 3 : NODE + 6] = -0.5 * dt[:, :, None] * one
        # of a field u a compass reads (1 + D) u + b
        u = back @ (self.field_ned_gauss + self._own[OWN_FIELD])
        by_u = one + np.einsum("kiajb,ab->kij", s.turned_twice, x[24:33].reshape(3, 3))
        by_D = np.einsum("kiajb,kj->kiab", s.turned_twice, u).reshape(k, 3, 9)
        r[:, FIELD] = u + by_D @ x[24:33] + s.turned @ x[33:] - s.field - s.field_by_gyr @ d[GYR]
        r[:, FIELD] -= s.field_by_lag * self._own[MAG_LAG]
        J[:, FIELD, :, :3] = by_u @ cross_matrix(u)
        of_x[:, FIELD, :, 24:33], of_x[:, FIELD, :, 33:] = by_D, s.turned
        of_x[:, FIELD, :, GYR] = -s.field_by_gyr
        own[:, FIELD, :, OWN_FIELD], own[:, FIELD, :, MAG_LAG] = by_u @ back, -s.field_by_lag
        r[:, PLACE], J[:, PLACE, :, 6:9] = p[:-1], one
        return r, J

    def _velocity_residuals(self) -> tuple[Ints, Floats, Floats]:
        """Spans (L,) that a velocity falls into, what it is off (L, 3), and derivatives."""
        recording, times_s = self._recording, self._times_s
        at_s = recording.velocity_time_s - self._own[VELOCITY_LAG]
        k = np.clip(np.searchsorted(times_s, at_s, side="right") - 1, 0, len(times_s) - 2)
        share = (at_s - times_s[k]) / self._spans.lasts_s[k]
        inside = (share >= 0.0) & (share <= 1.0) & self._spans.is_whole[k]
        k, late = k[inside], share[inside, None]
        early, one = 1.0 - late, np.eye(3)
        r = early * self._v[k] + late * self._v[k + 1] - recording.velocity_ned_m_s[inside]
        J = np.zeros((len(k), 3, COLUMNS))
        J[:, :, 3:6], J[:, :, NODE + 3 : NODE + 6] = early[:, :, None] * one, late[:, :, None] * one
        slope = (self._v[k + 1] - self._v[k]) / self._spans.lasts_s[k, None]
        J[:, :, BOTH + CONSTANTS + VELOCITY_LAG] = -slope
        return k, r, J


def _robust(r: Floats) -> Floats:
    """Weights (...) of residuals (..., 3) over sigma, by Cauchy's loss."""
    return np.asarray(1.0 / (1.0 + np.mean(r * r, axis=-1) / ROBUST**2))


def _learnt(r: Floats, step_s: float) -> tuple[float, float]:
    """The size of residuals in a row (N, 3), and the variance of one that would stand alone.

    The latter is the square of the size times 1 + 2 sum of autocorrelations.
    """
    size = max(1.4826 * float(np.median(np.abs(r))), 1e-6)  # sigma of normal variables
    r = np.clip(r / size, -3.0, 3.0)
    alike, power = 1.0, float(np.mean(r * r))
    for lag in range(1, min(round(LONGEST_ALIKE_S / step_s), len(r) // 4)):
        share = float(np.mean(r[lag:] * r[:-lag])) / power
        if share < 0.05:
            break
        alike += 2.0 * share
    return size, size**2 * alike
