"""What to leave out when more arrives than can be handled: the older of two that say the same."""

from collections import Counter
from typing import NamedTuple

from drivers.events import Shed, VehicleId
from drivers.mavlink.constants import (
    ATTITUDE_ID,
    ATTITUDE_QUATERNION_ID,
    EKF_STATUS_REPORT_ID,
    ESTIMATOR_STATUS_ID,
    GLOBAL_POSITION_INT_ID,
    GPS_RAW_INT_ID,
    HIGHRES_IMU_ID,
    LOCAL_POSITION_NED_ID,
    RAW_IMU_ID,
    SCALED_IMU2_ID,
    SCALED_IMU3_ID,
    SCALED_IMU_ID,
    SIM_STATE_ID,
    SIMSTATE_ID,
)
from drivers.mavlink.framing import Frame
from drivers.mavlink.imu_messages import imu_message_name

# Each of these makes the one before it old. What is said once (a parameter, an answer) or tells
# who is there (HEARTBEAT) is never left out.
STREAMS = frozenset(
    {
        SCALED_IMU_ID,
        RAW_IMU_ID,
        HIGHRES_IMU_ID,
        SCALED_IMU2_ID,
        SCALED_IMU3_ID,
        GPS_RAW_INT_ID,
        ATTITUDE_ID,
        ATTITUDE_QUATERNION_ID,
        LOCAL_POSITION_NED_ID,
        GLOBAL_POSITION_INT_ID,
        SIM_STATE_ID,
        SIMSTATE_ID,
        EKF_STATUS_REPORT_ID,
        ESTIMATOR_STATUS_ID,
    }
)


class Arrived(NamedTuple):
    """A frame and when it arrived (host's Unix time)."""

    arrival_us: int
    frame: Frame


def newest(arrived: list[Arrived]) -> tuple[list[Arrived], list[Shed]]:
    """Of each sender and stream the newest alone, all else, in order; and what was left out.

    Only IMU samples are counted: they are what an estimate is made of.
    """
    seen: set[tuple[int, int, int]] = set()
    kept: list[Arrived] = []
    shed: Counter[tuple[VehicleId, str]] = Counter()
    for each in reversed(arrived):
        frame = each.frame
        if frame.message_id in STREAMS:
            key = (frame.system_id, frame.component_id, frame.message_id)
            if key in seen:
                name = imu_message_name(frame.message_id)
                if name is not None:
                    shed[VehicleId(frame.system_id, frame.component_id), name] += 1
                continue
            seen.add(key)
        kept.append(each)
    kept.reverse()
    arrival_us = arrived[-1].arrival_us if arrived else 0
    return kept, [
        Shed(vehicle, arrival_us, message, samples) for (vehicle, message), samples in shed.items()
    ]
