"""A published status as the bytes of ``diagnostic_msgs/msg/DiagnosticArray``. No I/O and no clock.

https://docs.ros.org/en/jazzy/p/diagnostic_msgs/msg/DiagnosticArray.html.
"""

from service.health import State
from service.records import StatusRecord
from service.sinks.cdr import CdrWriter

TOPIC = "/diagnostics"
TYPE_NAME = "diagnostic_msgs::msg::dds_::DiagnosticArray_"
# REP 2016's hash of the type's definition; the same in Humble, Jazzy and Kilted
TYPE_HASH = "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"

OK, WARN, ERROR, STALE = 0, 1, 2, 3
LEVELS = {
    State.WAITING: STALE,
    State.ALIGNING: WARN,
    State.RUNNING: OK,
    State.DEGRADED: WARN,
    State.LOST: ERROR,
}


def diagnostics_message(record: StatusRecord, unix_us: int, hardware: str) -> bytes:
    """One status named after the ``hardware``; a warning makes it WARN at least."""
    level = LEVELS[State(record.state)]
    if record.warnings or record.overloaded:
        level = max(level, WARN)
    out = CdrWriter()
    out.put_stamp(unix_us)
    out.put_text("")
    out.put_count(1)
    out.put_byte(level)
    out.put_text(f"{hardware}: attitude")
    out.put_text(", ".join((record.state, *record.warnings)))
    out.put_text(hardware)
    values = _values(record)
    out.put_count(len(values))
    for key, value in values.items():
        out.put_text(key)
        out.put_text(value)
    return out.message


def _values(record: StatusRecord) -> dict[str, str]:
    """What a person looks for, by the names that the status has on Zenoh."""
    values = {
        "imu_message": record.imu_message or "none",
        "imu_rate_hz": f"{record.imu_rate_hz:.1f}",
        "worst_gap_s": f"{record.worst_gap_s:.3f}",
        "rates": record.rates,
        "published_hz": f"{record.published_hz:.1f}",
        "dropped": str(record.dropped),
        "shed": str(record.shed),
        "malformed": str(record.malformed),
    }
    if (said := record.autopilot) is not None:
        values["autopilot"] = f"{said.verdict} {said.in_short}" if said.axis else said.verdict
    return values | {f"rejected.{reason}": str(count) for reason, count in record.rejected.items()}
