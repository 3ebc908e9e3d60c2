"""Whether the field contradicts the accelerometer, whatever the gyroscope has made of it."""

from math import cos, sin

import numpy as np

from estimator.aiding.types import HARD_IRON, SIZE, Sigmas
from estimator.aiding.uncertainty import leaning
from estimator.conditioning.field.magnetic import FieldLook, horizontal_down
from estimator.geometry.quaternion import angle_between_vectors, norm, rotate
from estimator.live.core import Core
from estimator.live.settings import Settings

CERTAIN = Sigmas(inclination_rad=0.0, heading_rad=0.0)


def leaning_angle(settings: Settings, core: Core) -> float:
    """How far (rad) force and field as read lie otherwise apart than velocity and place have it.

    The force is that of the last second or so, which the change of velocity explains. What was
    learnt of the field meanwhile does not count, and what calibration leaves over is no
    contradiction. 0 without either, and while nobody knows the place.
    """
    params, place_gauss = settings.aiding, settings.reference.place_gauss
    force, sample = core.consistency.force, core.sample
    n = norm(sample.mag)
    if not sample.has_mag or force.share == 0.0 or norm(place_gauss) == 0.0 or n == 0.0:
        return 0.0
    apart = angle_between_vectors(force.g, rotate(core.consistency.q_g_frd, sample.mag))
    dip = np.arctan2(*horizontal_down(place_gauss)[::-1])
    dip += apart - angle_between_vectors(force.ned, place_gauss)
    as_read = core.aided.field._replace(look=FieldLook(n * cos(dip), n * sin(dip), 0.0))
    usual = np.zeros((SIZE, SIZE))
    usual[HARD_IRON, HARD_IRON] = params.hard_iron_sigma_gauss**2
    return leaning(params, CERTAIN, as_read, place_gauss, usual).inclination_rad
