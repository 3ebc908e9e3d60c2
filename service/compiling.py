"""The filter compiled beside the service, which interprets it meanwhile.

A first start would otherwise be mute for a minute on a laptop, and for many on a small computer.
"""

import subprocess
import threading
import time
from collections.abc import Callable, Iterable

from drivers.closing import Closing
from estimator.compilation.interpreted import set_interpreting
from estimator.estimator import Estimator
from estimator.profile import Profile
from service.records import Message
from service.warm_up import await_end, helpers, warm_up

BEGUN = (
    "compiling the filter, the first time only: until that is done it is interpreted, "
    "enough for some hundred samples a second"
)
ENDING_S = 1.0  # what is compiled in this process, as no helper could, cannot be ended


class Compiling(Closing):
    """Made, asked and closed by the thread of the loop, whose estimators it changes over."""

    def __init__(self, profile: Profile, gain: float | None) -> None:
        self._profile = profile
        self._gain = gain
        self._begun_s = time.monotonic()
        self._is_closed = threading.Event()
        self._is_done = threading.Event()
        self._helpers: list[subprocess.Popen[bytes]] = []
        self._thread = threading.Thread(target=self._compile, name="compiler", daemon=True)
        set_interpreting(True)
        self._thread.start()

    def change_over(self, estimators: Callable[[], Iterable[Estimator]]) -> list[Message]:
        """Once it is compiled: have these estimators go on with that, from where they are."""
        if not self._is_done.is_set():
            return []
        self._is_done.clear()
        set_interpreting(False)
        for estimator in estimators():
            estimator.snapshot = estimator.snapshot
        return [Message(f"the filter is compiled, after {time.monotonic() - self._begun_s:.0f} s")]

    def close(self) -> None:
        """End the helpers; what they have compiled is kept."""
        self._is_closed.set()
        for helper in self._helpers:
            helper.kill()
        self._thread.join(ENDING_S)
        set_interpreting(False)

    def _compile(self) -> None:
        with helpers(self._profile) as self._helpers:
            for helper in self._helpers:
                await_end(helper)
        if not self._is_closed.is_set():
            warm_up(self._profile, self._gain)  # loads what they have made
            self._is_done.set()
