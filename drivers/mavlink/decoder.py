"""Frames to events, and who is who.

``MavlinkDecoder`` turns the frames of a link or a log into the events of ``drivers.events``,
without any I/O, and unpacks only what somebody wants. What is in a message is in the tables of
``messages``; here one sender is kept apart from another. Body axes are FRD on both sides.
"""

from collections import OrderedDict
from collections.abc import Callable
from functools import partial

from drivers import events
from drivers.events import Event, VehicleId
from drivers.mavlink import constants as mav
from drivers.mavlink import messages
from drivers.mavlink.ardupilot import ParameterValue, owner
from drivers.mavlink.framing import Frame, fields
from drivers.mavlink.messages import ImuMessage, MessageKind, Received
from drivers.resources import SLOTS
from drivers.samples.imu_stream import Field, Stamp
from drivers.samples.intake import MOST_STREAMS, Intake
from drivers.samples.vehicle_clock import TimeField
from estimator.reasons import Reason

_TIME_USEC = TimeField.TIME_USEC  # looked up in its class it takes longer

FRD_AUTOPILOTS = (mav.MAV_AUTOPILOT_ARDUPILOTMEGA, mav.MAV_AUTOPILOT_PX4)  # known for sending FRD

MOST_SENDERS = SLOTS  # addresses remembered at once; each takes 9 kB
# When all slots are taken, one that has been silent for so long may lose its own to a new one
SILENT_US = 5_000_000

# Messages of other IMUs than the one in use are decoded once that has been silent for so long
IMU_SILENT_US = 500_000
OTHER_IMU_US = 500_000  # until then one in so long is decoded, to be compared

# Frames are missing where the sequence number steps by so much more than it usually does: not
# all frames are of messages that are decoded
USUAL_STEPS = 4
MORE_STEPS = 8
STEP_WEIGHT = 1 / 32  # of a frame in what is usual

MOST_WAITING = 4096  # an autopilot has some 1500 parameters

# What fuzzbee's own vehicle puts where others have a commit, in AUTOPILOT_VERSION's payload
BUILT_IN = "fuzzbee"
FLIGHT_CUSTOM_VERSION, MIDDLEWARE_CUSTOM_VERSION = slice(36, 44), slice(44, 52)
VERSION_EVERY_US = 900_000  # it may report more often what a vehicle it is


class _Sender:
    """What the decoder remembers about one address."""

    def __init__(self, address: VehicleId, *, takes_references: bool) -> None:
        self.id = address
        self.autopilot: int | None = None
        self.imu_us: dict[str, int] = {}  # arrival of each IMU message's last frame
        self.other_us: dict[str, int] = {}  # and of the last read one of each IMU not in use
        self.intake = Intake(address)
        self.intake.takes_references = takes_references
        self.heard_us = 0  # arrival of the latest frame
        self.version_us = 0  # when it was looked into what vehicle it is
        self._sequence: int | None = None  # the number of the last frame
        self._usual_step = 1.0

    def note(self, frame: Frame, arrival_us: int) -> None:
        """Note that a frame has arrived, and whether others before it are missing."""
        self.heard_us = arrival_us
        number = frame.sequence
        if self._sequence is not None:
            step = (number - self._sequence) & 0xFF
            usual = self._usual_step
            self.intake.clock.misses_some = step > USUAL_STEPS * usual + MORE_STEPS or step == 0
            self._usual_step = usual + STEP_WEIGHT * (step - usual)
        self._sequence = number


