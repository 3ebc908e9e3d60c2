"""SIGINT and SIGTERM: the two ways a person or a supervisor ends a command."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def terminate_like_interrupt() -> Iterator[None]:
    """Have SIGTERM raise ``KeyboardInterrupt``, too: for a start that takes long."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def stop_on_signals(stop: Callable[[], None]) -> Iterator[None]:
    """Call ``stop`` at the first SIGINT or SIGTERM; a second one has its usual effect."""
    chosen = (signal.SIGINT, signal.SIGTERM)
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may set handlers; elsewhere the owner calls stop
        return
    before = {number: signal.getsignal(number) for number in chosen}

    def on_signal(number: int, _frame: FrameType | None) -> None:
        signal.signal(number, before[signal.Signals(number)])
        stop()

    for number in chosen:
        signal.signal(number, on_signal)
    try:
        yield
    finally:
        for number in chosen:
            signal.signal(number, before[number])
