"""What is said about the place and the compass, into the state: north follows from both."""

from estimator.aiding import compass
from estimator.aiding.phase import Cause, Phase
from estimator.aiding.place import differ, update_whereabouts
from estimator.aiding.sources.wheels import rolls
from estimator.geometry.quaternion import exp, multiply
from estimator.live.core import with_attitude
from estimator.live.state import State


def set_position(
    state: State, latitude_deg: float, longitude_deg: float, altitude_m: float, unix_us: int
) -> bool:
    """See :meth:`estimator.estimator.Estimator.set_position`."""
    if not state.settings.learns_north:
        return False
    before = state.context.whereabouts
    known = update_whereabouts(before, latitude_deg, longitude_deg, altitude_m, unix_us)
    if known is before:
        return False
    declination_rad = state.declination_rad or 0.0
    state.change_context(whereabouts=known)
    if known.here is None or known.here is before.here:
        return True
    state.replace_profile(state.profile)
    now, field = state.core.core, known.here.field
    is_aided = state.context.phase is Phase.AIDED
    if not is_aided or (now.seen.has_heading and not rolls(state.settings.aiding)):
        # magnetic until now, or by another place's declination; by velocity it is true already
        turn = exp((0.0, 0.0, field.declination_rad - declination_rad))
        state.set_core(with_attitude(now, multiply(turn, now.filter.q_ned_frd)))
    if before.here is not None and differ(before.here.field, field):
        # verdicts on the compass, and the aiding, were drawn from another place's field
        state.enter(Cause.MISLED)
        if state.context.compass.turned_rad != 0.0:
            state.turn_compass(-state.context.compass.turned_rad)
        state.change_context(compass=compass.restart(state.context.compass))
    return True


def set_field_calibrated(state: State, calibrated: bool) -> None:
    """See :meth:`estimator.estimator.Estimator.set_field_calibrated`."""
    before = state.context.compass
    state.change_context(compass=compass.declare(before, calibrated))
    if compass.is_trusted(before, state.core.time_us) and not calibrated:
        state.enter(Cause.MISLED)
