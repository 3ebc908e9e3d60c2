"""A vehicle as the page shows it: numbers to draw, and the words that every view has."""

from typing import Any

from fuzzbee.table_model import Row
from fuzzbee.verdict import (
    Judgement,
    compass_off_deg,
    differing,
    heading_text,
    other_imus,
    row_verdict,
    warning_text,
)
from service.records import AttitudeRecord


def shown(row: Row) -> dict[str, Any]:
    """What the page is sent of a vehicle; degrees, and the IMU sample's age.

    ``autopilot`` is how far off its roll, pitch and heading are, if they differ.
    """
    attitude, judged, status = row.valid_attitude, row_verdict(row), row.status
    theirs = differing(status)
    return {
        "name": row.name,
        "state": row.state_text,
        "flight": row.flight_words,
        "word": judged.word,
        "level": int(judged.overall),
        "reasons": [(int(each.level), each.text) for each in judged.caveats],
        "plates": [(int(each.level), each.sentence or each.text) for each in judged.caveats],
        "age_ms": None if row.age_ms is None else round(row.age_ms),
        "imu": (status and status.imu_message) or "",
        "rate_hz": status and round(status.imu_rate_hz, 1),
        "autopilot": theirs and (theirs.roll_deg, theirs.pitch_deg, theirs.heading_deg),
        "compass": compass_off_deg(status),
        "warnings": [f"warning: {warning_text(x, status)}" for x in status.warnings]
        if status
        else [],
        "imus": [
            f"{name}: {each.inclination_deg:.1f}°, {each.rate_deg_s:.1f}°/s"
            for name, each in (other_imus(status) if status else {}).items()
        ],
        "attitude": None if attitude is None else _of_attitude(attitude, judged),
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
