"""The phases of an estimate, as far as velocity helps, and the allowed transitions as one table."""

from enum import StrEnum


class Phase(StrEnum):
    """What the filter's vectors come from."""

    EMPTY = "empty"  # there has been no sample yet
    RAW = "raw"  # from the sensors as they are: the paper's system, which velocity does not help
    UNAIDED = "unaided"  # from conditioned sensors; no velocity has come
    SEARCHING = "searching"  # from conditioned sensors; velocity comes, but no heading yet
    AIDED = "aided"  # from the attitude that velocity and the sensors agree on


class Cause(StrEnum):
    """What can happen to a phase."""

    RAW_SAMPLE = "raw sample"  # of a profile whose vectors are the sensors'
    SAMPLE = "sample"  # of a profile that conditions them
    REPORT = "report"  # a velocity that nothing can begin with yet
    BEGIN = "begin"  # a velocity at a time when the heading is known well enough
    GAP = "gap"  # no sample for so long that the vehicle may have turned anyhow
    GIVE_UP = "give up"  # no velocity for too long, or it disagrees with the attitude
    MISLED = "misled"  # what gave the heading was wrong: the compass, or the place and its field
    SWITCH_OFF = "switch off"  # by the profile


# What a cause leads to, and from where; it leaves any other phase as it is.
TRANSITIONS: dict[Cause, tuple[Phase, set[Phase]]] = {
    Cause.RAW_SAMPLE: (Phase.RAW, set(Phase)),
    Cause.SAMPLE: (Phase.UNAIDED, {Phase.EMPTY, Phase.RAW}),
    Cause.REPORT: (Phase.SEARCHING, {Phase.UNAIDED}),
    Cause.BEGIN: (Phase.AIDED, {Phase.UNAIDED, Phase.SEARCHING}),
    Cause.GAP: (Phase.UNAIDED, {Phase.SEARCHING, Phase.AIDED}),
    Cause.GIVE_UP: (Phase.UNAIDED, {Phase.AIDED}),
    Cause.MISLED: (Phase.UNAIDED, {Phase.AIDED}),
    Cause.SWITCH_OFF: (Phase.UNAIDED, {Phase.SEARCHING, Phase.AIDED}),
}


def after(phase: Phase, cause: Cause) -> Phase:
    """The phase that follows."""
    following, earlier = TRANSITIONS[cause]
    return following if phase in earlier else phase
