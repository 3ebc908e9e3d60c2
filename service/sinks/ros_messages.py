"""Published records as the bytes of ROS 2 messages. No I/O and no clock.

Values are in CDR, little endian (https://www.omg.org/spec/DDSI-RTPS, section 10): a header of four
bytes; numbers are aligned to their size, counted from behind the header; a text has its length with
the zero at its end. Frames change from NED/FRD to ENU/FLU (REP 103, REP 105) through
``estimator/geometry/frames.py``. Definitions: https://docs.ros.org/en/jazzy/p/ sensor_msgs,
tf2_msgs, diagnostic_msgs. A type's hash is that of REP 2016, the same in Humble, Jazzy and Kilted.
"""

from struct import calcsize, pack

from estimator.geometry.frames import flu_from_frd, swap_ned_enu
from estimator.types import ZERO_VEC3, Vec3
from service.records import AttitudeRecord, State, StatusRecord

HEADER = b"\x00\x01\x00\x00"


class CdrWriter:
    """Appends one value after the other; ``message`` is what they are together."""

    def __init__(self) -> None:
        self._body = bytearray()

    @property
    def message(self) -> bytes:
        """Header and all values so far."""
        return HEADER + bytes(self._body)

    def put(self, kind: str, *values: float) -> None:
        """Numbers of one kind of ``struct``, aligned to its size."""
        self._body += bytes(-len(self._body) % calcsize(f"<{kind}"))
        self._body += pack(f"<{len(values)}{kind}", *values)

    def put_stamp(self, unix_us: int) -> None:
        """A ``builtin_interfaces/Time``."""
        seconds, micros = divmod(unix_us, 1_000_000)
        self.put("i", seconds)
        self.put("I", 1000 * micros)

    def put_text(self, *texts: str) -> None:
        """Strings."""
        for text in texts:
            content = text.encode() + b"\0"
            self.put("I", len(content))
            self._body += content


# A type's name and hash, as keys have them
IMU_TYPE = (
    "sensor_msgs::msg::dds_::Imu_/"
    "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b"
)

# By the message's definition: a covariance that is unknown, and a quantity without any value
UNKNOWN_COVARIANCE = (0.0,) * 9
NO_VALUE = (-1.0, *(0.0,) * 8)


def imu_message(record: AttitudeRecord, acc_frd_m_s2: Vec3 | None, frame_id: str) -> bytes:
    """The message at the record's time.

    ``acc_frd_m_s2`` is the specific force, which ROS calls linear acceleration
    (at rest it points up); without it the message is marked so.
    """
    w, x, y, z = swap_ned_enu(record.q_ned_frd)
    level, heading = record.variances_rad2
    out = CdrWriter()
    out.put_stamp(record.time_unix_us)
    out.put_text(frame_id)
    out.put(
        "d",
        *(x, y, z, w),
        *(level, 0.0, 0.0, 0.0, level, 0.0, 0.0, 0.0, heading),  # by rows, about east, north and up
        *flu_from_frd(record.rate_rad_s),
        *UNKNOWN_COVARIANCE,
        *flu_from_frd(ZERO_VEC3 if acc_frd_m_s2 is None else acc_frd_m_s2),
        *(NO_VALUE if acc_frd_m_s2 is None else UNKNOWN_COVARIANCE),
    )
    return out.message


TF_TOPIC = "/tf"
TF_TYPE = (
    "tf2_msgs::msg::dds_::TFMessage_/"
    "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
)
WORLD = "map"  # east, north, up
NO_PLACE = (0.0, 0.0, 0.0)


def tf_message(record: AttitudeRecord, child: str) -> bytes:
    """One transform, from ``child`` (forward, left, up) to the world; the place stays zero."""
    w, x, y, z = swap_ned_enu(record.q_ned_frd)
    out = CdrWriter()
    out.put("I", 1)
    out.put_stamp(record.time_unix_us)
    out.put_text(WORLD, child)
    out.put("d", *NO_PLACE, x, y, z, w)
    return out.message


DIAGNOSTICS_TOPIC = "/diagnostics"
DIAGNOSTICS_TYPE = (
    "diagnostic_msgs::msg::dds_::DiagnosticArray_/"
    "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"
)

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
    out.put("I", 1)
    out.put("B", level)
    state = ", ".join((record.state, *record.warnings))
    out.put_text(f"{hardware}: attitude", state, hardware)
    values = _values(record)
    out.put("I", len(values))
    for pair in values.items():
        out.put_text(*pair)
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
    if (opinion := record.autopilot) is not None:
        words = f"{opinion.verdict} {opinion.in_short}" if opinion.axis else opinion.verdict
        values["autopilot"] = words
    return values | {f"rejected.{reason}": str(count) for reason, count in record.rejected.items()}
