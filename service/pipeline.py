"""Events in, attitude and status records out. No I/O and no clock: times are given.

Everything here can be replayed from a recording: the estimators see the
samples only, never the ticks, so their states at the samples do not depend on
when or how often attitudes are published.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from itertools import chain, islice
from typing import Any

from drivers.events import (
    BuiltIn,
    ClockReset,
    Event,
    FilterWord,
    Forgotten,
    Heartbeat,
    Imu,
    LinkDown,
    LinkUp,
    Malformed,
    Notice,
    Parameter,
    Position,
    ReferenceAttitude,
    RefusedFrames,
    Rejected,
    Report,
    Shed,
    TrackLost,
    VehicleId,
    Velocity,
)
from drivers.mavlink.constants import is_autopilot
from drivers.mavlink.readings import Readings
from drivers.places import PLACES
from drivers.simulation.simulated_vehicle import PROFILES
from estimator.errors import InputError
from estimator.estimator import Estimator
from estimator.profile import Profile, load_profile, merge_profile
from estimator.reasons import Reason
from service.attitude_rows import AttitudeRows, expanded
from service.departures import DepartedCounts, Departures
from service.health import State
from service.link_lines import LinkLines
from service.load import Load, Losses
from service.records import Departed, Message, Output, Peer, Published, Replaced, vehicle_name
from service.talk import Talk
from service.usual_rows import ALL, DUE, NONE, WOKEN
from service.usual_vehicles import Rest, UsualVehicles
from service.vehicle import Vehicle

MAX_VEHICLES = PLACES  # on one link
STATUS_PERIOD_US = 1_000_000
# What changes only when something comes. Of vehicles in these states so many have a status in each
# period, in turn: thousands that came and went must not keep those that are there waiting.
QUIET = frozenset({State.LOST, State.WAITING})
MOST_LOST_TOLD = 64


class Pipeline:
    """One estimator per vehicle, from events to records.

    ``new_estimator`` makes an estimator for a profile. ``system_id`` limits the
    pipeline to one vehicle. With ``fits_built_in`` a vehicle that says that it is
    fuzzbee's own gets the profile that fits its signals; else it is only said.
    """

    def __init__(
        self,
        profile: Profile,
        *,
        system_id: int | None = None,
        new_estimator: Callable[[Profile], Estimator] = Estimator,
        fits_built_in: bool = False,
    ) -> None:
        self.profile = profile
        self.malformed = 0
        self._links = LinkLines()
        self.refused_frames: Counter[Reason] = Counter()
        self._system_id = system_id
        self._new_estimator = new_estimator
        self._fits_built_in = fits_built_in
        self._vehicles: dict[VehicleId, Vehicle] = {}
        self._there: dict[VehicleId, Vehicle] = {}  # all but those that were found to be quiet
        self._usual = UsualVehicles()
        self._away: dict[VehicleId, None] = {}  # those that may be usual again
        self.departures = Departures()
        self._departed: list[VehicleId] = []  # since the last tick
        self._is_shedding = False  # at the last tick
        self._lost_told = 0  # lost vehicles that have had a status in this round
        self._departure_talk = Talk("vehicles")
        self._second_us: int | None = None  # when the present second of statuses began,
        self._told = 0  # and how many have had one since
        # the latest since the last tick; they come faster than anybody needs them
        self._peers: dict[tuple[VehicleId, str], Peer] = {}
        self._replaced: dict[VehicleId, Replaced] = {}  # the latest since the last tick
        self._fitted: set[VehicleId] = set()  # those of them that nobody asked for

    @property
    def vehicles(self) -> tuple[Vehicle, ...]:
        """All vehicles but those that are forgotten, in the order of their appearance."""
        return tuple(self._vehicles[address] for address in self._vehicles if self._own(address))

    def __len__(self) -> int:
        return len(self._vehicles)

    def vehicle(self, address: VehicleId) -> Vehicle | None:
        """The vehicle of that address, if it has been seen."""
        return self._own(address)

    def take(self, readings: Readings) -> list[Output]:
        """Take many readings as :meth:`handle` takes their events; in order for each vehicle."""
        outputs: list[Output] = []
        while True:
            if self._away:
                self._return_usual()
            rest = self._usual.take(readings)
            if rest is None:
                return outputs
            said, left = self._take_rest(readings, rest)
            outputs += said
            if not left:
                return outputs
            readings = readings.only(left)

    def _take_rest(self, readings: Readings, rest: Rest) -> tuple[list[Output], Sequence[int]]:
        """Take at most one more row of each vehicle; the others are left."""
        outputs: list[Output] = []
        for event in readings.looks(rest.looks):
            outputs += self.handle(event)
        for event in readings.events(rest.checks):
            if isinstance(event, Imu):
                outputs += self._check(event)
        for event in readings.events(rest.doubts):
            if isinstance(event, Imu) and (vehicle := self._own(event.vehicle)) is not None:
                outputs += _messages(vehicle.give_up(event))
        for event in readings.events([] if self._is_shedding else rest.compared):
            if isinstance(event, ReferenceAttitude):
                outputs += self.handle(event)
        for event in readings.events(rest.told):
            if isinstance(event, Velocity) and (vehicle := self._own(event.vehicle)) is not None:
                vehicle.hear_velocity(event.sample)
        if rest.checks:  # those behind them just go on, where nothing was found
            return outputs, rest.left
        firsts, others = readings.firsts(rest.left)
        for event in readings.events(firsts):
            outputs += self.handle(event)
        return outputs, others

    def _check(self, event: Imu) -> list[Output]:
        """Check a vehicle's estimate behind a sample that was taken; nearly always it goes on."""
        vehicle = self._vehicles[event.vehicle]
        self._usual.tell(event.vehicle)
        texts = vehicle.check(event)
        if not self._usual.go_on(vehicle):
            self._away[event.vehicle] = None
        return _messages(texts)

    def _return_usual(self) -> None:
        """Have those stepped with the others again that just go on."""
        for address in self._away:
            self._usual.take_over(self._vehicles[address])
        self._away.clear()

    def _own(self, address: VehicleId) -> Vehicle | None:
        """A vehicle with all that is known of it; None if there is none."""
        vehicle = self._vehicles.get(address)
        if vehicle is not None:
            self._usual.hand_back(address)
            self._away[address] = None
            self._there[address] = vehicle
        return vehicle

    def _take_back(self, address: VehicleId) -> None:
        """Have a vehicle know all of itself that is usual now."""
        if self._usual.has(address):
            self._usual.hand_back(address)
            self._away[address] = None

    def handle(self, event: Event | Readings) -> list[Output]:
        """Take one event; returns the lines that a person should see at once."""
        if isinstance(event, Readings):
            return self.take(event)
        match event:
            case Imu(vehicle=address):
                vehicle = self._own(address) or self._meet(address)
                return [] if vehicle is None else _messages(vehicle.on_imu(event))
            case ClockReset(vehicle=address):
                vehicle = self._own(address)
                return [] if vehicle is None else self._reset_clock(vehicle, event)
            case TrackLost(vehicle=address):
                vehicle = self._own(address)
                return [] if vehicle is None else _messages(vehicle.on_track_lost(event))
            case Position(vehicle=address):
                if (vehicle := self._own(address)) is not None:
                    vehicle.on_position(event)
            case Report(vehicle=address):
                if (vehicle := self._own(address)) is not None:
                    vehicle.on_report(event)
            case FilterWord(vehicle=address):
                if address in self._vehicles:
                    self._vehicles[address].on_filter_word(event)
            case Parameter(vehicle=address):
                vehicle = self._meet(address)  # most are told once, before the first sample
                if vehicle is not None:
                    vehicle.on_parameter(event)
            case Rejected(vehicle=address):
                vehicle = self._meet(address)
                if vehicle is not None:
                    vehicle.on_rejected(event)
            case Shed():
                self._on_shed(event)
            case Forgotten(vehicle=address):
                self._forget(address)
            case RefusedFrames():
                self._on_refused(event)
            case Heartbeat():
                self._on_heartbeat(event)
            case BuiltIn(vehicle=address):
                vehicle = self._vehicles.get(address) or self._meet(address)
                return [] if vehicle is None else self._fit(vehicle, event)
            case ReferenceAttitude():
                return self.on_reference(event)
            case Malformed(frames=frames):
                self.malformed += frames
            case Notice(vehicle=address, text=text):
                is_wanted = address is None or self._is_wanted(address)
                if is_wanted and not self._is_settled(event):
                    return [Message(text)]
            case LinkUp() | LinkDown():
                return [Message(self._links.line(event))]
        return []

    def on_reference(self, event: ReferenceAttitude) -> list[Output]:
        """Take another's attitude, if there is time for it: samples come first."""
        address, source = event.vehicle, event.source
        vehicle = self._vehicles.get(address)
        if self._is_shedding or vehicle is None:
            return []
        self._usual.tell(address)
        self._peers[address, source] = Peer(address, source, event.q_ned_frd)
        return _messages(vehicle.on_reference(event))

    def tick(self, now_us: int, load: Load = Load()) -> list[Output]:  # noqa: B008 - immutable
        """The attitudes at ``now_us`` (host time), and each second the statuses."""
        return expanded(self.tick_rows(now_us, load))

    def tick_rows(
        self,
        now_us: int,
        load: Load = Load(),  # noqa: B008 - immutable
        ask_losses: Callable[[], Losses] = Losses,
    ) -> list[Output | AttitudeRows]:
        """The same with most attitudes as rows; ``ask_losses`` is called if a status is due."""
        self._is_shedding = load.is_shedding
        due, is_second = self._take_turns(now_us)
        if is_second:
            self._forget_silent(now_us)
        outputs: list[Output | AttitudeRows] = []
        if self._departed:
            outputs += self._take_departed(now_us)
        if self._replaced or self._peers:
            outputs += self._take_news(now_us)
        takes_all = not (load.is_shedding or load.has_just_woken)
        wanted = ALL if takes_all else WOKEN if load.has_just_woken else DUE
        wanted = NONE if load.is_behind else wanted
        if self._away:
            self._return_usual()
        rows, done = self._usual.show(now_us, wanted)
        if rows is not None:
            outputs.append(rows)
        told = self._take_lost() if is_second else {}
        losses = ask_losses() if due or told else Losses()
        due |= told.keys()
        for address, vehicle in (self._there | told).items():
            is_told = address in due
            if address in done:
                if not is_told:
                    continue
            elif vehicle.state in QUIET and address not in told:
                del self._there[address]  # nothing changes until something comes
                continue
            else:
                self._take_back(address)
                is_left_out = wanted != ALL and vehicle.is_left_out(now_us)
                if not (load.has_just_woken or is_left_out):
                    outputs += _messages(vehicle.on_time(now_us))
                is_wanted = not is_left_out and (takes_all or vehicle.is_due(now_us))
                attitude = vehicle.attitude(now_us) if is_wanted and not load.is_behind else None
                if attitude is not None:
                    outputs.append(Published(address, attitude, vehicle.last_sample))
            if is_told:
                self._usual.tell(address)
                status = vehicle.status(now_us, load, losses, self.malformed)
                outputs.append(Published(vehicle.address, status, time_unix_us=now_us))
        return outputs

    def replace_profile(
        self, address: VehicleId, partial: dict[str, Any], retuned: str | None = None
    ) -> Profile:
        """Use a vehicle's profile with the keys of ``partial`` replaced; returns it.

        ``retuned`` says why, if it was retuned by itself.

        Raises:
            InputError: no such vehicle, unknown keys, values out of bounds or of no use
                together. The profile of before stays in force.
        """
        vehicle = self._own(address)
        if vehicle is None:
            raise InputError(f"no vehicle {address.system_id}-{address.component_id}")
        profile = merge_profile(vehicle.profile, partial)
        try:
            vehicle.replace_profile(profile)
        except (ArithmeticError, ValueError, TypeError) as error:
            raise InputError(f"profile update: cannot be used: {error}") from error
        if retuned is not None:
            vehicle.note_retuned(retuned)
        self._replaced[address] = Replaced(address, profile, retuned)
        return profile

    def _on_shed(self, event: Shed) -> None:
        # the message in use, which it asks for, stays while a vehicle is usual
        vehicle = self._vehicles.get(event.vehicle) or self._meet(event.vehicle)
        if vehicle is not None:
            self._note_heard(vehicle, event.arrival_us)
            vehicle.on_shed(event)

    def _note_heard(self, vehicle: Vehicle, arrival_us: int) -> None:
        if not self._usual.note_heard(vehicle.address, arrival_us):
            vehicle.heard_us = arrival_us

    def _on_heartbeat(self, event: Heartbeat) -> None:
        if not is_autopilot(event.autopilot, event.vehicle_type):
            return
        known = self._vehicles.get(event.vehicle)
        if known is not None and known.has_said(event):  # as nearly always
            self._note_heard(known, event.arrival_us)
            self._there[event.vehicle] = known
            return
        vehicle = self._meet(event.vehicle)
        if vehicle is not None:
            vehicle.on_heartbeat(event)

    def _on_refused(self, event: RefusedFrames) -> None:
        self.refused_frames[event.reason] += event.frames
        if (vehicle := self._own(event.vehicle)) is not None:  # refused, nobody appears
            vehicle.reject(event.reason, event.frames)

    def _fit(self, vehicle: Vehicle, event: BuiltIn) -> list[Output]:
        """Take the profile that fits fuzzbee's own vehicle, unless another one was asked for."""
        name = PROFILES.get(event.motion)
        if name is None or vehicle.built_in_motion == event.motion:
            return []
        vehicle.built_in_motion = event.motion
        who = f"vehicle {vehicle.name}: fuzzbee's own, motion {event.motion}"
        profile = load_profile(name)
        if not self._fits_built_in:
            fits = vehicle.profile.conditioned == profile.conditioned
            vehicle.has_unfit_profile = not fits
            return [] if fits else [Message(f"{who}: profile {name} would fit, this one does not")]
        if vehicle.profile != profile:
            self._own(vehicle.address)
            self._change_profile(vehicle, profile)
        noise = "" if profile.conditioned else " (signals so noisy that 5 to 10° remain)"
        return [Message(f"{who}, profile {name}{noise}")]

    def _reset_clock(self, vehicle: Vehicle, event: ClockReset) -> list[Output]:
        """After a reboot another vehicle may have the address of fuzzbee's own."""
        if vehicle.built_in_motion is not None and event.reason == "reboot":
            vehicle.built_in_motion = None
            if self._fits_built_in and vehicle.profile != self.profile:
                self._change_profile(vehicle, self.profile)
        return _messages(vehicle.on_clock_reset(event))

    def _change_profile(self, vehicle: Vehicle, profile: Profile) -> None:
        vehicle.replace_profile(profile)
        vehicle.restart()
        self._replaced[vehicle.address] = Replaced(vehicle.address, profile)
        self._fitted.add(vehicle.address)

    def _meet(self, address: VehicleId) -> Vehicle | None:
        """The vehicle of that address, a new one if need be; None if it is not wanted."""
        vehicle = self._own(address)
        if vehicle is not None or not self._is_wanted(address):
            return vehicle
        if len(self._vehicles) >= MAX_VEHICLES:
            return None
        kept = self.departures.take_profile(address)
        profile = kept or self.profile
        vehicle = Vehicle(address, profile, self._new_estimator(profile))
        self._vehicles[address] = self._there[address] = vehicle
        self._away[address] = None
        if kept is not None:
            self._replaced[address] = Replaced(address, kept)
        return vehicle

    def _forget_silent(self, now_us: int) -> None:
        # of those that are usual now as it was at the last status: nobody is silent among them
        heard_us = {address: vehicle.heard_us for address, vehicle in self._vehicles.items()}
        for address in self.departures.look(heard_us, now_us):
            self._forget(address)

    def _take_lost(self) -> dict[VehicleId, Vehicle]:
        """Those of the quiet vehicles whose turn it is to have a status."""
        for address in [a for a, each in self._there.items() if each.state in QUIET]:
            del self._there[address]
        lost = [address for address in self._vehicles if address not in self._there]
        begin = self._lost_told if self._lost_told < len(lost) else 0
        self._lost_told = begin + MOST_LOST_TOLD
        return {address: self._vehicles[address] for address in lost[begin : self._lost_told]}

    def _take_departed(self, now_us: int) -> list[Output]:
        """The vehicles forgotten since the last tick."""
        gone, self._departed = self._departed, []
        texts = [f"vehicle {vehicle_name(address)}: gone, and forgotten" for address in gone]
        lines = self._departure_talk.lines(texts, now_us)
        return [*map(Departed, gone), *map(Message, lines)]

    def _take_news(self, now_us: int) -> list[Output]:
        """The parameters replaced since the last tick, and attitudes of others."""
        news: list[Output] = [*self._replaced.values(), *self._peers.values()]
        for address in self._replaced.keys() - self._fitted:
            vehicle, why = self._vehicles[address], self._replaced[address].retuned
            news += _messages(vehicle.on_profile(now_us, why))
        self._replaced.clear()
        self._fitted.clear()
        self._peers.clear()
        return news

    def _forget(self, address: VehicleId) -> None:
        """Forget a vehicle, all but the parameters that somebody gave it."""
        vehicle = self._own(address)
        if vehicle is None:
            return
        del self._vehicles[address]
        self._there.pop(address, None)
        self._away.pop(address, None)
        rejected = vehicle.rejected.total()
        counts = DepartedCounts(1, vehicle.samples, vehicle.shed, rejected, vehicle.attitudes)
        self.departures.counts = self.departures.counts.plus(counts)
        if vehicle.profile != self.profile and vehicle.built_in_motion is None:
            self.departures.keep(address, vehicle.profile)
        self._replaced.pop(address, None)
        self._fitted.discard(address)
        self._departed.append(address)

    def _is_settled(self, notice: Notice) -> bool:
        """Whether the vehicle's profile already sets what the notice asks the user to set."""
        vehicle = None if notice.vehicle is None else self._vehicles.get(notice.vehicle)
        profile = self.profile if vehicle is None else vehicle.profile
        return notice.section == "mounting" and not profile.mounting.has_body_axes

    def _is_wanted(self, address: VehicleId) -> bool:
        return self._system_id is None or address.system_id == self._system_id

    def _take_turns(self, now_us: int) -> tuple[set[VehicleId], bool]:
        """Who has a status now, each once a second; and whether a second has passed.

        One by one: a thousand at one tick would make that late.
        """
        n, second_us, begin = len(self._vehicles), self._second_us, self._told
        if second_us is None or not 0 <= now_us - second_us < 2 * STATUS_PERIOD_US:
            self._second_us, self._told = now_us, 0  # the first, or the clock was set
            return set(self._vehicles), True
        end = n * (now_us - second_us) // STATUS_PERIOD_US
        due = set(islice(chain(self._vehicles, self._vehicles), begin, max(begin, end)))
        is_over = now_us - second_us >= STATUS_PERIOD_US
        if is_over:
            self._second_us, end = second_us + STATUS_PERIOD_US, end - n
        self._told = end
        return due, is_over


def _messages(texts: list[str]) -> list[Output]:
    return [Message(text) for text in texts] if texts else []
