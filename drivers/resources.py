"""What is limited or has to be given back: things to close, threads, memory."""

import os
import threading
from collections.abc import Callable
from concurrent.futures import Future
from math import inf
from pathlib import Path
from typing import Self, TypeVar

T = TypeVar("T")

# For how many senders of one link there is room; more are noise or an attack. A vehicle with all
# that belongs to it takes a tenth of the memory.
LEAST_SLOTS, MOST_SLOTS = 512, 4096
MEMORY_OF_SLOT = 2 << 20

# Of a container its own limit, by version 2 and 1 of control groups
GROUP = Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes")


class Closing:
    """A context manager that closes itself."""

    def close(self) -> None:
        """Release everything, if anything is held; a second call does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def run_in_thread(work: Callable[[], T], name: str) -> "Future[T]":
    """What ``work`` returns or raises, in a thread that no process waits for at its end."""
    done: Future[T] = Future()

    def run() -> None:
        try:
            result = work()
        except BaseException as error:  # noqa: BLE001 - raised again for each who asks
            done.set_exception(error)
        else:
            done.set_result(result)

    threading.Thread(target=run, name=name, daemon=True).start()
    return done


def slots() -> int:
    """For how many senders there is memory: the machine's, at most what our group may have."""
    try:
        machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # another system than Linux or macOS
        machine = 0
    there = min(float(machine), *map(_limit, GROUP))
    return int(max(LEAST_SLOTS, min(MOST_SLOTS, there // MEMORY_OF_SLOT)))


def _limit(file: Path) -> float:
    try:
        return float(file.read_text("ascii"))
    except (OSError, ValueError):  # it is not there, or "max"
        return inf


SLOTS = slots()
