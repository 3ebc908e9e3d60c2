"""What a link sends: requests for a rate where a person asked for them, and heartbeats.

Everything comes from component 191, an onboard computer; never from a ground station. A vehicle is
asked with MAV_CMD_SET_MESSAGE_INTERVAL; after its COMMAND_ACK the stream is measured on the
vehicle's own clock. If a ground station resets the rate, it is asked again after a pause that
doubles; after ``MOST_REQUESTS`` in a row that brought nothing, a line says so.

Source: https://mavlink.io/en/services/command.html (retries with a growing confirmation count) and
common.xml (MAV_CMD 511).
"""

from collections import deque
from dataclasses import dataclass, field
from math import isfinite
from typing import Literal, NamedTuple

from drivers.endpoint import Endpoint
from drivers.events import (
    ClockReset,
    CommandAck,
    Event,
    Forgotten,
    Heartbeat,
    Imu,
    Notice,
    VehicleId,
)
from drivers.mavlink import constants as mav
from drivers.mavlink.encoder import FrameEncoder, Message, heartbeat, message_interval_request
from drivers.mavlink.gate import Policy
from drivers.mavlink.messages import ImuMessage, message_to_ask_for
from estimator.errors import InputError

MOST_UNSENT_FRAMES = 64  # new ones replace the oldest
HEARTBEAT_US = 1_000_000


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
        self._speaks_first = endpoint.kind == "udpout"
        self._heartbeat_us: int | None = None  # when the last ones were sent
        self._key = key
        self._stamp = None if policy.signing is None else policy.signing.stamp
        self._encoders: dict[int, FrameEncoder] = {}
        self._frames: deque[bytes] = deque(maxlen=MOST_UNSENT_FRAMES)

    def react(self, events: list[Event], now_us: int) -> list[Notice]:
        """Ask for rates because of the events; returns what a person should know of it."""
        if self._request is None:
            return []
        out = self._request.tick(now_us)
        for event in events:
            out += self._request.handle(event, now_us)
        for each in out:
            if isinstance(each, Outgoing):
                self._send(each.system_id, each.message, now_us)
        return [each for each in out if isinstance(each, Notice)]

    def take_frames(self, now_us: int) -> list[bytes]:
        """Every frame that is to be sent by now, with a heartbeat a second in each system asked."""
        systems = [] if self._request is None else self._request.systems
        if self._speaks_first and not systems:
            systems = [1]
        last_us = self._heartbeat_us
        if systems and (last_us is None or not 0 <= now_us - last_us < HEARTBEAT_US):
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
            self._encoders[system_id] = FrameEncoder(sender, self._key, stamp=self._stamp)
        self._frames.append(self._encoders[system_id].frame(message, now_us))


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

_Phase = Literal["asking", "measuring", "pausing", "given_up"]


class Outgoing(NamedTuple):
    """A message to send under ``system_id``, our component being an onboard computer."""

    system_id: int
    message: Message


@dataclass(slots=True)
class _Stream:
    """What we know about one vehicle's stream, and when to act next."""

    vehicle: VehicleId
    message: ImuMessage
    phase: _Phase
    due_us: int
    repeats: int = 0
    failures: int = 0
    first_boot_us: int | None = None
    count: int = 0
    is_noticed: bool = False
    notices: list[Notice] = field(default_factory=list)


