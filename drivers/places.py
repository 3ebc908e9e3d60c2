"""For how many senders of one link there is room; more are noise or an attack."""

import os
from math import inf
from pathlib import Path

LEAST_PLACES, MOST_PLACES = 512, 4096
# A vehicle with all that belongs to it takes a tenth of that.
MEMORY_OF_PLACE = 2 << 20

# Of a container its own limit, by version 2 and 1 of control groups
GROUP = Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes")


def places() -> int:
    """As many as there is memory for."""
    return int(max(LEAST_PLACES, min(MOST_PLACES, total_bytes() // MEMORY_OF_PLACE)))


def total_bytes() -> float:
    """What the machine has, at most what our group may have; 0 if unknown."""
    try:
        machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # another system than Linux or macOS
        return 0.0
    return min(float(machine), *map(_limit, GROUP))


def _limit(file: Path) -> float:
    try:
        text = file.read_text("ascii").strip()
    except OSError:
        return inf
    return float(text) if text.isdigit() else inf


PLACES = places()
