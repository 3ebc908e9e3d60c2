"""What the conditioning stage has learnt, and what can be done to it from outside."""

from typing import NamedTuple

from estimator.conditioning.events.axis_signs import AxisSigns
from estimator.conditioning.events.step import EventsState
from estimator.conditioning.field.calibration import first_calibration
from estimator.conditioning.field.step import MagnetometerState
from estimator.conditioning.gather import Gathered
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.sigma import Certainty
from estimator.conditioning.vertical.bias import UNKNOWN_HEADING_VARIANCE, first_estimate
from estimator.conditioning.vertical.step import VerticalState
from estimator.conditioning.vertical.stillness import Stillness
from estimator.geometry.axes import FrameAxes
from estimator.geometry.quaternion import multiply, normalize, rotate_inverse
from estimator.types import Quaternion, Vec3


class ConditioningState(NamedTuple):
    """What learning steps change; what every sample does is :class:`Gathered`."""

    vertical: VerticalState  # the vertical and the gyroscope
    field: MagnetometerState  # the magnetic field
    events: EventsState = EventsState()  # turns that were not seen
    started: bool = False  # whether there has been a sample
    down_g: Vec3 = (0.0, 0.0, 1.0)  # unit vector in G, for the next samples
    north_g: Vec3 = (1.0, 0.0, 0.0)  # magnetic north likewise, horizontal
    certainty: Certainty = Certainty()  # of these directions


def initial_state(params: ConditioningParams) -> ConditioningState:
    """The state before the first sample."""
    return ConditioningState(
        vertical=VerticalState(first_estimate(params)),
        field=MagnetometerState(first_calibration(params)),
    )


def forget_bias(params: ConditioningParams, state: ConditioningState) -> ConditioningState:
    """The state with its attitude but another gyroscope, whose errors are as at the beginning."""
    _, heading_rad, covariance = state.vertical.estimate
    estimate = first_estimate(params, heading_rad, covariance[9])
    return state._replace(
        vertical=state.vertical._replace(estimate=estimate),
        events=state.events._replace(axes=AxisSigns()),
    )


def forget_field(params: ConditioningParams, state: ConditioningState) -> ConditioningState:
    """The state with its vertical and bias; the field, and the heading by it, are learnt anew."""
    estimate = state.vertical.estimate
    p = estimate.covariance
    apart = (p[0], p[1], p[2], 0.0, p[4], p[5], 0.0, p[7], 0.0, UNKNOWN_HEADING_VARIANCE)
    vertical = state.vertical._replace(
        estimate=estimate._replace(covariance=apart), still=Stillness()
    )
    return state._replace(
        vertical=vertical,
        field=MagnetometerState(first_calibration(params)),
        events=EventsState(gravity=state.events.gravity),
    )


def apply_turn(
    state: ConditioningState, gathered: Gathered, turn_frd: Quaternion
) -> tuple[ConditioningState, Gathered]:
    """Every attitude turned by one body rotation, as by a turn that the gyroscope missed."""
    lagged, calibration = state.vertical.lagged, state.field.calibration
    north, east = (
        axis._replace(value=rotate_inverse(turn_frd, axis.value))
        for axis in (lagged.north, lagged.east)
    )
    lagged = lagged._replace(north=north, east=east)
    axes = FrameAxes(*[rotate_inverse(turn_frd, axis) for axis in calibration.axes])
    state = state._replace(
        vertical=state.vertical._replace(lagged=lagged),
        field=state.field._replace(calibration=calibration._replace(axes=axes)),
    )
    q = normalize(multiply(gathered.q_g_frd, turn_frd))
    return state, gathered._replace(q_g_frd=q)
