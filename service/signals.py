"""SIGINT, SIGTERM and SIGHUP: how a person, a supervisor or a closed terminal ends a command."""

import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from types import FrameType
from typing import Any, TypeVar

T = TypeVar("T")

# Where an interrupt falls into a callback or a destructor, Python prints it and goes on without it.
_interrupted = threading.Event()
_met: list[int] = []  # the signals that have interrupted the command
# A waiting thread checks for a signal this often, s.
POLL_S = 0.1


def ending_signals() -> tuple[signal.Signals, ...]:
    """The signals that end a command; without SIGHUP where ``nohup`` has it ignored."""
    ending = (signal.SIGINT, signal.SIGTERM)
    if not hasattr(signal, "SIGHUP") or signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        return ending
    return (*ending, signal.SIGHUP)


@contextmanager
def terminate_like_interrupt() -> Iterator[None]:
    """Have SIGTERM and SIGHUP raise ``KeyboardInterrupt``, too: what is half done is cleared up."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        _met.append(number)
        _interrupted.set()
        signal.default_int_handler(number, frame)

    _met.clear()
    with _handled(interrupt):
        try:
            yield
        finally:
            _interrupted.clear()


def interrupted_by() -> int | None:
    """The signal that :func:`terminate_like_interrupt` has met, if any."""
    return _met[-1] if _met else None


def await_result(future: "Future[T]") -> T:
    """The result of a future; an interrupt that was lost is raised again.

    Raises:
        KeyboardInterrupt: a signal has come, now or since :func:`terminate_like_interrupt` began.
    """
    while not _interrupted.is_set():
        try:
            return future.result(POLL_S)
        except TimeoutError:
            if future.done():
                raise
    raise KeyboardInterrupt


@contextmanager
def stop_on_signals(stop: Callable[[], None]) -> Iterator[None]:
    """Call ``stop`` at the first signal that ends a command; a second one has its usual effect."""
    before = {number: signal.getsignal(number) for number in ending_signals()}

    def on_signal(number: int, _frame: FrameType | None) -> None:
        signal.signal(number, before[signal.Signals(number)])
        stop()

    with _handled(on_signal):
        if _interrupted.is_set():
            stop()
        yield


@contextmanager
def _handled(handler: Callable[[int, FrameType | None], Any]) -> Iterator[None]:
    """Handle the signals that end a command; outside the main thread, the owner has to."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number in ending_signals()}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)
