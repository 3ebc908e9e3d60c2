"""How much memory there is for us."""

import os
from math import inf
from pathlib import Path

SYSTEM = Path("/proc/meminfo")
GROUP = Path("/sys/fs/cgroup/memory.max")  # of a container: its own limit


def available_bytes() -> float:
    """What can be taken without swapping, at most what our group may have; infinite if unknown."""
    return min(_of_system(), _of_group())


def total_bytes() -> float:
    """What the machine has, at most what our group may have; 0 if unknown."""
    try:
        machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # another system than Linux or macOS
        return 0.0
    return min(float(machine), _of_group())


def _of_system() -> float:
    try:
        lines = SYSTEM.read_text("ascii").splitlines()
    except OSError:  # another system
        return inf
    told = [line.split()[1] for line in lines if line.startswith("MemAvailable:")]
    return 1024.0 * int(told[0]) if told else inf


def _of_group() -> float:
    try:
        told = GROUP.read_text("ascii").strip()
    except OSError:
        return inf
    return float(told) if told.isdigit() else inf
