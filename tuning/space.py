"""The parameters that can be tuned, and the profiles that their values stand for."""

from math import cos, sin
from typing import Any, NamedTuple

import msgspec
import numpy as np
import tomli_w

from estimator.calibration import UNCHANGED, Mounting
from estimator.errors import InputError
from estimator.filter.memberships import CHAINS, LOWER, NAMES, UPPER
from estimator.geometry.quaternion import rotate
from estimator.profile import DEFAULTS, Profile, parse_profile, profile_to_json
from estimator.types import Floats


class Parameter(NamedTuple):
    """A number of a profile by ``section.key``, k1..k22 by their key, and its bounds.

    Those of one ``chain`` ascend, as their bounds do. A logarithmic one is searched by its
    logarithm, because a change by a factor means the same at any value.
    """

    name: str
    lower: float
    upper: float
    is_logarithmic: bool = True
    chain: int | None = None

    @property
    def address(self) -> tuple[str, str]:
        """Section and key of the profile."""
        section, _, key = self.name.rpartition(".")
        return section or "membership", key


Space = tuple[Parameter, ...]

COMPASS_TURN = "compass_turn_rad"  # a tuned number that stands in the calibration's mag_matrix
# The bounds are the shipped values divided and multiplied by this. Further away a parameter no
# longer does what it is named for.
SHIPPED_FACTOR = 5.0


def _around_shipped(section: str, keys: str) -> Space:
    """Parameters of a section by their keys."""
    shipped = [(key, float(DEFAULTS[section][key])) for key in keys.split()]
    return tuple(
        Parameter(f"{section}.{key}", value / SHIPPED_FACTOR, value * SHIPPED_FACTOR)
        for key, value in shipped
    )


# k1..k22 within the paper's Eqs. (16) and (17), a <= b <= c in each triangle.
MEMBERSHIP: Space = tuple(
    Parameter(NAMES[i], LOWER[i], UPPER[i], is_logarithmic=False, chain=chain)
    for chain, corners in enumerate(CHAINS)
    for i in corners
)
RATE_TIME_CONSTANT = Parameter("filter.rate_time_constant_s", 0.05, 3.0)

# With raw vectors, as in the paper: gamma has a meaning, the confidences are the paper's 1.
RAW_GROUPS: dict[str, Space] = {
    "membership": MEMBERSHIP,
    "filter": (Parameter("filter.gamma", 0.1, 10.0), RATE_TIME_CONSTANT),
}
# With conditioned vectors: the conditioning stage estimates the bias, not gamma.
CONDITIONED_GROUPS: dict[str, Space] = {
    "membership": MEMBERSHIP,
    "filter": (RATE_TIME_CONSTANT,),
    "confidence": tuple(
        Parameter(f"confidence.{name}", 0.25, 25.0) for name in ("gravity", "magnetic")
    ),
    # What decides how fast the conditioning stage believes which sensor; the rest of it
    # describes vehicles and events, which one log does not show.
    "conditioning": _around_shipped(
        "conditioning",
        "gravity_tau_s bias_initial_sigma_rad_s bias_rest_sigma_rad_s"
        " bias_motion_sigma_rad_s heading_noise_rad2_s",
    ),
    # How noisy the vehicle's sensors and velocity reports are: few numbers that differ from vehicle
    # to vehicle, without a velocity and with one.
    "noise": (
        *_around_shipped("conditioning", "gravity_tau_s heading_noise_rad2_s"),
        *_around_shipped("aiding", "gyr_slow_noise_1_s acc_noise heading_noise"),
        *_around_shipped("aiding", "filter_error_m_s receiver_error_m_s"),
    ),
    "gain": (Parameter("filter.fixed_gain", 1.0, 200.0),),
    # What moves sigma alone: errors do not show it, coverage does.
    "sigma": _around_shipped("aiding", "colour least_scale scatter_share"),
    # What a fit of the sensors' constants leaves open: how far the compass is turned about the
    # body's down, how late readings may be, and how far from its nose the vehicle moves.
    "calibration": (
        Parameter(f"calibration.{COMPASS_TURN}", -0.2, 0.2, is_logarithmic=False),
        *_around_shipped("aiding", "imu_lag_s"),
        *_around_shipped("conditioning", "field_lag_sigma_s"),
        Parameter("aiding.sideslip_rad", 0.02, 3.0),
    ),
}


