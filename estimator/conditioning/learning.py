"""What the mean readings of one learning step teach: the vertical, the field, then the events."""

from math import cos, sin

from estimator.compilation.compiled import inlined
from estimator.compilation.replacing import replacer
from estimator.conditioning.events.step import learn_events
from estimator.conditioning.field.step import learn_field
from estimator.conditioning.gather import NOTHING, means
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.sigma import certainty_of
from estimator.conditioning.state import ConditioningState, Directions
from estimator.conditioning.vertical.gravity import published_frame
from estimator.conditioning.vertical.step import VerticalState, learn_vertical
from estimator.geometry.axes import down_of
from estimator.geometry.quaternion import rotate_inverse
from estimator.types import Between

with_step = replacer(
    ConditioningState, "vertical", "field", "events", "gathered", "directions", "certainty"
)


@inlined
def directions_of(vertical: VerticalState) -> Directions:
    """Down and magnetic north in G, by the vertical that is published."""
    q, heading_rad = published_frame(vertical.gravity), vertical.estimate.heading_rad
    north_6d = (cos(heading_rad), -sin(heading_rad), 0.0)
    return Directions(down_of(q), rotate_inverse(q, north_6d))


@inlined
def learn(
    params: ConditioningParams, state: ConditioningState, between: Between
) -> ConditioningState:
    """One learning step on what was gathered; ``between`` is known of the last sample's turning."""
    mean = means(state.gathered)
    force_scatter = state.events.signs.gravity.force_scatter
    levelled = learn_vertical(params, state.vertical, mean, between, force_scatter)
    seen = learn_field(params, state.field, mean, levelled)
    now = learn_events(params, state.events, mean, levelled, seen)
    certainty = certainty_of(params, now.vertical, now.field, now.events)
    directions = directions_of(now.vertical)
    return with_step(state, now.vertical, now.field, now.events, NOTHING, directions, certainty)
