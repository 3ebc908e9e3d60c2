"""What a vehicle's service has counted, for its result and for whoever goes on for it."""

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
