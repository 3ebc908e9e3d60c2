"""Schemas of the messages in an MCAP file, for programs that draw messages by their type.

``foxglove.FrameTransform``: https://docs.foxglove.dev/docs/sdk/schemas/frame-transform.
``sensor_msgs/msg/Imu``: https://docs.ros.org/en/jazzy/p/sensor_msgs/msg/Imu.html, with the types
that it is made of, as https://mcap.dev/spec/registry#ros2msg wants them.
"""

import json
from collections.abc import Sequence
from typing import Any

FRAME_TRANSFORM = "foxglove.FrameTransform"
IMU = "sensor_msgs/msg/Imu"

_BETWEEN = f"\n{'=' * 80}\nMSG: "
IMU_DEFINITION = _BETWEEN.join(
    (
        """std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance""",
        "std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id",
        "builtin_interfaces/Time\nint32 sec\nuint32 nanosec",
        "geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w",
        "geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z",
    )
)


def _numbers(*names: str) -> dict[str, Any]:
    return {"type": "object", "properties": {name: {"type": "number"} for name in names}}


def frame_transform_schema() -> bytes:
    """The JSON schema of ``foxglove.FrameTransform``."""
    whole = {"type": "integer"}
    stamp = {"type": "object", "title": "time", "properties": {"sec": whole, "nsec": whole}}
    properties = {
        "timestamp": stamp,
        "parent_frame_id": {"type": "string"},
        "child_frame_id": {"type": "string"},
        "translation": {"title": "foxglove.Vector3", **_numbers("x", "y", "z")},
        "rotation": {"title": "foxglove.Quaternion", **_numbers("x", "y", "z", "w")},
    }
    return _schema({"title": FRAME_TRANSFORM, "properties": properties})


def table_schema(columns: Sequence[str]) -> bytes:
    """The JSON schema of a row: numbers by name, and one word."""
    kinds = {name: {"type": "number"} for name in columns}
    if "heading_reference" in kinds:
        kinds["heading_reference"] = {"type": "string"}
    return _schema({"properties": kinds})


def _schema(content: dict[str, Any]) -> bytes:
    return json.dumps({"type": "object", **content}).encode()
