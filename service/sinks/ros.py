"""Attitudes for ROS 2 nodes that use rmw_zenoh: keys, attachments and tokens as it has them.

Source: https://github.com/ros2/rmw_zenoh/blob/rolling/docs/design.md. A topic's
key is ``{domain}/{topic}/{type}/{type hash}``. Each message carries an attachment:
sequence number and time in ns (8 bytes each, little endian), then the length
(1 byte) and the 16 bytes of the publisher's id. Liveliness tokens under
``@ros2_lv`` tell of the node and its publishers, so that ``ros2 topic list``
knows them.
"""

import hashlib
import re
from collections.abc import Sequence
from contextlib import suppress
from struct import Struct
from typing import TYPE_CHECKING, Any

from drivers.events import VehicleId
from estimator.types import ImuSample
from service.records import AttitudeRecord, Output, Published, vehicle_name
from service.sinks.ros_imu import TYPE_HASH, TYPE_NAME, imu_message

if TYPE_CHECKING:
    import zenoh

NODE = "fuzzbee"
MAX_DOMAIN = 232  # the largest that ROS 2 allows
NOT_SET = "%"  # namespace and enclave; also what a slash becomes inside a token
# Quality of service: reliable, volatile and keep-last are rmw_zenoh's defaults, which are left out;
# the depth is 10
QUALITY = "::,10:,:,:,,"

_ATTACHMENT = Struct("<qqB16s")
_NOT_ALLOWED = re.compile(r"[^A-Za-z0-9_]+")


class RosSink:
    """Publishes ``/{prefix}/vehicle_{name}/imu`` on a session that stays its owner's."""

    name = "ros"

    def __init__(self, session: "zenoh.Session", prefix: str, domain: int = 0) -> None:
        self._session = session
        self._prefix = prefix
        self._domain = domain
        self._publishers: dict[VehicleId, ImuPublisher] = {}
        self._node: Any = session.liveliness().declare_token(self._token("NN", 0))

    def handle(self, outputs: Sequence[Output]) -> None:
        """Publish the attitudes among the outputs."""
        for output in outputs:
            if isinstance(output, Published) and isinstance(output.record, AttitudeRecord):
                self._publisher(output.vehicle).put(output.record, output.sample)

    def close(self) -> None:
        """Withdraw the publishers and the node."""
        import zenoh

        with suppress(zenoh.ZError):  # the session may be closed already, and they with it
            for publisher in self._publishers.values():
                publisher.close()
            self._node.undeclare()

    def _publisher(self, vehicle: VehicleId) -> "ImuPublisher":
        if vehicle not in self._publishers:
            topic = imu_topic(self._prefix, vehicle)
            key = f"{self._domain}{topic}/{TYPE_NAME}/{TYPE_HASH}"
            token = self._token("MP", 1 + len(self._publishers), topic)
            frame = _word(f"vehicle_{vehicle_name(vehicle)}") + "/base_link"
            self._publishers[vehicle] = ImuPublisher(self._session, key, token, frame)
        return self._publishers[vehicle]

    def _token(self, kind: str, number: int, topic: str | None = None) -> str:
        entity = f"@ros2_lv/{self._domain}/{self._session.zid()}/0/{number}/{kind}"
        node = f"{entity}/{NOT_SET}/{NOT_SET}/{NODE}"
        if topic is None:
            return node
        return f"{node}/{topic.replace('/', '%')}/{TYPE_NAME}/{TYPE_HASH}/{QUALITY}"


class ImuPublisher:
    """One vehicle's topic."""

    def __init__(self, session: "zenoh.Session", key: str, token: str, frame_id: str) -> None:
        import zenoh

        self._publisher: Any = session.declare_publisher(
            key, congestion_control=zenoh.CongestionControl.DROP, express=False
        )
        self._token: Any = session.liveliness().declare_token(token)
        # Subscribers tell publishers apart by it; rmw_zenoh hashes the token, too
        self._id = hashlib.blake2b(token.encode(), digest_size=16).digest()
        self._frame_id = frame_id
        self._sequence = 1

    def put(self, record: AttitudeRecord, sample: ImuSample | None) -> None:
        """Publish one message, with the specific force of the last sample."""
        acc = None if sample is None else sample.acc_m_s2
        attachment = _ATTACHMENT.pack(self._sequence, record.time_unix_us * 1000, 16, self._id)
        self._sequence += 1
        self._publisher.put(imu_message(record, acc, self._frame_id), attachment=attachment)

    def close(self) -> None:
        """Withdraw the publisher."""
        self._token.undeclare()
        self._publisher.undeclare()


def imu_topic(prefix: str, vehicle: VehicleId) -> str:
    """The topic's full name, of letters, digits and underscores as ROS wants them."""
    parts = (*prefix.split("/"), f"vehicle_{vehicle_name(vehicle)}", "imu")
    return "/" + "/".join(_word(part) for part in parts)


def _word(part: str) -> str:
    word = _NOT_ALLOWED.sub("_", part)
    return f"_{word}" if word[:1].isdigit() else word
