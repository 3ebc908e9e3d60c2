"""What a message says about place and motion, and how far its velocity can be trusted."""

import math
from typing import NamedTuple

from drivers.samples.preference import is_receiver
from estimator.types import Vec3, VelocitySample

FILTER_VELOCITY_SIGMA_M_S = 0.3  # an autopilot's own filter, typical with GPS
RECEIVER_VELOCITY_SIGMA_M_S = 0.5  # a GPS receiver that does not say
RECEIVER_LATE_SIGMA_S = 0.1  # its word comes 0.1 to 0.2 s late, and does not say how late


class Fix(NamedTuple):
    """A message's velocity and position; None for what it does not say.

    ``velocity_ned_m_s`` has a meaningless third component where ``has_vertical`` is false.
    ``sigma_m_s`` is its accuracy (1 sigma) by the message itself. ``position`` is latitude
    and longitude in degrees (WGS 84) and altitude in m.
    """

    velocity_ned_m_s: Vec3 | None = None
    has_vertical: bool = True
    sigma_m_s: float | None = None
    position: Vec3 | None = None

    @property
    def is_solved(self) -> bool:
        """Whether it says anything: zero latitude and longitude are a receiver's first words."""
        if self.position is None:
            return self.velocity_ned_m_s is not None
        latitude_deg, longitude_deg, _ = self.position
        return latitude_deg != 0 or longitude_deg != 0


def velocity_sample(message: str, fix: Fix, time_us: int) -> VelocitySample | None:
    """The velocity that ``message`` tells, at ``time_us``; None if it tells none.

    A receiver's velocity is late; an autopilot's filter has corrected for that.
    """
    velocity, sigma_m_s = fix.velocity_ned_m_s, fix.sigma_m_s
    if velocity is None or not all(map(math.isfinite, velocity)):
        return None
    late_sigma_s = RECEIVER_LATE_SIGMA_S if is_receiver(message) else 0.0
    if sigma_m_s is None:
        typical = RECEIVER_VELOCITY_SIGMA_M_S if late_sigma_s else FILTER_VELOCITY_SIGMA_M_S
        sigma_m_s = typical
    if not math.isfinite(sigma_m_s):
        return None
    return VelocitySample(time_us, velocity, fix.has_vertical, sigma_m_s, late_sigma_s)
