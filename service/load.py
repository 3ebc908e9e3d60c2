"""What the loop tells the vehicles about itself."""

from typing import NamedTuple


class Load(NamedTuple):
    """Whether the loop leaves anything out now.

    ``rate_hz`` is how often attitudes are published where there is time for
    it, 0 where the ticks are not those of a clock; none are while the last ones are
    still in hand (``is_behind``). While it ``is_shedding``, and right
    after a stop (``has_just_woken``), only vehicles with a new sample have theirs published.
    """

    is_shedding: bool = False
    is_behind: bool = False
    has_just_woken: bool = False
    rate_hz: float = 0.0


class Losses(NamedTuple):
    """What the loop has lost so far; only statuses tell it.

    ``overruns`` are late ticks, ``dropped`` events and records thrown away, ``lost`` datagrams that
    the system threw away. ``recording`` is a word on the files that are recorded to.
    """

    overruns: int = 0
    dropped: int = 0
    lost: int = 0
    recording: str = ""