def space_of(groups: tuple[str, ...], known: dict[str, Space]) -> Space:
    """The joint space of the named groups, in the order given.

    Raises:
        InputError: no group, an unknown one, or one given twice.
    """
    if not groups:
        raise InputError(f"--parameters: nothing to tune; choose from {', '.join(known)}")
    for i, group in enumerate(groups):
        if group not in known:
            raise InputError(f"--parameters {group}: not here; choose from {', '.join(known)}")
        if group in groups[:i]:
            raise InputError(f"--parameters {group}: given twice")
    return tuple(parameter for group in groups for parameter in known[group])


def encode(space: Space, values: Floats) -> Floats:
    """Search coordinates of parameter values, (..., D)."""
    log = [each.is_logarithmic for each in space]
    out = np.array(values, dtype=np.float64)
    out[..., log] = np.log(out[..., log])
    return out


def decode(space: Space, positions: Floats) -> Floats:
    """Parameter values (N, D) of search coordinates (N, D); never outside the bounds."""
    log = [each.is_logarithmic for each in space]
    out = np.array(positions, dtype=np.float64)
    out[..., log] = np.exp(out[..., log])  # rounds, hence the clip
    return _clipped(space, out)


def _clipped(space: Space, values: Any) -> Floats:
    return np.asarray(np.clip(values, [p.lower for p in space], [p.upper for p in space]))


def bounds(space: Space) -> tuple[Floats, Floats]:
    """Lower and upper bounds (D,) in search coordinates."""
    low, high = (np.array([getattr(p, end) for p in space]) for end in ("lower", "upper"))
    return encode(space, low), encode(space, high)


def make_feasible(space: Space, positions: Floats) -> Floats:
    """The feasible positions that any positions (N, D) stand for.

    Each coordinate is clipped to its bounds, then each chain is sorted, which keeps to the bounds
    as these ascend. Moving a corner onto the neighbour that it was pushed past would pile the
    search up on vertical edges; rejecting it would waste evaluations where the space is narrow.
    """
    out = np.clip(positions, *bounds(space))
    for chain in {each.chain for each in space} - {None}:
        columns = [i for i, each in enumerate(space) if each.chain == chain]
        out[:, columns] = np.sort(out[:, columns], axis=1)
    return out


def random_positions(space: Space, count: int, generator: np.random.Generator) -> Floats:
    """Feasible positions (count, D), uniform within the bounds before ordering."""
    lower, upper = bounds(space)
    drawn = lower + (upper - lower) * generator.random((count, len(space)))
    return make_feasible(space, drawn)


def values_of(space: Space, profile: Profile) -> Floats:
    """The profile's values (D,) of the space's parameters, clipped to their bounds."""
    tree = profile_to_json(profile)
    tree["calibration"] = {COMPASS_TURN: 0.0}  # beside what the profile has
    values = [float(tree[section][key]) for section, key in (each.address for each in space)]
    return _clipped(space, values)


def profile_with(space: Space, base: Profile, values: Floats) -> Profile:
    """``base`` with the space's parameters replaced.

    Raises:
        InputError: the result is no valid profile.
    """
    tree = msgspec.to_builtins(base)
    for parameter, value in zip(space, values.tolist(), strict=True):
        section, key = parameter.address
        tree[section][key] = value
    turn_rad = tree["calibration"].pop(COMPASS_TURN, 0.0)
    if turn_rad != 0.0:  # the compass's readings about the body's down
        R, (c, s) = sensor_axes(base.mounting), (cos(turn_rad), sin(turn_rad))
        turn = R.T @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ R
        matrix = (turn @ np.array(base.calibration.mag_matrix)).round(6).tolist()
        tree["calibration"]["mag_matrix"] = matrix
    return parse_profile(tomli_w.dumps(tree), "tuned")


def sensor_axes(mounting: Mounting) -> Floats:
    """The sensors' axes as columns (3, 3) in the body's."""
    return np.column_stack([rotate(mounting.q_frd_sensor, axis) for axis in UNCHANGED])
