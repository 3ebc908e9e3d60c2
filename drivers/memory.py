"""How much memory there is for us."""

import os
from math import inf
from pathlib import Path

GROUP = Path("/sys/fs/cgroup/memory.max")  # of a container: its own limit


def total_bytes() -> float:
    """What the machine has, at most what our group may have; 0 if unknown."""
    try:
        machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # another system than Linux or macOS
        return 0.0
    return min(float(machine), _of_group())


def _of_group() -> float:
    try:
        told = GROUP.read_text("ascii").strip()
    except OSError:
        return inf
    return float(told) if told.isdigit() else inf
