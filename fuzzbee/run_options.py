"""What ``fuzzbee run`` was asked for."""

from typing import TYPE_CHECKING, NamedTuple

from fuzzbee import outputs, security

if TYPE_CHECKING:
    from service.zenoh_session import ZenohOptions


class RunOptions(NamedTuple):
    """What was asked for, checked as far as it can be without opening anything."""

    source: str
    rate_hz: float
    seconds: float | None
    profile: str | None  # None: the one that fits
    gain: float | None
    as_json: bool
    record: str | None
    request_rate_hz: float | None
    speed: float
    system_id: int | None
    retune: bool
    zenoh: "ZenohOptions | None"
    outputs: outputs.OutputOptions
    security: security.SecurityOptions
    second: bool = False
    workers: int = 1
