"""The paper's filter by itself, on vectors of one's own, with the paper's names.

Every step is a function of :mod:`estimator.filter.reference`, which is what the live filter is
tested against; equations are cited there by number and label.
"""

from collections.abc import Callable
from copy import copy
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from estimator.errors import InputError
from estimator.filter import kernel, reference
from estimator.filter.alignment import quaternion_from_matrix
from estimator.filter.types import FilterState
from estimator.live.settings import settings_of
from estimator.profile import Profile
from estimator.types import Floats
from fuzzbee.arguments import array, gain_of, number, profile_of, rotation, vector

if TYPE_CHECKING:
    from skfuzzy.control import ControlSystem

FLAT = 1e-9  # the least eigenvalue of M as a share of the largest: vectors span no space
Gain = Callable[[float, float], float]


class PaperFilter:
    """Eq. (12), "Attit_Filter": n vectors known in the inertial frame, and a gyroscope.

    ``R_hat`` (3, 3) takes body vectors to the inertial frame, ``b_hat`` (3,) is the gyroscope's
    bias in rad/s, ``e`` the measured |R~|_I (0 to 1), ``e_rate`` its filtered
    derivative in 1/s and ``K`` the gain of the last step.

    Args:
        v_I: the vectors in the inertial frame (n, 3), n at least 2; with two their cross product
            is the third, as in the paper.
        s: their confidences (n,), or (n + 1,) with that of the cross product; all 1 if not given.
        R_hat: the first attitude (3, 3).
        gain: a fixed K, a function of e and its rate, "noise" (rules in noise that is measured on
            the first two vectors), or None: the paper's fuzzy controller.
        profile: the rest of the numbers, among them k1..k22.

    Raises:
        InputError: shapes that do not fit, or vectors that fix no attitude.
    """

    def __init__(
        self,
        v_I: ArrayLike,
        s: ArrayLike | None = None,
        R_hat: ArrayLike | None = None,
        *,
        gain: float | Gain | Literal["noise"] | None = None,
        profile: Profile | str = "paper",
    ) -> None:
        self.params = settings_of(profile_of(profile), None).filter
        vectors = array("v_I", v_I, None, 3)
        self._count, self._v_I = len(vectors), _with_cross(_unit(vectors))
        weights = np.ones(self._count) if s is None else array("s", s)
        if weights.shape == (self._count,) != (len(self._v_I),):
            weights = np.append(weights, 1.0)
        if weights.shape != (len(self._v_I),) or not ((weights > 0.0) & (weights < np.inf)).all():
            raise InputError(f"s: must be {self._count} confidences above 0, not {s!r:.60}")
        self._s = weights
        eigenvalues = np.linalg.eigvalsh((self._v_I.T * weights) @ self._v_I)
        if eigenvalues[0] < FLAT * eigenvalues[-1]:
            raise InputError("v_I: these vectors fix no attitude: they lie in a plane or on a line")
        by_rules = gain is None or callable(gain) or (isinstance(gain, str) and gain == "noise")
        self._gain = gain if by_rules else gain_of("gain", gain)
        start = () if R_hat is None else (quaternion_from_matrix(rotation("R_hat", R_hat)),)
        self._first = self._state = FilterState(*start)

    def reset(self) -> None:
        """Begin anew at the first attitude, without a bias."""
        self._state = self._first

    def copy(self) -> "PaperFilter":
        """Another one that goes on from here by itself; pickle and deepcopy make one, too."""
        return copy(self)  # what steps change is replaced whole

    @property
    def R_hat(self) -> Floats:  # noqa: N802 - the paper's
        """The attitude (3, 3)."""
        return reference.rotation_matrix(self._state.q_ned_frd)

    @property
    def b_hat(self) -> Floats:
        """The gyroscope's bias (3,) in rad/s."""
        return np.array(self._state.gyr_bias_rad_s)

    @property
    def e(self) -> float:
        """The distance between the frames as measured, 0 to 1."""
        return self._state.error

    @property
    def e_rate(self) -> float:
        """Its filtered derivative, 1/s."""
        return self._state.error_rate_1_s

    @property
    def K(self) -> float:  # noqa: N802
        """The gain of the last step."""
        return self._state.gain

    def step(self, Omega_m: ArrayLike, v_B: ArrayLike, dt: float) -> Floats:
        """Turn by the gyroscope (3,) in rad/s over ``dt`` s, correct by vectors (n, 3); R_hat.

        Raises:
            InputError: shapes that do not fit, vectors of no length, a rate or a time that is no
                number, or a gain out of its range.
        """
        dt = number("dt", dt, 0.0, of=" of seconds")
        rate = vector("Omega_m", Omega_m)
        if not np.isfinite(rate).all():
            raise InputError(f"Omega_m: must be three finite numbers, not {rate}")
        state = reference.propagate(self._state, rate, dt)
        measured = _with_cross(_unit(array("v_B", v_B, self._count, 3)))
        estimated = self._v_I @ reference.rotation_matrix(state.q_ned_frd)  # Eq. (10)
        w = reference.innovation(measured, estimated, self._s)  # Eq. (11)
        if self._gain == "noise":
            knows = self.params, state, measured, estimated, self._s, dt
            state, e, d, K = reference.gain_in_noise(*knows)
        else:
            e = reference.attitude_error(measured, estimated, self._s)
            d = reference.error_rate(self.params, state, e, dt)
            asked = self.fuzzy_gain if self._gain is None else self._gain
            K = gain_of("gain", asked(e, d) if callable(asked) else asked)
        largest = reference.largest_rate(measured, self._s)
        self._state = reference.moved(self.params, state, w, largest, e, d, K, dt)
        return self.R_hat

    def fuzzy_gain(self, e: float, e_rate: float) -> float:
        """K = 1 + k_op of the paper's controller alone; over a grid it is its surface."""
        return float(kernel.adaptive_gain(self.params, e, e_rate))

    def controller(self, points: int = 1001) -> "ControlSystem":
        """The same controller as scikit-fuzzy's: :func:`fuzzbee.controller.control_system`."""
        from fuzzbee.controller import control_system

        return control_system(self.params.memberships, points)


def _unit(vectors: Floats) -> Floats:
    sizes = np.linalg.norm(vectors, axis=1, keepdims=True)
    if not (np.isfinite(sizes).all() and (sizes > 0.0).all()):
        raise InputError("vectors must be finite and of some length")
    return np.asarray(vectors / sizes)


def _with_cross(vectors: Floats) -> Floats:
    """Two vectors and their normal; more as they are."""
    if len(vectors) != 2:
        return vectors
    return np.vstack((vectors, _unit(np.cross(vectors[:1], vectors[1:]))))
