"""The sources of aiding, by the type of their reports. A new one is one line here."""

from typing import Any

from estimator.aiding.sources.source import Source
from estimator.aiding.sources.velocity import VELOCITY_SOURCE
from estimator.errors import InputError
from estimator.types import VelocitySample

SOURCES: dict[type, Source] = {
    VelocitySample: VELOCITY_SOURCE,
}


def source_of(report: Any) -> Source:
    """The source that makes such reports.

    Raises:
        InputError: there is none.
    """
    source = SOURCES.get(type(report))
    if source is None:
        known = ", ".join(kind.__name__ for kind in SOURCES)
        msg = f"no source of aiding reports a {type(report).__name__}; those that do: {known}"
        raise InputError(msg)
    return source