class MavlinkDecoder:
    """Frames in, events out, for any number of vehicles.

    With ``references`` attitudes of others are wanted, with ``texts`` STATUSTEXT is;
    ``wanted`` holds the numbers of the messages that become events, all others are skipped.
    ``imu_in_use`` gives the IMU message that is used of a vehicle, if any: those behind it in the
    order of preference are skipped while it comes. The tables are read here once: what is to be
    known must be in them before.
    """

    def __init__(self, *, references: bool = True, texts: bool = False) -> None:
        self.imu_in_use: Callable[[VehicleId], str | None] | None = None
        # all, and the addresses of those without an IMU: first who has been silent for longest
        self._senders: OrderedDict[tuple[int, int], _Sender] = OrderedDict()
        self._idle: OrderedDict[tuple[int, int], None] = OrderedDict()
        # of systems whose autopilot is not known yet; the latest of each name
        self._waiting: dict[tuple[int, str], ParameterValue] = {}
        self._references = references
        self._handlers: dict[int, Callable[[_Sender, Frame, int], list[Event]]] = {
            mav.PARAM_VALUE_ID: self._param_value,
            mav.HEARTBEAT_ID: self._heartbeat,
            mav.COMMAND_ACK_ID: _command_ack,
            mav.AUTOPILOT_VERSION_ID: _version,
        }
        if texts:
            self._handlers[mav.STATUSTEXT_ID] = _status_text
        better: list[str] = []  # IMU messages, in the order of preference
        for number, imu in messages.IMU_MESSAGES.items():
            self._handlers[number] = partial(self._imu, imu, tuple(better))
            better.append(imu.name)
        for number, kind in messages.MESSAGES.items():
            if references or not kind.is_reference:
                self._handlers[number] = partial(self._message, kind)
        self.wanted = frozenset(self._handlers)

    def events(self, frame: Frame, arrival_us: int) -> list[Event]:
        """The events in one frame that arrived at ``arrival_us`` (Unix time, us)."""
        handler = self._handlers.get(frame.message_id)
        if handler is None:
            return []
        address = (frame.system_id, frame.component_id)
        sender, met = self._senders.get(address), list[Event]()
        if sender is None:
            met = self._meet(frame, arrival_us)
            if (sender := self._senders.get(address)) is None:
                return met
        self._senders.move_to_end(address)
        sender.note(frame, arrival_us)
        events = handler(sender, frame, arrival_us)
        if address in self._idle:
            if sender.intake.has_imu:
                del self._idle[address]
            else:
                self._idle.move_to_end(address)
        return met + events if met else events

    def end(self) -> list[Event]:
        """No frame comes any more: the events of what has waited for more."""
        return [event for sender in self._senders.values() for event in sender.intake.end()]

    def _imu(
        self,
        message: ImuMessage,
        better: tuple[str, ...],
        sender: _Sender,
        frame: Frame,
        arrival_us: int,
    ) -> list[Event]:
        """A sample, or now and then another IMU's reading while one of the ``better`` is used."""
        _, name, clock, vectors, _, _ = message
        if self.imu_in_use is not None:
            sender.imu_us[name] = arrival_us
            in_use = (self.imu_in_use(sender.id) or "").partition(":")[0]
            last_us = sender.imu_us.get(in_use, arrival_us - IMU_SILENT_US)
            if in_use in better and 0 <= arrival_us - last_us < IMU_SILENT_US:
                return _other_imu(message, sender, frame, arrival_us)
        m = fields(frame)
        raw_us = m.time_usec if clock is _TIME_USEC else m.time_boot_ms * 1000
        stream = messages.imu_stream_name(name, messages.imu_number(frame))
        gyr, acc, mag = vectors(m)
        return sender.intake.imu(stream, Stamp(clock, raw_us, arrival_us), gyr, acc, Field(mag))

    def _message(
        self, kind: MessageKind, sender: _Sender, frame: Frame, arrival_us: int
    ) -> list[Event]:
        if kind.is_wanted is not None and not kind.is_wanted(sender.intake, arrival_us):
            return []
        return kind.events(sender.intake, Received(kind.name, fields(frame), arrival_us))

    def _meet(self, frame: Frame, arrival_us: int) -> list[Event]:
        """Give a new sender a slot, if there is one; too many are no link of real ones."""
        gone, address = list[Event](), VehicleId(frame.system_id, frame.component_id)
        if len(self._senders) >= MOST_SENDERS:
            left = self._make_room(arrival_us, brings_imu=frame.message_id in messages.IMU_MESSAGES)
            if left is None:  # its samples count
                refused = events.RefusedFrames(address, arrival_us, Reason.NO_PLACE, 1)
                return [refused] if frame.message_id in messages.IMU_MESSAGES else []
            gone = [events.Forgotten(left, arrival_us)]
        self._senders[address] = _Sender(address, takes_references=self._references)
        self._idle[address] = None
        return gone

    def _make_room(self, now_us: int, *, brings_imu: bool) -> VehicleId | None:
        """Who loses its slot; first those without an IMU, so vehicles stay in a flood.

        To one that ``brings_imu`` those without give way even if they are not silent.
        """
        for addresses, gives_way in ((self._idle, brings_imu), (self._senders, False)):
            first = next(iter(addresses), None)
            if first is None:
                continue
            if gives_way or now_us - self._senders[first].heard_us >= SILENT_US:
                self._idle.pop(first, None)
                return self._senders.pop(first).id
        return None

    def _param_value(self, sender: _Sender, frame: Frame, arrival_us: int) -> list[Event]:
        m = fields(frame)
        value = ParameterValue(m.param_id, m.param_value, m.param_type)
        known = self._senders.values()  # by HEARTBEAT or IMU data
        autopilots = [s.id for s in known if s.autopilot is not None or s.intake.has_imu]
        address = owner(sender.id, autopilots)
        if address is None:
            key = sender.id.system_id, value.name
            if key in self._waiting or len(self._waiting) < MOST_WAITING:
                self._waiting[key] = value
            return []
        autopilot = self._senders[address].autopilot
        return [events.Parameter(address, arrival_us, value.name, value.value(autopilot))]

    def _heartbeat(self, sender: _Sender, frame: Frame, arrival_us: int) -> list[Event]:
        m = fields(frame)
        if not mav.is_autopilot(m.autopilot, m.type):
            return []
        sender.autopilot = m.autopilot
        sender.intake.checks_axes = m.autopilot not in FRD_AUTOPILOTS
        is_armed = bool(m.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)
        beat = events.Heartbeat(sender.id, arrival_us, m.autopilot, m.type, is_armed, m.custom_mode)
        keys = [key for key in self._waiting if key[0] == sender.id.system_id]
        held = [self._waiting.pop(key) for key in keys]
        return [
            beat,
            *(events.Parameter(sender.id, arrival_us, p.name, p.value(m.autopilot)) for p in held),
        ]


