"""A published attitude as the bytes of a ROS 2 ``tf2_msgs/msg/TFMessage``. No I/O and no clock.

https://docs.ros.org/en/jazzy/p/tf2_msgs/msg/TFMessage.html; frames after REP 103 and REP 105.
"""

from estimator.geometry.frames import enu_flu_from_ned_frd
from service.records import AttitudeRecord
from service.sinks.cdr import CdrWriter

TOPIC = "/tf"
TYPE_NAME = "tf2_msgs::msg::dds_::TFMessage_"
# REP 2016's hash of the type's definition; the same in Humble, Jazzy and Kilted
TYPE_HASH = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
WORLD = "map"  # east, north, up
NO_PLACE = (0.0, 0.0, 0.0)


def tf_message(record: AttitudeRecord, child: str) -> bytes:
    """One transform, from ``child`` (forward, left, up) to the world; the place stays zero."""
    w, x, y, z = enu_flu_from_ned_frd(record.q_ned_frd)
    out = CdrWriter()
    out.put_count(1)
    out.put_stamp(record.time_unix_us)
    out.put_text(WORLD)
    out.put_text(child)
    out.put_numbers(*NO_PLACE, x, y, z, w)
    return out.message
