"""The sources of aiding, by the type of their reports. A new one is one line in the table."""

from collections.abc import Callable
from math import isfinite
from typing import Any, NamedTuple

from estimator.errors import InputError
from estimator.reasons import Reason
from estimator.types import ZERO_VEC3, VelocitySample

# Faster than sound in air: no vehicle this is for.
SPEED_LIMIT_M_S = 400.0


class Source(NamedTuple):
    """A kind of measurement beside the IMU. Its reports are named tuples of numbers.

    ``blank`` is an example that shows the type of each field. The first field is ``time_us: int``,
    the vehicle's own clock at the measurement. The others may be numbers, flags, and tuples of
    them.

    ``observe(params, now, report, ago_s, x)`` is inlined compiled code. It calls
    :func:`~estimator.aiding.covariance.learn` once for each scalar that was measured ``ago_s``
    before the last sample; ``now`` is the prediction at that sample. Only velocity has none,
    because the aiding begins with it and takes it together with a sample.
    """

    blank: Any
    observe: Callable[..., None] | None
    refusal: "Callable[[Any], Reason | None]"


def refusal_of_numbers(report: Any) -> Reason | None:
    """Why a report cannot be used: a number in it is not finite. For sources without limits."""
    return None if all(map(isfinite, numbers_of(report))) else Reason.NOT_FINITE


def numbers_of(value: Any) -> list[float]:
    """All numbers of a report, one after the other."""
    if not isinstance(value, tuple):
        return [value]
    return [number for part in value for number in numbers_of(part)]


def refusal_of_velocity(report: VelocitySample) -> Reason | None:
    """Why a report cannot be used, None if it can."""
    if not all(isfinite(v) for v in (*report.velocity_ned_m_s, report.sigma_m_s)):
        return Reason.VELOCITY_NOT_FINITE
    if max(abs(v) for v in report.velocity_ned_m_s) > SPEED_LIMIT_M_S:
        return Reason.VELOCITY_OUT_OF_RANGE
    return None


SOURCES: dict[type, Source] = {
    VelocitySample: Source(
        blank=VelocitySample(0, ZERO_VEC3, True, 0.0), observe=None, refusal=refusal_of_velocity
    )
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


def in_types_of(blank: Any, value: Any) -> Any:
    """A value with every number of the type that compiled code takes in its place.

    Raises:
        InputError: it is built otherwise than ``blank``, or holds something that is no number.
    """
    kind = type(blank)
    try:
        if not isinstance(blank, tuple):
            return kind(value)
        parts = [in_types_of(a, b) for a, b in zip(blank, value, strict=True)]
    except (TypeError, ValueError, OverflowError):
        msg = f"{value!r} stands where compiled code takes {blank!r}"
        raise InputError(msg) from None
    return kind(parts) if kind is tuple else kind(*parts)
