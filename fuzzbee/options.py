"""Options and checks that several verbs share."""

from math import isfinite
from typing import Annotated

import typer

from estimator.errors import InputError

Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Say more on standard error.")]
Json = Annotated[bool, typer.Option("--json", help="JSON on standard output, nothing else there.")]
Seconds = Annotated[
    float | None, typer.Option("--seconds", metavar="N", help="End after N seconds.")
]


MAX_GAIN = 1e6


def require_gain(gain: float | None) -> None:
    """Refuse a fixed gain that is no number above 0, or beyond any use.

    Raises:
        InputError: names the value.
    """
    if gain is not None and not 0.0 < gain <= MAX_GAIN:
        raise InputError(f"--gain {gain:g}: K should be above 0 and at most {MAX_GAIN:g}")


def require_positive(option: str, value: float | None) -> None:
    """Refuse zero, negative numbers, infinity and NaN.

    Raises:
        InputError: names the option and the value.
    """
    if value is not None and not (isfinite(value) and value > 0.0):
        raise InputError(f"{option} {value:g}: should be a number above 0")
