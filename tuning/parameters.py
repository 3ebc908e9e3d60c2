"""The groups of parameters that can be tuned, with their bounds."""

from estimator.errors import InputError
from tuning.space import Space, joined, membership_space

EMPTY = Space((), (), ())


def _logarithmic(section: str, ranges: dict[str, tuple[float, float]]) -> Space:
    """Positive scales, searched by their logarithm."""
    return Space(
        tuple(f"{section}.{name}" for name in ranges),
        tuple(low for low, _ in ranges.values()),
        tuple(high for _, high in ranges.values()),
        (),
        (True,) * len(ranges),
    )


# Ranges: a factor of about ten around the shipped values, narrower where beyond
# it the parameter stops to mean what it says (a low-pass faster than the samples).
GROUPS: dict[str, Space] = {
    "membership": membership_space(),
    "filter": _logarithmic("filter", {"gamma": (0.1, 10.0), "rate_time_constant_s": (0.05, 3.0)}),
    "confidence": _logarithmic(
        "confidence", {"gravity": (0.1, 5.0), "magnetic": (0.1, 5.0), "cross": (0.1, 5.0)}
    ),
}


def space_of(groups: tuple[str, ...]) -> Space:
    """The joint space of the named groups, in the order given.

    Raises:
        InputError: no group, an unknown one, or one given twice.
    """
    if not groups:
        raise InputError(f"--parameters: nothing to tune; choose from {', '.join(GROUPS)}")
    space = EMPTY
    for i, group in enumerate(groups):
        if group not in GROUPS:
            raise InputError(f"--parameters {group}: unknown; choose from {', '.join(GROUPS)}")
        if group in groups[:i]:
            raise InputError(f"--parameters {group}: given twice")
        space = joined(space, GROUPS[group])
    return space
