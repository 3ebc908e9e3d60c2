"""What to leave out when more arrives than can be handled: the older of two that say the same."""

from collections import Counter
from typing import NamedTuple

from drivers.events import Shed, VehicleId
from drivers.mavlink.framing import Frame
from drivers.mavlink.imu_messages import imu_message_name

# Each of these makes the one before it old. What is said once (a parameter, an answer) or tells
# who is there (HEARTBEAT) is never left out.
STREAMS = frozenset(
    {
        26,  # SCALED_IMU
        27,  # RAW_IMU
        105,  # HIGHRES_IMU
        116,  # SCALED_IMU2
        129,  # SCALED_IMU3
        24,  # GPS_RAW_INT
        30,  # ATTITUDE
        31,  # ATTITUDE_QUATERNION
        32,  # LOCAL_POSITION_NED
        33,  # GLOBAL_POSITION_INT
        108,  # SIM_STATE
        164,  # SIMSTATE
        193,  # EKF_STATUS_REPORT
        230,  # ESTIMATOR_STATUS
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
