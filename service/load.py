"""What the loop tells the vehicles about itself."""

from typing import NamedTuple


class Load(NamedTuple):
    """What the loop has lost so far: late ticks, and events and records thrown away.

    Of the vehicles one in ``share`` gets its attitude published at a tick, ``published_hz`` times
    a second each; 0 where the ticks are not those of a clock.
    """

    overruns: int = 0
    dropped: int = 0
    is_shedding: bool = False
    share: int = 1
    published_hz: float = 0.0
