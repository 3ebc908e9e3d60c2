"""A vehicle as the page shows it: numbers to draw, and the words that every view has."""

from typing import Any

from fuzzbee.table_model import Row
from fuzzbee.verdict import (
    Judgement,
    compass_off_deg,
    heading_text,
    other_imus,
    row_verdict,
    warning_text,
)
from service.records import AttitudeRecord, StatusRecord
from service.second_opinion import Verdict


def shown(row: Row) -> dict[str, Any]:
    """What the page is sent of a vehicle; degrees, and the IMU sample's age."""
    attitude, judged = row.valid_attitude, row_verdict(row)
    return {
        "name": row.name,
        "state": row.state_text,
        "flight": row.flight_words,
        "word": judged.word,
        "level": int(judged.overall),
        "reasons": [(int(each.level), each.text) for each in judged.caveats],
        "plates": [(int(each.level), each.sentence or each.text) for each in judged.caveats],
        "age_ms": None if row.age_ms is None else round(row.age_ms),
        **_of_status(row.status),
        "attitude": None if attitude is None else _of_attitude(attitude, judged),
    }


def _of_status(status: StatusRecord | None) -> dict[str, Any]:
    """The IMU, how far off the autopilot's roll, pitch and heading are, and the warnings."""
    if status is None:
        return {
            "imu": "",
            "rate_hz": None,
            "autopilot": None,
            "warnings": [],
            "imus": [],
            "compass": None,
        }
    other = status.autopilot
    differs = other is not None and other.verdict == Verdict.DIFFERS
    off = (other.roll_deg, other.pitch_deg, other.heading_deg) if other and differs else None
    return {
        "imu": status.imu_message or "",
        "rate_hz": round(status.imu_rate_hz, 1),
        "autopilot": off,
        "compass": compass_off_deg(status),
        "warnings": [f"warning: {warning_text(word, status)}" for word in status.warnings],
        "imus": [
            f"{name}: {each.inclination_deg:.1f}°, {each.rate_deg_s:.1f}°/s"
            for name, each in other_imus(status).items()
        ],
    }


def _of_attitude(attitude: AttitudeRecord, judged: Judgement) -> dict[str, Any]:
    sigma = attitude.sigma_deg
    return {
        "euler_deg": [round(angle, 2) for angle in attitude.euler_deg],
        "sigma_deg": [round(sigma.inclination, 2), round(sigma.heading, 2)],
        "levels": [int(judged.horizon), int(judged.heading)],
        "horizon": judged.horizon_text,
        "heading": heading_text(attitude),
        "north": judged.heading_text,
        "has_north": attitude.heading_reference != "none",
    }
