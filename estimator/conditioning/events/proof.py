"""What tells an unsensed turn of the vehicle from noise, acceleration and magnets."""

from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.conditioning.events.axis_signs import AxisSigns
from estimator.conditioning.events.gravity_signs import GravitySigns, with_time
from estimator.conditioning.events.heading_signs import HeadingSigns, begin_anew, give_up, likely
from estimator.conditioning.events.jump_signs import JumpSigns, jump_variance, with_seen
from estimator.conditioning.field.calibration import Calibration
from estimator.conditioning.field.magnetic import NORM_SCALE
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.times import LONGEST_STEP_S


class TurnSigns(NamedTuple):
    """How strong each sign of an unsensed turn is, and how long it has lasted."""

    heading: HeadingSigns = HeadingSigns()  # of the field
    gravity: GravitySigns = GravitySigns()  # of the specific force
    jump: JumpSigns = JumpSigns()  # of the field in G
    axes: AxisSigns = AxisSigns()  # of the gyroscope's axes, by that field


class TurnProof(NamedTuple):
    """Which signs of an unsensed turn have lasted for long enough."""

    heading: bool  # the field keeps pointing elsewhere
    gravity: bool  # gravity keeps pulling elsewhere
    jump: float  # variance (rad^2) of the turn by which the field has jumped; 0: it has not


@inlined
def tells_turn(proof: TurnProof) -> bool:
    """Whether anything but a jump of the field proves a turn."""
    return proof.heading or proof.gravity


@inlined
def proof_of(
    params: ConditioningParams,
    signs: TurnSigns,
    learnt: Calibration,
    usual_norm: float,
) -> tuple[TurnProof, float]:
    """Which signs have lasted for long enough, and the part (rad) of a jump that is told by now.

    ``usual_norm`` is that of the place's field.
    """
    if not params.use_events:
        return TurnProof(False, False, 0.0), 0.0
    heading, gravity = signs.heading, signs.gravity
    jump, seen_rad = jump_variance(params, signs.jump, learnt)
    off = abs(signs.jump.quick_norm - usual_norm)
    if likely(heading.mean_confidence) <= 0.0 or off >= NORM_SCALE * usual_norm:
        jump = 0.0
    return TurnProof(
        heading=heading.borne_s <= 0.0 or heading.back_s > LONGEST_STEP_S,
        gravity=gravity.off_s > LONGEST_STEP_S,
        jump=jump,
    ), seen_rad


@inlined
def reset_signs(
    signs: TurnSigns, proof: TurnProof, seen_rad: float, heading_rad: float, given_up: bool
) -> TurnSigns:
    """The signs after a step: those that were proof enough start anew.

    ``seen_rad`` is the part of a jump that is told by now, ``heading_rad`` the heading, which is
    remembered where it was ``given_up``.
    """
    heading, gravity = signs.heading, signs.gravity
    if tells_turn(proof):
        heading = begin_anew(heading)
    if given_up:
        heading = give_up(heading, heading_rad)
    return TurnSigns(
        heading=heading,
        gravity=with_time(gravity, 0.0 if proof.gravity else gravity.off_s),
        jump=with_seen(signs.jump, seen_rad),
        axes=signs.axes,
    )
