"""Attitudes for ROS 2 nodes that use rmw_zenoh: keys, attachments and tokens as it has them.

Source: https://github.com/ros2/rmw_zenoh/blob/rolling/docs/design.md. A topic's
key is ``{domain}/{topic}/{type}/{type hash}``. Each message carries an attachment:
sequence number and time in ns (8 bytes each, little endian), then the length
(1 byte) and the 16 bytes of the publisher's id. Liveliness tokens under
``@ros2_lv`` show of the node and its publishers, so that ``ros2 topic list``
knows them.
"""

import hashlib
import re
from collections.abc import Sequence
from contextlib import suppress
from itertools import count
from struct import Struct
from typing import Any

import zenoh

from drivers.events import VehicleId
from service.records import AttitudeRecord, Evicted, Output, Published, StatusRecord, vehicle_name
from service.sinks import ros_messages as ros
from service.zenoh_session import Topic

NODE = "fuzzbee"
MAX_DOMAIN = 232  # the largest that ROS 2 allows
NOT_SET = "%"  # namespace and enclave; also what a slash becomes inside a token
# Quality of service: reliable, volatile and keep-last are rmw_zenoh's defaults, which are left out;
# the depth is 10
QUALITY = "::,10:,:,:,,"

_ATTACHMENT = Struct("<qqB16s")
_NOT_ALLOWED = re.compile(r"[^A-Za-z0-9_]+")


class RosSink:
    """Publishes on a session that stays its owner's: what nodes, tf2 and diagnostics listen to.

    ``/{prefix}/vehicle_{name}/imu`` for each vehicle, and for all of them ``/tf`` and
    ``/diagnostics``.
    """

    name = "ros"

    def __init__(self, session: zenoh.Session, prefix: str, domain: int = 0) -> None:
        self._session = session
        self._prefix = prefix
        self._domain = domain
        self._publishers: dict[str, Publisher] = {}  # by topic
        self._numbers = count(1)  # of entities
        self._node: Any = session.liveliness().declare_token(self._token("NN", 0))

    def handle(self, outputs: Sequence[Output]) -> None:
        """Publish the attitudes and statuses among the outputs."""
        for output in outputs:
            match output:
                case Published(vehicle=vehicle, record=AttitudeRecord() as record):
                    # with the specific force of the last sample, and as a transform
                    acc = None if output.sample is None else output.sample.acc_m_s2
                    body, now_us = f"{_hardware(vehicle)}/base_link", record.time_unix_us
                    topic = imu_topic(self._prefix, vehicle)
                    self._publish(topic, ros.IMU_TYPE, ros.imu_message(record, acc, body), now_us)
                    self._publish(ros.TF_TOPIC, ros.TF_TYPE, ros.tf_message(record, body), now_us)
                case Published(vehicle=vehicle, record=StatusRecord() as status):
                    now_us = output.time_unix_us
                    message = ros.diagnostics_message(status, now_us, _hardware(vehicle))
                    self._publish(ros.DIAGNOSTICS_TOPIC, ros.DIAGNOSTICS_TYPE, message, now_us)
                case Evicted(vehicle=vehicle):
                    imu = self._publishers.pop(imu_topic(self._prefix, vehicle), None)
                    if imu is not None:
                        imu.withdraw()

    def close(self) -> None:
        """Withdraw the publishers and the node."""
        with suppress(zenoh.ZError):  # the session may be closed already, and they with it
            for publisher in self._publishers.values():
                publisher.withdraw()
            self._node.undeclare()

    def _publish(self, topic: str, kind: str, message: bytes, unix_us: int) -> None:
        if topic not in self._publishers:
            node = self._token("MP", next(self._numbers))
            token = f"{node}/{topic.replace('/', NOT_SET)}/{kind}/{QUALITY}"
            key = f"{self._domain}{topic}/{kind}"
            self._publishers[topic] = Publisher(self._session, key, token)
        self._publishers[topic].publish(message, unix_us)

    def _token(self, kind: str, number: int) -> str:
        """The node's liveliness token, or the beginning of a publisher's."""
        entity = f"@ros2_lv/{self._domain}/{self._session.zid()}/0/{number}/{kind}"
        return f"{entity}/{NOT_SET}/{NOT_SET}/{NODE}"


class Publisher(Topic):
    """One topic, with the token that shows it."""

    def __init__(self, session: zenoh.Session, key: str, token: str) -> None:
        super().__init__(session, key)
        self._token: Any = session.liveliness().declare_token(token)
        # Subscribers show publishers apart by it; rmw_zenoh hashes the token, too
        self._id = hashlib.blake2b(token.encode(), digest_size=16).digest()
        self._numbers = count(1)  # of messages

    def publish(self, message: bytes, unix_us: int) -> None:
        """Publish one message of that time."""
        self.put(message, _ATTACHMENT.pack(next(self._numbers), unix_us * 1000, 16, self._id))

    def withdraw(self) -> None:
        """Take the token back, and the key."""
        self._token.undeclare()
        super().withdraw()


def _hardware(vehicle: VehicleId) -> str:
    """A vehicle's name in frames and diagnostics."""
    return _word(f"vehicle_{vehicle_name(vehicle)}")


def imu_topic(prefix: str, vehicle: VehicleId) -> str:
    """The topic's full name, of letters, digits and underscores as ROS wants them."""
    parts = (*prefix.split("/"), f"vehicle_{vehicle_name(vehicle)}", "imu")
    return "/" + "/".join(_word(part) for part in parts)


def _word(part: str) -> str:
    word = _NOT_ALLOWED.sub("_", part)
    return f"_{word}" if word[:1].isdigit() else word
