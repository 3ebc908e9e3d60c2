"""What a link sends: requests for a rate where a person asked for them, and heartbeats.

Everything comes from component 191, an onboard computer; never from a ground station. A vehicle is
asked with MAV_CMD_SET_MESSAGE_INTERVAL; after its COMMAND_ACK the stream is measured on the
vehicle's own clock. If a ground station resets the rate, it is asked again after a pause that
doubles; after ``MOST_REQUESTS`` in a row that brought nothing, a line reports it.

Source: https://mavlink.io/en/services/command.html (retries with a growing confirmation count) and
common.xml (MAV_CMD 511).
"""

from collections import deque
from dataclasses import dataclass
from math import isfinite
from typing import Literal

from drivers import events
from drivers.endpoint import Endpoint
from drivers.events import Event, Imu, Notice, VehicleId
from drivers.mavlink import constants as mav
from drivers.mavlink.encoder import FrameEncoder, Message, heartbeat, message_interval_request
from drivers.mavlink.gate import Policy
from drivers.mavlink.messages import ImuMessage, message_to_ask_for
from estimator.errors import InputError

MOST_UNSENT_FRAMES = 64  # new ones replace the oldest
HEARTBEAT_US = 1_000_000
ACK_TIMEOUT_US = 1_500_000
MOST_REPEATS = 3  # of one request without an answer, then it is a failed request
MEASURE_US = 3_000_000  # the stream is judged over this much of the vehicle's time
SILENCE_US = 5_000_000  # no IMU at all for this long after an ACK is a failed request
SHORTFALL = 0.7  # a stream slower than this part of what was asked for is asked for again;
# a lossy radio may eat some, a ground station's 2..4 Hz are far below
FIRST_PAUSE_US = 5_000_000
LONGEST_PAUSE_US = 80_000_000
MOST_REQUESTS = 6  # in a row without success
MOST_STREAMS = 512  # more senders of heartbeats than that are noise or an attack


@dataclass(slots=True)
class _Stream:
    """The stream asked of one vehicle, and when to act next."""

    vehicle: VehicleId
    message: ImuMessage
    due_us: int
    phase: Literal["asking", "measuring", "pausing", "given_up"] = "asking"
    repeats: int = 0
    failures: int = 0
    first_boot_us: int | None = None  # of the samples that are counted; None: from the next on
    count: int = 0
    is_noticed: bool = False

    def ask(self, now_us: int) -> None:
        """Begin a new request."""
        self.phase, self.repeats, self.due_us = "asking", 0, now_us


