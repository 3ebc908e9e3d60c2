"""Events in, attitude and status records out. No I/O and no clock: times are given.

Everything here can be replayed from a recording: the estimators see the samples only, so their
states at the samples do not depend on when or how often attitudes are published.
"""

from collections import Counter
from collections.abc import Callable
from typing import Any

from drivers import events
from drivers.events import Event, Imu, VehicleEvent, VehicleId
from drivers.mavlink.constants import is_autopilot
from drivers.resources import SLOTS
from estimator.errors import InputError
from estimator.estimator import Estimator
from estimator.profile import Profile
from estimator.reasons import Reason
from service.lines import LineLimit, link_line
from service.parameters import ProfileChanges
from service.publishing import STATUS_PERIOD_US
from service.records import Message, Output, Published, Replaced, State
from service.vehicle import STANDARD_RATE_HZ, Vehicle
from service.vehicle_status import Load, status_record

MAX_VEHICLES = SLOTS  # on one link
# None of these makes a vehicle
OF_KNOWN = (
    events.Position,
    events.FilterStatus,
    events.ClockReset,
    events.ModeChange,
    events.OtherImu,
)
# What changes only when something comes. Together these vehicles have so many statuses a second:
# thousands that came and went must not keep those that are there waiting.
QUIET = frozenset({State.LOST, State.WAITING})
MOST_QUIET_HZ = 64
LOOK_US = 1_000_000  # so often each vehicle is looked at, and silent ones are looked for
# Silent for an hour, by looks: the host's clock may be set. A log that plays quickly has fewer. A
# battery is changed, a flight goes out of reach and comes back: that is still the same vehicle.
FORGOTTEN_LOOKS = 3600


