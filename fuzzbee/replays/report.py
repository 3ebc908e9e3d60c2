"""What ``replay --json`` prints: of a log, and of the paper's experiment."""

import msgspec

# What they are called for a person; the truth, a simulator's or a table's own, goes first
REFERENCES = {"sim": "truth", "autopilot": "autopilot"}


class VehicleSummary(msgspec.Struct, frozen=True):
    """Whose IMU it was; names as in MAVLink's enumerations, None without a HEARTBEAT."""

    system_id: int
    component_id: int
    autopilot: str | None
    type: str | None


class ImuSummary(msgspec.Struct, frozen=True):
    """What arrived."""

    message: str  # the one that was used most
    samples: int
    messages: dict[str, int]  # samples used of each
    median_rate_hz: float | None  # of the stream while it comes
    mean_rate_hz: float | None  # what really came in a second
    worst_gap_s: float | None  # by the vehicle's clock
    worst_arrival_gap_s: float | None  # by the log's stamps
    rates: str = "imu"


class ErrorSummary(msgspec.Struct, frozen=True):
    """Degrees. Heading and total are None where there is no heading to speak of."""

    total_rms: float | None = None
    heading_rms: float | None = None
    inclination_rms: float | None = None
    inclination_p95: float | None = None


class Coverage(msgspec.Struct, frozen=True):
    """Share of samples whose error lies under the published sigma; honest is 0.68."""

    inclination: float | None = None
    heading: float | None = None
    inclination_moving: float | None = None
    heading_moving: float | None = None


class ConstantTurn(msgspec.Struct, frozen=True):
    """One turn of the body that fits best, and what is left of the inclination's errors without."""

    turn_deg: float  # by how much it tilts the vertical, RMS over the samples
    inclination_rms: float
    inclination_coverage: float
    inclination_coverage_moving: float | None


class Retuning(msgspec.Struct, frozen=True):
    """A change of the profile while it ran: when, to what, why, and the share of the cost saved."""

    time_s: float
    reason: str
    gain: float
    update: dict[str, dict[str, float]]


class RetunedSummary(msgspec.Struct, frozen=True):
    """All changes while it ran."""

    count: int
    changes: list[Retuning]


class DifferenceSummary(msgspec.Struct, frozen=True):
    """A time for which the autopilot's attitude and ours differed, and the evidence."""

    begin_s: float
    end_s: float
    inclination_deg: float  # the largest
    heading_deg: float
    wrong: str  # "autopilot", "ours", or ""
    evidence: str


class Report(msgspec.Struct, frozen=True, kw_only=True):
    """What every replay reports; errors and coverage are of the samples that count."""

    source: str
    vehicle: VehicleSummary
    imu: ImuSummary
    duration_s: float
    reference: str | None
    error_deg: ErrorSummary
    coverage: Coverage = Coverage()
    peers: dict[str, ErrorSummary] = {}
    convergence_s: float | None
    mean_gain: float
    rejected: dict[str, int] = {}
    wall_s: float = 0.0


class LogReport(Report, frozen=True, kw_only=True):
    """Schema of ``replay LOG --json``."""

    heading_references: dict[str, int] = {}  # scored samples by what their heading is measured from
    constant_turn: ConstantTurn | None = None
    differences: list[DifferenceSummary] = []  # from the autopilot's attitude
    agreement: dict[str, int] = {}  # how many looks ended with which verdict
    window_s: tuple[float, float] | msgspec.UnsetType = msgspec.UNSET  # with --from or --to only
    retuned: RetunedSummary | msgspec.UnsetType = msgspec.UNSET  # with --retune only
    profile: str | msgspec.UnsetType = msgspec.UNSET  # with several only


class SimulationReport(Report, frozen=True, kw_only=True):
    """Schema of ``replay sim: --json``: that of a log, and the paper's figures."""

    seeds: tuple[int, int]
    cost: float
    cost_per_seed: list[float]
    steady_state_error: float
    settling_s: float | None