class Outbound:
    """Frames to send: requests of one rate from every vehicle on a link, and heartbeats.

    Heartbeats go into each system that is asked, and to an endpoint that must be the first to send.

    Raises:
        InputError: the requested rate is not positive.
    """

    def __init__(self, endpoint: Endpoint, rate_hz: float | None, policy: Policy) -> None:
        if rate_hz is not None and not (isfinite(rate_hz) and 0 < rate_hz <= 1000):
            raise InputError(f"the requested rate must be above 0 and up to 1000 Hz, not {rate_hz}")
        self._rate_hz = rate_hz or 0.0  # 0: nothing is asked for
        self._streams: dict[VehicleId, _Stream] = {}
        self._notices: list[Notice] = []
        # nobody can answer an address that never sends anything
        self._sends_first = endpoint.kind == "udpout"
        self._heartbeat_us = -HEARTBEAT_US  # when the last ones were sent
        self._signing = policy.signing
        self._encoders: dict[int, FrameEncoder] = {}
        self._frames: deque[bytes] = deque(maxlen=MOST_UNSENT_FRAMES)

    def react(self, events: list[Event], now_us: int) -> list[Notice]:
        """Ask for rates, because of the events or the time; what a person should know of it."""
        if not self._rate_hz:
            return []
        for event in events:
            self._handle(event, now_us)
        for stream in self._streams.values():
            if now_us < stream.due_us or stream.phase == "given_up":
                continue
            if stream.phase == "asking" and stream.repeats > MOST_REPEATS:
                self._fail(stream, "does not answer", now_us)
            elif stream.phase == "measuring":  # no sample came to be judged
                self._fail(stream, f"accepted, but sends no {stream.message.name}", now_us)
            else:
                if stream.phase == "pausing":
                    stream.ask(now_us)
                message = message_interval_request(
                    stream.vehicle, stream.message.number, 1e6 / self._rate_hz, stream.repeats
                )
                self._send(stream.vehicle.system_id, message, now_us)
                stream.repeats += 1
                stream.due_us = now_us + ACK_TIMEOUT_US
        notices, self._notices = self._notices, []
        return notices

    def take_frames(self, now_us: int) -> list[bytes]:
        """Every frame that is to be sent by now, with a heartbeat a second in each system asked."""
        systems = sorted({vehicle.system_id for vehicle in self._streams})
        if self._sends_first and not systems:
            systems = [1]
        if systems and not 0 <= now_us - self._heartbeat_us < HEARTBEAT_US:
            self._heartbeat_us = now_us
            message = heartbeat(mav.MAV_TYPE_ONBOARD_CONTROLLER, mav.MAV_AUTOPILOT_INVALID)
            for system_id in systems:
                self._send(system_id, message, now_us)
        frames = list(self._frames)
        self._frames.clear()
        return frames

    def _send(self, system_id: int, message: Message, now_us: int) -> None:
        if system_id not in self._encoders:
            sender = VehicleId(system_id, mav.MAV_COMP_ID_ONBOARD_COMPUTER)
            check = self._signing
            key, stamp = (None, None) if check is None else (check.key, check.stamp)
            self._encoders[system_id] = FrameEncoder(sender, key, stamp=stamp)
        self._frames.append(self._encoders[system_id].frame(message, now_us))

    def _handle(self, event: Event, now_us: int) -> None:
        match event:
            case events.Heartbeat(vehicle=vehicle, autopilot=autopilot):
                is_new = vehicle not in self._streams and len(self._streams) < MOST_STREAMS
                if is_new and autopilot != mav.MAV_AUTOPILOT_INVALID:
                    message = message_to_ask_for(autopilot)
                    self._streams[vehicle] = _Stream(vehicle, message, now_us)
            case events.Forgotten(vehicle=vehicle):
                self._streams.pop(vehicle, None)
            case Imu(vehicle=vehicle) if vehicle in self._streams:
                self._measure(self._streams[vehicle], event, now_us)
            case events.ClockReset(vehicle=vehicle) if vehicle in self._streams:
                self._streams[vehicle].first_boot_us = None
                if event.reason == "reboot":  # it has forgotten what it was asked for
                    self._streams[vehicle].failures = 0
                    self._streams[vehicle].ask(now_us)
            case events.CommandAck(vehicle=vehicle, command=mav.MAV_CMD_SET_MESSAGE_INTERVAL):
                if vehicle in self._streams:
                    self._take_answer(self._streams[vehicle], event.result, now_us)

    def _take_answer(self, stream: _Stream, result: int, now_us: int) -> None:
        if stream.phase != "asking" or result == mav.MAV_RESULT_IN_PROGRESS:
            return
        if result == mav.MAV_RESULT_ACCEPTED:
            stream.phase = "measuring"
            stream.due_us = now_us + SILENCE_US
            stream.first_boot_us = None
        elif result == mav.MAV_RESULT_TEMPORARILY_REJECTED:
            self._fail(stream, "is not ready", now_us)
        else:
            stream.failures = MOST_REQUESTS  # it will not change its mind
            self._fail(stream, f"refuses (MAV_RESULT {result})", now_us)

    def _measure(self, stream: _Stream, imu: Imu, now_us: int) -> None:
        if stream.phase != "measuring" or imu.message != stream.message.name:
            return
        stream.due_us = now_us + SILENCE_US
        if stream.first_boot_us is None:
            stream.first_boot_us, stream.count = imu.boot_us, 0
            return
        stream.count += 1
        span_us = imu.boot_us - stream.first_boot_us
        if span_us < MEASURE_US:
            return
        measured_hz = stream.count * 1e6 / span_us
        stream.first_boot_us = None
        if measured_hz >= SHORTFALL * self._rate_hz:
            stream.failures = 0
        else:
            self._fail(stream, f"sends {stream.message.name} at {measured_hz:.1f} Hz", now_us)

    def _fail(self, stream: _Stream, problem: str, now_us: int) -> None:
        stream.failures += 1
        is_last = stream.failures >= MOST_REQUESTS
        if is_last or not stream.is_noticed:  # a ground station may reset the rate all day
            stream.is_noticed = True
            asked = f"asked for {stream.message.name} at {self._rate_hz:g} Hz, the vehicle"
            then = "not asking again" if is_last else "asking again"
            self._notices.append(Notice(stream.vehicle, now_us, f"{asked} {problem}: {then}"))
        stream.phase = "given_up" if is_last else "pausing"
        pause_us = FIRST_PAUSE_US * 2 ** (stream.failures - 1)
        stream.due_us = now_us + min(pause_us, LONGEST_PAUSE_US)
