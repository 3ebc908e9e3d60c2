"""Parameters and state of the paper's filter, shared by its readable and its compiled form."""

from typing import NamedTuple

from estimator.filter.memberships import Memberships
from estimator.filter.noise_gain import NO_NOISE, NoiseState
from estimator.types import IDENTITY, ZERO_VEC3, Quaternion, Vec3

# Largest K lambda dt (lambda: the fastest linear rate) that a plain step takes. At 2 it diverges.
# The paper: s_i = 1, K <= 101, dt <= 0.01 s, stays below 1.52; larger confidences do not.
PLAIN_STEP_LIMIT = 1.6
# Steps this much longer than the longest plain one are plain, too: clocks jitter, and stamps in
# whole milliseconds make 11 ms of a period of 10.
STEP_TOLERANCE = 1.1
# Sine of the angle between v1 and v2 below which they fix no attitude.
COLLINEAR_SINE = 1e-6


class FilterParams(NamedTuple):
    """What is chosen about the filter (paper, Eq. (12), "Attit_Filter", and Section III)."""

    # gamma, 1/s^2 per unit: how fast the bias follows. Small: a wrong bias
    # lingers; large: the bias chases vector noise.
    gamma: float
    # Bound of each component of the bias estimate, rad/s. Small: a bad
    # gyroscope is not corrected; large: a wrong start winds the bias up.
    bias_bound_rad_s: float
    # tau of the low-passed error derivative, s. Small: noise raises the gain;
    # large: the gain answers late.
    rate_time_constant_s: float
    # Steps up to this long use K dt as the paper's continuous time suggests,
    # longer or stronger ones the exact decay, which cannot overshoot. 0: always the decay.
    euler_step_max_s: float
    # The time that the first sample's correction stands for, s, as no sample before it shows.
    # The paper's experiment: one step. 0: the first sample sets e and K and moves nothing.
    first_step_s: float
    # k1..k22 of the fuzzy controller.
    memberships: Memberships
    # K = 1 + k_op instead of the fuzzy controller's, where gain_is_fixed.
    gain_is_fixed: bool
    fixed_gain: float
    # K by the rules in noise floors (:mod:`estimator.filter.noise_gain`), where not fixed.
    gain_knows_noise: bool


class FilterState(NamedTuple):
    """What changes; by default as before the first sample.

    ``has_error`` shows that ``error`` is of an earlier sample, not a blank. ``rate_rad_s`` is the
    rate that the last propagation turned the attitude with. ``noise`` is measured only for a gain
    that knows it.
    """

    q_ned_frd: Quaternion = IDENTITY
    gyr_bias_rad_s: Vec3 = ZERO_VEC3
    error: float = 0.0
    error_rate_1_s: float = 0.0
    gain: float = 1.0
    has_error: bool = False
    rate_rad_s: Vec3 = ZERO_VEC3
    noise: NoiseState = NO_NOISE  # compiled code has to name it


class Vectors(NamedTuple):
    """The filter's observations: directions in body and inertial frame with confidences.

    Unit vectors. v1 is the magnetic one and v2 gravity, as in the paper's
    simulation; v3 = v1 x v2. A confidence of zero takes a vector out.
    """

    v1_frd: Vec3
    v1_ned: Vec3
    s1: float
    v2_frd: Vec3
    v2_ned: Vec3
    s2: float
    s3: float


def gain_in_words(params: FilterParams, *, conditioned: bool) -> str:
    """One sentence. ``conditioned``: whether the filter is given prepared vectors."""
    if params.gain_is_fixed:
        return f"a constant of {params.fixed_gain:g} sets K"
    if not params.gain_knows_noise:
        return "the paper's fuzzy rules set K, which suit the noise they were tuned on"
    if conditioned:
        return "fuzzy rules in measured noise set K, on conditioned vectors"
    return "fuzzy rules in measured noise set K, on raw vectors"
