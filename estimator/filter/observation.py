"""From a sample to the filter's unit vectors, without conditioning."""

from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.filter.types import Vectors
from estimator.geometry.quaternion import norm, scale, unit
from estimator.types import ZERO_VEC3, Vec3


class ReferenceParams(NamedTuple):
    """Inertial unit vectors in NED and the paper's confidences s_i."""

    magnetic_ned: Vec3
    gravity_ned: Vec3
    s_magnetic: float
    s_gravity: float
    s_cross: float
    place_gauss: Vec3 = ZERO_VEC3  # the place's field in NED; zero while unknown


@inlined
def weighted_vectors(
    reference: ReferenceParams,
    magnetic_frd: Vec3,
    magnetic_share: float,
    gravity_frd: Vec3,
    gravity_share: float,
    weight: float,
) -> Vectors:
    """The filter's vectors from what the body sees.

    ``weight`` multiplies all confidences; the shares, 0..1, lower that of one vector.
    """
    return Vectors(
        v1_frd=magnetic_frd,
        v1_ned=reference.magnetic_ned,
        s1=reference.s_magnetic * weight * magnetic_share,
        v2_frd=gravity_frd,
        v2_ned=reference.gravity_ned,
        s2=reference.s_gravity * weight * gravity_share,
        s3=reference.s_cross * weight,
    )


@inlined
def raw_vectors(reference: ReferenceParams, acc_m_s2: Vec3, mag: Vec3, has_mag: bool) -> Vectors:
    """The paper's normalised vectors, Eq. (5) "Attit_Vector_norm".

    v1 is the magnetic one, v2 gravity: minus the specific force, which points down at rest. A
    vector that is absent or zero gets no confidence.
    """
    return weighted_vectors(
        reference,
        magnetic_frd=unit(mag),
        magnetic_share=1.0 if has_mag and norm(mag) > 0.0 else 0.0,
        gravity_frd=unit(scale(-1.0, acc_m_s2)),
        gravity_share=1.0 if norm(acc_m_s2) > 0.0 else 0.0,
        weight=1.0,
    )