class Pipeline:
    """One estimator per vehicle, from events to records.

    ``new_estimator`` makes an estimator for a profile. ``system_id`` limits the pipeline to one
    vehicle; ``systems`` are those of all. With ``fits_built_in`` a vehicle that reports to
    be fuzzbee's own gets the profile that fits its signals; otherwise this is only reported.
    """

    def __init__(
        self,
        profile: Profile,
        *,
        system_id: int | None = None,
        new_estimator: Callable[[Profile], Estimator] = Estimator,
        fits_built_in: bool = False,
        rate_hz: float = STANDARD_RATE_HZ,
    ) -> None:
        self.profile = profile
        self.malformed = 0
        self.refused_frames: Counter[Reason] = Counter()
        self.systems: set[int] = set()
        # what was counted of the vehicles that were forgotten, as of one that is there
        self.evicted = Counter(vehicles=0, samples=0, shed=0, rejected=0, attitudes=0)
        self.load = Load()
        self._rate_hz = rate_hz
        self.wake_us = 0.0  # when :meth:`tick` has something to do next, if nothing arrives
        self._system_id = system_id
        self.new_estimator = new_estimator
        self._changes = ProfileChanges(profile, fits_built_in=fits_built_in)
        self._vehicles: dict[VehicleId, Vehicle] = {}
        self._links_up: set[str] = set()
        self._limit = LineLimit("vehicles")
        self._look_us = 0  # when silent vehicles are looked for next

    @property
    def vehicles(self) -> tuple[Vehicle, ...]:
        """All vehicles but those that are forgotten, in the order of their appearance."""
        return tuple(self._vehicles.values())

    def vehicle(self, address: VehicleId) -> Vehicle | None:
        """The vehicle of that address, if it has been seen."""
        return self._vehicles.get(address)

    def imu_in_use(self, address: VehicleId) -> str | None:
        """The IMU message that is used of a vehicle; None while others may be better."""
        vehicle = self._vehicles.get(address)
        if vehicle is None:
            return None
        choice = vehicle.imu.choice
        return None if choice.message in choice.contradicted else choice.message

    # --- events

    def handle(self, event: Event, now_us: int | None = None) -> list[Output]:
        """Take one event; returns what is to be published or shown because of it.

        With ``now_us`` (host time) the attitude that waits for an IMU sample is among that.
        """
        if isinstance(event, Imu):  # nearly all are, or one of the next two
            return self._on_imu(event, now_us)
        if isinstance(event, events.ReferenceAttitude):
            return self.on_reference(event)
        if isinstance(event, events.Report):
            if (vehicle := self._vehicles.get(event.vehicle)) is not None:
                vehicle.on_report(event)
            return []
        match event:
            case events.Forgotten(vehicle=address):
                self._forget(address)
            case events.RefusedFrames(vehicle=address, reason=reason, frames=frames):
                self.refused_frames[reason] += frames
                if (vehicle := self._vehicles.get(address)) is not None:  # refused, nobody appears
                    vehicle.rejected[reason] += frames
            case events.Heartbeat() as beat if not is_autopilot(beat.autopilot, beat.vehicle_type):
                return []
            case VehicleEvent():
                return self._on_vehicle_event(event)
            case events.Malformed(frames=frames):
                self.malformed += frames
            case events.Notice(vehicle=address, text=text):
                vehicle = None if address is None else self._vehicles.get(address)
                mounting = (vehicle or self).profile.mounting
                is_settled = event.section == "mounting" and not mounting.has_body_axes
                if not is_settled and (address is None or self._is_wanted(address)):
                    return [Message(text)]
            case events.LinkUp() | events.LinkDown():
                return [Message(link_line(event, self._links_up))]
        return []

    def _on_imu(self, event: Imu, now_us: int | None) -> list[Output]:
        vehicle = self._vehicles.get(event.vehicle) or self._meet(event.vehicle)
        if vehicle is None:
            return []
        outputs = _messages(vehicle.on_imu(event))
        imu, publishing = vehicle.imu, vehicle.publishing
        is_taken = imu.last is event
        if is_taken and now_us is not None and publishing.meets(now_us, imu.median_period_us):
            outputs += self._published(vehicle, now_us)
        return outputs

    def _on_vehicle_event(self, event: VehicleEvent) -> list[Output]:
        """Pass an event on to the vehicle that it is about, which may be a new one."""
        vehicle = self._vehicles.get(event.vehicle)
        if vehicle is None and not isinstance(event, OF_KNOWN):
            vehicle = self._meet(event.vehicle)
        if vehicle is None:
            return []
        if isinstance(event, events.BuiltIn):
            return self._changes.fit(vehicle, event)
        if isinstance(event, events.ClockReset) and event.reason == "reboot":
            self._changes.note_reboot(vehicle)
        return _messages(vehicle.take(event))

    def on_reference(self, event: events.ReferenceAttitude) -> list[Output]:
        """Take another's attitude, if there is time for it: samples come first."""
        vehicle = self._vehicles.get(event.vehicle)
        if self.load.is_shedding or vehicle is None:
            return []
        vehicle.peers[event.source] = event.q_ned_frd
        return _messages(vehicle.on_reference(event))

    # --- time

    def tick(self, now_us: int, load: Load | None = None) -> list[Output]:
        """The records that are due at ``now_us`` (host time) without a sample of their own."""
        self.load = load or self.load
        outputs, self._changes.outputs = self._changes.outputs, []
        if not 0 < self._look_us - now_us <= LOOK_US:
            self._look_us = now_us + LOOK_US
            outputs += self._forget_silent(now_us)
        self.wake_us = float(self._look_us)
        for vehicle in self._vehicles.values():
            if not now_us < vehicle.publishing.wake_us <= now_us + LOOK_US:
                outputs += self._look_at(vehicle, now_us)
            self.wake_us = min(self.wake_us, vehicle.publishing.wake_us)
        return outputs

    def _look_at(self, vehicle: Vehicle, now_us: int) -> list[Output]:
        """What is due of one vehicle, unless samples have come since its time was noted."""
        vehicle.schedule(now_us)
        is_status_due = vehicle.publishing.is_status_due(now_us)
        if vehicle.publishing.wake_us > now_us and not is_status_due:
            return []
        outputs = self._on_time(vehicle, now_us)
        if is_status_due:
            outputs.append(self._status(vehicle, now_us))
        vehicle.schedule(now_us)
        if vehicle.publishing.wake_us <= now_us:  # held back: its next sample brings it
            vehicle.publishing.wake_us = now_us + 1e6 / self._rate_hz
        return outputs

    def _on_time(self, vehicle: Vehicle, now_us: int) -> list[Output]:
        """A vehicle's change of state, and its attitude if it is due."""
        load, publishing = self.load, vehicle.publishing
        if load.is_shedding and vehicle.is_left_out(now_us):
            return []
        outputs = [] if load.has_just_woken else _messages(vehicle.on_time(now_us))
        is_held_back = load.is_shedding or load.has_just_woken
        is_repeated = is_held_back and publishing.is_stale(now_us, vehicle.imu.samples)
        if publishing.is_attitude_due(now_us) and not is_repeated:
            outputs += self._published(vehicle, now_us)
        return outputs

    def _published(self, vehicle: Vehicle, now_us: int) -> list[Output]:
        attitude = vehicle.attitude(now_us)
        if attitude is None:
            return []
        peers, sample = tuple(vehicle.peers.items()), vehicle.imu.last_sample
        vehicle.peers.clear()
        return [Published(vehicle.address, attitude, sample, peers=peers)]

    def _status(self, vehicle: Vehicle, now_us: int) -> Published:
        status = status_record(vehicle, now_us, self.load, self.malformed)
        period_us = STATUS_PERIOD_US
        if vehicle.state in QUIET:
            period_us *= 1 + len(self._vehicles) // MOST_QUIET_HZ
        vehicle.publishing.note_status(now_us, period_us)
        return Published(vehicle.address, status, time_unix_us=now_us)

    # --- profiles

    def replace_profile(
        self, address: VehicleId, partial: dict[str, Any], retuned: str | None = None
    ) -> Profile:
        """Use a vehicle's profile with the keys of ``partial`` replaced; returns it.

        ``retuned`` is the reason, if it was retuned by itself.

        Raises:
            InputError: no such vehicle, unknown keys, values out of bounds or of no use
                together. The profile of before stays in force.
        """
        vehicle = self._vehicles.get(address)
        if vehicle is None:
            raise InputError(f"no vehicle {address.system_id}-{address.component_id}")
        return self._changes.replace(vehicle, partial, retuned)

    # --- who is there

    def _meet(self, address: VehicleId) -> Vehicle | None:
        """A new vehicle of an address that has none; None if it is not wanted."""
        self.systems.add(address.system_id)
        if not self._is_wanted(address) or len(self._vehicles) >= MAX_VEHICLES:
            return None
        kept = self._changes.kept.pop(address, None)
        estimator = self.new_estimator(kept or self.profile)
        number = len(self._vehicles) + self.evicted["vehicles"]
        vehicle = self._vehicles[address] = Vehicle(address, estimator, self._rate_hz, number)
        if kept is not None:
            self._changes.report(Replaced(address, kept))
        return vehicle

    def _forget_silent(self, now_us: int) -> list[Output]:
        lines: list[str] = []
        for vehicle in self.vehicles:
            is_silent = abs(now_us - vehicle.last_arrival_us) > 2 * LOOK_US
            vehicle.silent_looks = vehicle.silent_looks + 1 if is_silent else 0
            if vehicle.silent_looks >= FORGOTTEN_LOOKS:
                lines.append(f"vehicle {vehicle.name}: gone, and forgotten")
                self._forget(vehicle.address)
        return _messages(self._limit.lines(lines, now_us))

    def _forget(self, address: VehicleId) -> None:
        """Forget a vehicle, except for the parameters that were set for it."""
        vehicle = self._vehicles.pop(address, None)
        if vehicle is None:
            return
        self.evicted.update(
            vehicles=1,
            samples=vehicle.imu.samples,
            shed=vehicle.imu.shed,
            rejected=vehicle.rejected.total(),
            attitudes=vehicle.publishing.attitudes,
        )
        self._changes.note_departure(vehicle)

    def _is_wanted(self, address: VehicleId) -> bool:
        return self._system_id is None or address.system_id == self._system_id


def _messages(texts: list[str]) -> list[Output]:
    return [Message(text) for text in texts] if texts else []