class StreamRequest:
    """Requests of one rate from every vehicle on a link.

    Raises:
        InputError: the rate is not positive.
    """

    def __init__(self, rate_hz: float) -> None:
        if not (isfinite(rate_hz) and 0 < rate_hz <= 1000):
            raise InputError(f"the requested rate must be above 0 and up to 1000 Hz, not {rate_hz}")
        self._rate_hz = rate_hz
        self._streams: dict[VehicleId, _Stream] = {}

    @property
    def systems(self) -> list[int]:
        """The systems whose vehicles are asked."""
        return sorted({vehicle.system_id for vehicle in self._streams})

    def handle(self, event: Event, now_us: int) -> list[Outgoing | Notice]:
        """What to send and to say because of ``event``."""
        match event:
            case Heartbeat(autopilot=autopilot) if autopilot != mav.MAV_AUTOPILOT_INVALID:
                self._meet(event, now_us)
            case Imu(vehicle=vehicle):
                if (stream := self._streams.get(vehicle)) is not None:
                    self._measure(stream, event, now_us)
            case CommandAck(vehicle=vehicle, command=command):
                stream = self._streams.get(vehicle)
                if stream is not None and command == mav.MAV_CMD_SET_MESSAGE_INTERVAL:
                    self._take_answer(stream, event.result, now_us)
            case Forgotten(vehicle=vehicle):
                self._streams.pop(vehicle, None)
            case ClockReset(vehicle=vehicle, reason=reason):
                if (stream := self._streams.get(vehicle)) is not None:
                    _restart_measuring(stream)
                    if reason == "reboot":  # it has forgotten what it was asked for
                        stream.failures = 0
                        _ask(stream, now_us)
            case _:
                pass
        return self.tick(now_us)

    def tick(self, now_us: int) -> list[Outgoing | Notice]:
        """What is due by now; call it also when nothing arrives."""
        out: list[Outgoing | Notice] = []
        for stream in self._streams.values():
            if now_us >= stream.due_us:
                out += self._act(stream, now_us)
            out += stream.notices
            stream.notices.clear()
        return out

    def _meet(self, event: Heartbeat, now_us: int) -> None:
        if event.vehicle in self._streams or len(self._streams) >= MOST_STREAMS:
            return
        message = message_to_ask_for(event.autopilot)
        self._streams[event.vehicle] = _Stream(event.vehicle, message, "asking", now_us)

    def _act(self, stream: _Stream, now_us: int) -> list[Outgoing | Notice]:
        match stream.phase:
            case "asking" if stream.repeats > MOST_REPEATS:
                self._fail(stream, "does not answer", now_us)
                return []
            case "asking":
                return [self._request(stream, now_us)]
            case "measuring":  # no sample came to be judged
                self._fail(stream, f"accepted, but sends no {stream.message.name}", now_us)
                return []
            case "pausing":
                _ask(stream, now_us)
                return [self._request(stream, now_us)]
            case "given_up":
                return []

    def _request(self, stream: _Stream, now_us: int) -> Outgoing:
        interval_us = 1e6 / self._rate_hz
        message = message_interval_request(
            stream.vehicle, stream.message.number, interval_us, stream.repeats
        )
        stream.repeats += 1
        stream.due_us = now_us + ACK_TIMEOUT_US
        return Outgoing(stream.vehicle.system_id, message)

    def _take_answer(self, stream: _Stream, result: int, now_us: int) -> None:
        if stream.phase != "asking" or result == mav.MAV_RESULT_IN_PROGRESS:
            return
        if result == mav.MAV_RESULT_ACCEPTED:
            stream.phase = "measuring"
            stream.due_us = now_us + SILENCE_US
            _restart_measuring(stream)
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
        if span_us >= MEASURE_US:
            self._judge(stream, stream.count * 1e6 / span_us, now_us)

    def _judge(self, stream: _Stream, rate_hz: float, now_us: int) -> None:
        _restart_measuring(stream)
        if rate_hz >= SHORTFALL * self._rate_hz:
            stream.failures = 0
        else:
            self._fail(stream, f"sends {stream.message.name} at {rate_hz:.1f} Hz", now_us)

    def _fail(self, stream: _Stream, problem: str, now_us: int) -> None:
        stream.failures += 1
        if stream.failures >= MOST_REQUESTS:
            stream.phase = "given_up"
            stream.notices.append(self._notice(stream, f"{problem}: not asking again", now_us))
            return
        if not stream.is_noticed:  # a ground station may reset the rate all day
            stream.is_noticed = True
            stream.notices.append(self._notice(stream, f"{problem}: asking again", now_us))
        pause_us = FIRST_PAUSE_US * 2 ** (stream.failures - 1)
        stream.phase = "pausing"
        stream.due_us = now_us + min(pause_us, LONGEST_PAUSE_US)

    def _notice(self, stream: _Stream, problem: str, now_us: int) -> Notice:
        asked = f"asked for {stream.message.name} at {self._rate_hz:g} Hz, the vehicle {problem}"
        return Notice(stream.vehicle, now_us, asked)


def _ask(stream: _Stream, now_us: int) -> None:
    stream.phase, stream.repeats, stream.due_us = "asking", 0, now_us


def _restart_measuring(stream: _Stream) -> None:
    stream.first_boot_us, stream.count = None, 0
