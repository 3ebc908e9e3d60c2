"""The groups of parameters that can be tuned, with their bounds."""

from typing import Any

from estimator.aiding.types import AidingParams
from estimator.conditioning.params import ConditioningParams
from estimator.errors import InputError
from tuning.space import Space, join_spaces, membership_space

COMPASS_TURN = "compass_turn_rad"  # a tuned number that stands in the calibration's mag_matrix

# What decides how fast the conditioning stage believes which sensor; the rest of it
# describes vehicles and events, which one log does not show.
CONDITIONING = (
    "gravity_tau_s",
    "bias_initial_sigma_rad_s",
    "bias_rest_sigma_rad_s",
    "bias_motion_sigma_rad_s",
    "field_dip_scale_rad",
    "heading_noise_rad2_s",
)
# The bounds are the shipped values divided and multiplied by this. Further away a parameter no
# longer does what it is named for.
SHIPPED_FACTOR = 5.0
# How noisy the vehicle's sensors and velocity reports are: few numbers that differ from vehicle to
# vehicle, without a velocity and with one. What moves sigma alone is a group of its own: errors do
# not show it, coverage does.
NOISE_UNAIDED = ("gravity_tau_s", "heading_noise_rad2_s")
NOISE_AIDED = (
    "gyr_slow_noise_1_s",
    "acc_noise",
    "heading_noise",
    "filter_error_m_s",
    "receiver_error_m_s",
)
SIGMA = ("colour", "least_scale", "scatter_share")
# What a fit of the sensors' constants leaves open: how far the compass is turned about the body's
# down (rad), how late readings may be, and how far from its nose the vehicle moves.
MOST_COMPASS_TURN_RAD = 0.2
SIDESLIP_RAD = (0.02, 3.0)


def _logarithmic(section: str, ranges: dict[str, tuple[float, float]]) -> Space:
    """Positive scales, searched by their logarithm."""
    return Space(
        names=tuple(f"{section}.{name}" for name in ranges),
        lower=tuple(low for low, _ in ranges.values()),
        upper=tuple(high for _, high in ranges.values()),
        logarithmic=(True,) * len(ranges),
    )


def _around_shipped(section: str, kind: Any, names: tuple[str, ...]) -> Space:
    """Shipped values, divided and multiplied by ``SHIPPED_FACTOR``."""
    defaults = kind._field_defaults
    shipped = {name: float(defaults[name]) for name in names}
    ranges = {n: (x / SHIPPED_FACTOR, x * SHIPPED_FACTOR) for n, x in shipped.items()}
    return _logarithmic(section, ranges)


RATE_TIME_CONSTANT_S = (0.05, 3.0)

# With raw vectors, as in the paper: gamma has a meaning, the confidences are the paper's 1.
RAW_GROUPS: dict[str, Space] = {
    "membership": membership_space(),
    "filter": _logarithmic(
        "filter", {"gamma": (0.1, 10.0), "rate_time_constant_s": RATE_TIME_CONSTANT_S}
    ),
}
# With conditioned vectors: the conditioning stage estimates the bias, not gamma.
CONDITIONED_GROUPS: dict[str, Space] = {
    "membership": membership_space(),
    "filter": _logarithmic("filter", {"rate_time_constant_s": RATE_TIME_CONSTANT_S}),
    "confidence": _logarithmic("confidence", {"gravity": (0.25, 25.0), "magnetic": (0.25, 25.0)}),
    "conditioning": _around_shipped("conditioning", ConditioningParams, CONDITIONING),
    "noise": join_spaces(
        _around_shipped("conditioning", ConditioningParams, NOISE_UNAIDED),
        _around_shipped("aiding", AidingParams, NOISE_AIDED),
    ),
    "gain": _logarithmic("filter", {"fixed_gain": (1.0, 200.0)}),
    "sigma": _around_shipped("aiding", AidingParams, SIGMA),
    "calibration": join_spaces(
        Space(
            (f"calibration.{COMPASS_TURN}",),
            (-MOST_COMPASS_TURN_RAD,),
            (MOST_COMPASS_TURN_RAD,),
            logarithmic=(False,),
        ),
        _around_shipped("aiding", AidingParams, ("imu_lag_s",)),
        _around_shipped("conditioning", ConditioningParams, ("field_lag_sigma_s",)),
        _logarithmic("aiding", {"sideslip_rad": SIDESLIP_RAD}),
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
    return join_spaces(*(known[group] for group in groups))
