"""What was counted about a vehicle, for the result and for a worker that takes it over."""

import msgspec


class Counts(msgspec.Struct, frozen=True):
    """One vehicle's counts so far, and what it was last.

    ``attitudes`` and ``statuses`` are the sequence numbers of the next ones.
    """

    state: str
    motion: str | None  # of fuzzbee's own vehicle
    imu_message: str | None
    imu_rate_hz: float
    worst_gap_us: int
    samples: int
    shed: int
    attitudes: int
    statuses: int
    rejected: dict[str, int]