def _status_text(sender: _Sender, frame: Frame, arrival_us: int) -> list[Event]:
    if sender.autopilot is None:
        return []
    m = fields(frame)
    return [events.StatusText(sender.id, arrival_us, m.severity, m.text)]


def _command_ack(sender: _Sender, frame: Frame, arrival_us: int) -> list[Event]:
    m = fields(frame)
    return [events.CommandAck(sender.id, arrival_us, m.command, m.result)]


def _other_imu(message: ImuMessage, sender: _Sender, frame: Frame, arrival_us: int) -> list[Event]:
    """What an IMU that is not in use reads, twice a second; otherwise nothing is unpacked."""
    name = messages.imu_stream_name(message.name, messages.imu_number(frame))
    last_us = sender.other_us.get(name)
    if last_us is not None and 0 <= arrival_us - last_us < OTHER_IMU_US:
        return []
    if last_us is None and len(sender.other_us) >= MOST_STREAMS:
        return []
    sender.other_us[name] = arrival_us
    gyr, acc, _ = message.vectors(fields(frame))
    return [events.OtherImu(sender.id, arrival_us, name, gyr, acc)]


def _version(sender: _Sender, frame: Frame, arrival_us: int) -> list[Event]:
    """The motion of fuzzbee's own vehicle, by its AUTOPILOT_VERSION; looked at once a second."""
    if 0 <= arrival_us - sender.version_us < VERSION_EVERY_US:
        return []
    sender.version_us = arrival_us
    payload = frame.data[frame.payload_at : frame.payload_end]
    product, motion = (
        payload[at].split(b"\0", 1)[0].decode("ascii", "replace")
        for at in (FLIGHT_CUSTOM_VERSION, MIDDLEWARE_CUSTOM_VERSION)
    )
    return [events.BuiltIn(sender.id, arrival_us, motion)] if product == BUILT_IN else []
