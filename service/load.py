"""What the loop tells the pipeline about itself."""

from typing import NamedTuple


class Load(NamedTuple):
    """Whether the loop leaves anything out now.

    ``rate_hz`` is how often attitudes are published where there is time for it. While it
    ``is_shedding``, only vehicles with a new sample have theirs published. Right after a stop
    (``has_just_woken``) nobody can tell yet whose silence is his own.
    """

    is_shedding: bool = False
    has_just_woken: bool = False
    rate_hz: float = 0.0


class Losses(NamedTuple):
    """What the loop has lost so far; only statuses show it.

    ``overruns`` are late ticks, ``dropped`` events and records thrown away, ``lost`` datagrams that
    the system threw away. ``recording`` is a word on the files that are recorded to.
    """

    overruns: int = 0
    dropped: int = 0
    lost: int = 0
    recording: str = ""
