"""Which worker has which system.

All of a system goes to one worker: its parameters may come under other component ids than its
IMU's. A system stays where it is, since its estimate is there. A new one goes to the worker with
the least to do.
"""

from collections import Counter


class Assignment:
    """Systems to workers, numbered from 0."""

    def __init__(self, workers: int) -> None:
        self._workers = range(workers)
        self._of: dict[int, int] = {}
        self._frames: Counter[int] = Counter()  # by system, in the current window
        self._usual: dict[int, int] = {}  # in the last whole one

    def worker(self, system_id: int) -> int:
        """The worker of a system, which is chosen if the system is new."""
        self._frames[system_id] += 1
        worker = self._of.get(system_id)
        if worker is None:
            loads = self._loads()
            worker = self._of[system_id] = min(self._workers, key=lambda each: loads[each])
        return worker

    def known(self, system_id: int) -> int | None:
        """The worker of a system; None if the system has not come yet."""
        return self._of.get(system_id)

    def systems(self, worker: int) -> list[int]:
        """The systems that a worker has."""
        return sorted(system for system, of in self._of.items() if of == worker)

    def close_window(self) -> None:
        """Take what each system has sent since the last call as its usual rate; once a second."""
        self._usual = {system: self._frames[system] for system in self._of}
        self._frames.clear()

    def _loads(self) -> list[tuple[float, int]]:
        """Frames a window and systems of each worker.

        A system that is new, or was new in the last window, counts as much as the others in the
        mean.
        """
        known = [frames for frames in self._usual.values() if frames]
        mean = sum(known) / len(known) if known else 1.0
        loads = [(0.0, 0) for _ in self._workers]
        for system, worker in self._of.items():
            frames, systems = loads[worker]
            loads[worker] = (frames + self._usual.get(system, mean), systems + 1)
        return loads
