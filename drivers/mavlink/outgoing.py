"""What a link sends: requests for a rate where a person asked for them, and heartbeats.

Everything comes from component 191, an onboard computer; never from a ground station.
"""

import time
from collections import deque

from drivers.endpoint import Endpoint
from drivers.events import Event, Notice, VehicleId
from drivers.mavlink.constants import (
    MAV_AUTOPILOT_INVALID,
    MAV_COMP_ID_ONBOARD_COMPUTER,
    MAV_TYPE_ONBOARD_CONTROLLER,
)
from drivers.mavlink.encoder import FrameEncoder, heartbeat
from drivers.mavlink.gate import Policy
from drivers.mavlink.stream_request import StreamRequest

MOST_UNSENT_FRAMES = 64  # new ones replace the oldest
HEARTBEAT_S = 1.0


class Outbound:
    """Frames to send: answers to events, and heartbeats of an endpoint that must be the first.

    Raises:
        InputError: the requested rate is not positive.
    """

    def __init__(
        self, endpoint: Endpoint, request_rate_hz: float | None, policy: Policy, key: bytes | None
    ) -> None:
        self._request = None if request_rate_hz is None else StreamRequest(request_rate_hz)
        # nobody can answer an address that never sends anything
        self._sends_heartbeats = endpoint.kind == "udpout"
        self._heartbeat_due_s = 0.0
        self._key = key
        self._stamp = None if policy.signing is None else policy.signing.stamp
        self._encoders: dict[int, FrameEncoder] = {}
        self._frames: deque[bytes] = deque(maxlen=MOST_UNSENT_FRAMES)

    def react(self, events: list[Event], now_us: int) -> list[Notice]:
        """Ask for rates because of the events; returns what a person should know of it."""
        if self._request is None:
            return []
        messages, notices = self._request.take(events, now_us)
        for each in messages:
            self._frames.append(self._encoder(each.system_id).frame(each.message, now_us))
        return notices

    def take_frames(self, now_us: int) -> list[bytes]:
        """Every frame that is to be sent by now."""
        now_s = time.monotonic()
        if self._sends_heartbeats and now_s >= self._heartbeat_due_s:
            self._heartbeat_due_s = now_s + HEARTBEAT_S
            own_system = next(iter(self._encoders), 1)  # of the first vehicle that was asked
            message = heartbeat(MAV_TYPE_ONBOARD_CONTROLLER, MAV_AUTOPILOT_INVALID)
            self._frames.append(self._encoder(own_system).frame(message, now_us))
        frames = list(self._frames)
        self._frames.clear()
        return frames

    def _encoder(self, system_id: int) -> FrameEncoder:
        if system_id not in self._encoders:
            sender = VehicleId(system_id, MAV_COMP_ID_ONBOARD_COMPUTER)
            self._encoders[system_id] = FrameEncoder(sender, self._key, stamp=self._stamp)
        return self._encoders[system_id]
