"""From a profile to the numbers that the kernels take."""

from functools import lru_cache
from math import radians
from typing import Any, NamedTuple

import numpy as np

from estimator.aiding.types import AidingParams
from estimator.conditioning.params import ConditioningParams
from estimator.errors import InputError
from estimator.filter.alignment import nearest_rotation, quaternion_from_matrix
from estimator.filter.observation import ReferenceParams
from estimator.filter.types import FilterParams
from estimator.geometry.earth import PlaceField, in_ned
from estimator.geometry.quaternion import exp, rotate, unit
from estimator.profile import LEAST_GAIN, MOST_GAIN, Profile
from estimator.types import IDENTITY, ZERO_VEC3, Quaternion, Vec3, VehicleClass

MAGNETIC_NORTH: Vec3 = (1.0, 0.0, 0.0)
# Between where wheels roll and where the IMU's x axis points: askew mounting, and tyres in turns.
WHEELS_SLIP_RAD = radians(3.0)


class Settings(NamedTuple):
    """What a profile fixes for the whole run, as compiled code takes it."""

    filter: FilterParams
    reference: ReferenceParams
    conditioning: ConditioningParams
    aiding: AidingParams
    conditioned: bool
    uses_rates: bool  # those of ATTITUDE may show the turning between IMU samples
    learns_north: bool  # the declination may come from a position
    aligns: bool  # the first vectors give the first attitude, and not ``initial``
    initial: Quaternion


def settings_of(
    profile: Profile,
    fixed_gain: float | None = None,
    place: PlaceField | None = None,
    vehicle_class: VehicleClass = VehicleClass.ANYTHING,
) -> Settings:
    """The kernels' parameters; ``fixed_gain`` replaces the profile's K.

    ``place`` is the field of the vehicle's place, None while unknown; its declination counts if the
    profile leaves it to the position. ``vehicle_class`` shows how the IMU moves if the profile does
    not.

    Raises:
        InputError: the fixed gain is none that a profile may have.
    """
    if fixed_gain is not None and not LEAST_GAIN <= fixed_gain <= MOST_GAIN:
        msg = f"gain {fixed_gain:g}: must be a number, {LEAST_GAIN:g} to {MOST_GAIN:g}"
        raise InputError(msg)
    section = profile.filter
    return Settings(
        filter=FilterParams(
            gamma=section.gamma,
            bias_bound_rad_s=section.bias_bound_rad_s,
            rate_time_constant_s=section.rate_time_constant_s,
            euler_step_max_s=section.euler_step_max_s,
            first_step_s=section.first_step_s,
            memberships=profile.k,
            gain_is_fixed=fixed_gain is not None or section.gain == "fixed",
            fixed_gain=section.fixed_gain if fixed_gain is None else float(fixed_gain),
            gain_knows_noise=section.gain == "noise",
        ),
        reference=ReferenceParams(
            magnetic_ned=_magnetic_direction(profile, place),
            gravity_ned=unit(profile.reference.gravity),
            s_magnetic=profile.confidence.magnetic,
            s_gravity=profile.confidence.gravity,
            s_cross=profile.confidence.cross,
            place_gauss=ZERO_VEC3 if place is None else in_ned(place),
        ),
        conditioning=_conditioning(profile, vehicle_class),
        aiding=_aiding(profile, vehicle_class),
        conditioned=profile.conditioned,
        uses_rates=profile.conditioned and profile.rates == "imu+attitude",
        learns_north=profile.reference.magnetic == "learn"
        and profile.reference.declination_deg == "position",
        aligns=section.initial_attitude == "align",
        initial=_initial_attitude(section.initial_attitude),
    )


def _magnetic_direction(profile: Profile, place: PlaceField | None) -> Vec3:
    """The profile's magnetic direction turned to true north; as it is where that is unknown."""
    direction = profile.reference.magnetic
    north = MAGNETIC_NORTH if direction == "learn" else unit(direction)
    declination_deg = profile.reference.declination_deg
    angle = 0.0 if place is None else place.declination_rad
    if declination_deg != "position":
        angle = radians(declination_deg)
    return rotate(exp((0.0, 0.0, angle)), north)


def _conditioning(profile: Profile, vehicle_class: VehicleClass) -> ConditioningParams:
    parameters: dict[str, Any] = dict(profile.conditioning)
    del parameters["enabled"]
    if vehicle_class is not VehicleClass.ANYTHING:
        parameters["in_vehicle"] = True
    return ConditioningParams()._replace(**parameters)


def _aiding(profile: Profile, vehicle_class: VehicleClass) -> AidingParams:
    parameters: dict[str, Any] = profile.aiding
    aiding = AidingParams()._replace(**parameters)
    if vehicle_class is VehicleClass.WHEELS and aiding.sideslip_rad == AidingParams().sideslip_rad:
        return aiding._replace(sideslip_rad=WHEELS_SLIP_RAD)
    return aiding


@lru_cache(maxsize=16)  # nearly all new vehicles have the same
def _initial_attitude(start: Any) -> Quaternion:
    if start == "align":
        return IDENTITY
    return quaternion_from_matrix(nearest_rotation(np.array(start)))
