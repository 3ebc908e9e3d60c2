"""The workers of a service: begun, listened to, replaced when they die, ended.

One thread, the service's loop, calls everything here; ``requests`` may be asked from any.
"""

import os
import pickle
import selectors
import signal
import socket
import time
from concurrent.futures import Future
from contextlib import suppress

import msgspec

from drivers.closing import Closing
from drivers.events import VehicleId
from estimator.errors import InputError
from estimator.profile import Profile
from service.parameters import MAX_PENDING, ParameterRequests
from service.records import AttitudeRecord, Departed, Encoded, Message, Output, Published, Replaced
from service.workers.common_status import CommonStatus
from service.workers.connection import Connection, Kind
from service.workers.connection import Message as Told
from service.workers.handout import Handout
from service.workers.job import Inheritance, Job, ProfileAnswer, ProfileRequest, Tally
from service.workers.nursery_process import BORN, DEAD, READY, NurseryProcess, Setup
from service.workers.place import MOST_QUICK_DEATHS, QUICK_S, Place
from service.workers.report import attitudes_of, record_of

MOST_QUICK_NURSERIES = 3
# Workers tell something every second. One that says nothing for so long hangs, and is killed.
SILENT_S = 5.0
# The process that workers come from makes one within milliseconds. One that does not is replaced.
BIRTH_S = 2.0
# So much of a silence counts at a turn: when the service itself stood, nobody else is to blame.
LONGEST_STEP_S = 0.2
# A service that has not looked for so long was stopped: old attitudes are of no use to anybody.
STOPPED_S = 0.5
ENDING_S = 1.0


class CrewError(RuntimeError):
    """Raised when processes die again and again."""


class Crew(Closing):
    """``count`` workers that do ``job``, on the frames of ``handout``.

    Raises:
        CrewError: from :meth:`turn` and :meth:`begin`, when workers, or the process that they
            come from, end at once each time.
    """

    def __init__(self, count: int, job: Job, handout: Handout) -> None:
        self.status = CommonStatus()
        self.requests = ParameterRequests()
        self.dropped = 0  # attitudes
        self.payloads: dict[VehicleId, bytes] = {}  # each vehicle's last attitude, as published
        self.job = job
        self._asked: dict[int, Future[Profile]] = {}  # profiles that workers are to replace
        self._last_asked = 0
        self._handout = handout
        self._setup = Setup(job.profile, job.gain)
        self._profiles: dict[VehicleId, Replaced] = {}
        self._sequences: dict[VehicleId, int] = {}  # the next ones, of attitudes that are records
        self._selector = selectors.DefaultSelector()
        self._begun: list[Output] = []  # told before the first turn of the service
        self._quick_nurseries = 0
        self._ready_s: float | None = None
        self._stopped_s = 0.0  # for so long the nursery has been stopped
        self._nursery = self._open_nursery()
        self._places = [self._new_place(number) for number in range(count)]
        self._turn_s = time.monotonic()

    def begin(self) -> None:
        """Wait until all is compiled and the workers are there."""
        while not all(place.process for place in self._places):
            self._begun = self.turn(0.1)

    @property
    def processes(self) -> list[int | None]:
        """The processes of the workers, in their order."""
        return [place.process for place in self._places]

    @property
    def tally(self) -> Tally:
        """All counts; of attitudes those that were published, where a worker could not tell."""
        total = self.status.tally
        vehicles = {
            vehicle: msgspec.structs.replace(
                counts, attitudes=max(counts.attitudes, self._next_sequence(vehicle))
            )
            for vehicle, counts in total.vehicles.items()
        }
        return total._replace(vehicles=vehicles)

    def turn(self, timeout_s: float) -> list[Output]:
        """Wait for what workers tell, and return it; replace those that have died."""
        outputs, self._begun = self._begun, []
        for key, _ in self._selector.select(timeout_s):
            if isinstance(key.data, Place):
                self._listen(key.data, outputs)
        pause_s = self._pause_s()
        if pause_s > STOPPED_S:
            while sum(self._listen(place, outputs) for place in self._places):
                pass
            outputs = self._newest(outputs)
        self._hear_nursery()
        self._ask_workers()
        for place in self._places:
            place.connection.flush()
            # the birth of one that has died at once may still have to be told
            if place.connection.is_ended and place.process is not None:
                self._replace(place)
            if (line := place.take_line(time.monotonic())) is not None:
                systems = len(self._handout.systems(place.number))
                outputs.append(Message(f"{line} goes on with its {systems} systems"))
        if (line := self._kill_silent(min(pause_s, LONGEST_STEP_S))) is not None:
            outputs.append(Message(line))
        return outputs

    def end(self) -> list[Output]:
        """Have the workers end, and return what they still had to tell."""
        self.requests.close()
        for answer in self._asked.values():
            answer.cancel()
        outputs: list[Output] = []
        born = [place for place in self._places if place.process is not None]
        for place in born:
            place.connection.flush_all(0.1)
            place.connection.end_sending()
        end_s = time.monotonic() + ENDING_S
        while time.monotonic() < end_s:
            waiting = [place for place in born if not place.connection.is_ended]
            if not waiting:
                break
            waiting[0].connection.wait(0.02)
            for place in waiting:
                self._listen(place, outputs)
        return outputs

    def close(self) -> None:
        """End all processes."""
        self.end()
        for place in self._places:
            if place.process is not None and not place.connection.is_ended:
                _kill(place.process)  # it hangs
            place.connection.close()
        self._nursery.close()
        self._selector.close()

    # --- what workers tell

    def _listen(self, place: Place, outputs: list[Output]) -> bool:
        """Take what has come from a worker; whether there was something."""
        messages = place.connection.receive()
        for message in messages:
            place.silent_s = 0.0
            self._take(place, message, outputs)
        return bool(messages)

    def _take(self, place: Place, message: Told, outputs: list[Output]) -> None:
        match message.kind:
            case Kind.ATTITUDES:
                for vehicle, payload in attitudes_of(message.body):
                    self.payloads[vehicle] = payload
                    outputs.append(Encoded(vehicle, payload))
            case Kind.OUTPUTS:
                told = pickle.loads(message.body)  # noqa: S301 - of our own process
                outputs += [self._completed(place, output) for output in told]
            case Kind.COUNTS:
                self.status.note(place.number, pickle.loads(message.body))  # noqa: S301
            case Kind.OUTGOING:
                self._handout.send(pickle.loads(message.body))  # noqa: S301
            case Kind.PROFILE:
                self._answer(pickle.loads(message.body))  # noqa: S301
            case Kind.FAILURE:
                place.failure = message.body.decode(errors="replace")

    def _completed(self, place: Place, output: Output) -> Output:
        """The output, with the service's part of a status; what a successor needs is kept."""
        match output:
            case Replaced(vehicle=vehicle):
                self._profiles[vehicle] = output
            case Departed(vehicle=vehicle):
                for known in (self._profiles, self._sequences, self.payloads):
                    known.pop(vehicle, None)
                self.status.depart(vehicle)
            case Published(vehicle=vehicle, record=AttitudeRecord(sequence=sequence)):
                self._sequences[vehicle] = sequence + 1
            case Published(vehicle=vehicle, record=record):
                assert not isinstance(record, AttitudeRecord)
                common = self.status.status(place.number, vehicle, record)
                return msgspec.structs.replace(output, record=common)
        return output

    def _ask_workers(self) -> None:
        """Pass requests for other profiles on to the workers that have the vehicles."""
        self._asked = {k: answer for k, answer in self._asked.items() if not answer.cancelled()}
        for vehicle, partial, _, answer in self.requests.waiting():
            number = self._handout.worker(vehicle.system_id)
            if number is None:
                text = f"no vehicle {vehicle.system_id}-{vehicle.component_id}"
                answer.set_exception(InputError(text))
            elif len(self._asked) >= MAX_PENDING:
                answer.set_exception(TimeoutError("too many requests"))
            else:
                self._last_asked += 1
                self._asked[self._last_asked] = answer
                request = ProfileRequest(self._last_asked, vehicle, partial)
                self._places[number].connection.put(Kind.PROFILE, pickle.dumps(request))

    def _answer(self, told: ProfileAnswer) -> None:
        answer = self._asked.pop(told.number, None)
        if answer is None or not answer.set_running_or_notify_cancel():
            return  # whoever asked waits no more
        if told.profile is None:
            answer.set_exception(InputError(told.refusal))
        else:
            answer.set_result(told.profile)

    def _pause_s(self) -> float:
        """The time since the last call, once a turn: wherever a stop fell, one turn sees it."""
        before_s, self._turn_s = self._turn_s, time.monotonic()
        return self._turn_s - before_s

    def _newest(self, outputs: list[Output]) -> list[Output]:
        """What is left when the service itself was stopped: of each vehicle the last attitude."""
        newest = [
            output
            for output in outputs
            if not isinstance(output, Encoded)
            or self.payloads.get(output.vehicle) is output.payload
        ]
        self.dropped += len(outputs) - len(newest)
        return newest

    # --- deaths

    def _new_place(self, number: int) -> Place:
        place = Place(number, self._connect(number, {}))
        self._selector.register(place.connection.socket, selectors.EVENT_READ, place)
        return place

    def _replace(self, place: Place) -> None:
        """Have another process go on for one that has died; its frames wait meanwhile."""
        failure = place.failure
        self.status.restarts += place.process is not None
        self._selector.unregister(place.connection.socket)
        place.connection.close()
        inherited = self._inheritance(self.status.forget(place.number))
        connection = self._connect(place.number, inherited)
        place.note_death(connection, time.monotonic())
        self._selector.register(connection.socket, selectors.EVENT_READ, place)
        if place.quick_deaths >= MOST_QUICK_DEATHS:
            why = f": {failure}" if failure else ""
            raise CrewError(
                f"{place.name} has died {MOST_QUICK_DEATHS} times in a row,"
                f" each time within {QUICK_S:g} s{why}"
            )

    def _connect(self, number: int, inherited: dict[VehicleId, Inheritance]) -> Connection:
        """Ask for a worker; returns the connection to it."""
        ours, theirs = socket.socketpair()
        connection = Connection(ours)
        job = self.job._replace(inherited=inherited)
        self._handout.connect(number, connection, pickle.dumps(job))
        with theirs:
            self._nursery.request(number, theirs)
        counts = {vehicle: each.counts for vehicle, each in inherited.items()}
        self.status.note(number, Tally(vehicles=counts))
        return connection

    def _inheritance(self, last: Tally) -> dict[VehicleId, Inheritance]:
        """What a successor takes over; sequence numbers continue."""
        inherited = {}
        for vehicle, counts in last.vehicles.items():
            replaced = self._profiles.get(vehicle)
            attitudes = max(counts.attitudes, self._next_sequence(vehicle))
            inherited[vehicle] = Inheritance(
                None if replaced is None else replaced.profile,
                msgspec.structs.replace(counts, attitudes=attitudes),
            )
        return inherited

    def _next_sequence(self, vehicle: VehicleId) -> int:
        payload = self.payloads.get(vehicle)
        if payload is None:
            return self._sequences.get(vehicle, 0)
        return record_of(payload).sequence + 1

    def _kill_silent(self, step_s: float) -> str | None:
        """End workers that hang, so that they are replaced, or what they come from; then a line."""
        for place in self._places:
            place.silent_s += step_s
            if place.silent_s > SILENT_S and place.process is not None:
                place.failure = f"has said nothing for {SILENT_S:g} s and is killed"
                place.silent_s = 0.0
                _kill(place.process)
        unborn = [place for place in self._places if place.process is None]
        if self._ready_s is None:  # it compiles, for as long as it takes
            self._stopped_s = self._stopped_s + step_s if self._nursery.is_stopped else 0.0
            hangs = self._stopped_s > BIRTH_S
        else:
            hangs = any(place.silent_s > BIRTH_S for place in unborn)
        if not hangs:
            return None
        process = self._nursery.kill()
        self._replace_nursery(time.monotonic(), is_hanging=True)
        return f"the process that workers come from ({process}) hung and is replaced"

    # --- the process that workers come from

    def _open_nursery(self) -> NurseryProcess:
        nursery = NurseryProcess(self._setup)
        self._selector.register(nursery.control, selectors.EVENT_READ, nursery)
        self._ready_s, self._stopped_s = None, 0.0
        return nursery

    def _hear_nursery(self) -> None:
        now_s = time.monotonic()
        for what, process, number in self._nursery.news():
            if what == READY:
                self._ready_s = now_s
                for place in self._places:
                    place.silent_s = 0.0
            elif what == BORN:
                self._places[number].note_birth(process, now_s)
            elif what == DEAD:
                self._note_end(process, number)
        if self._nursery.is_ended:
            self._replace_nursery(now_s)

    def _note_end(self, process: int, exit_code: int) -> None:
        for place in self._places:
            if place.death is not None and place.death.process == process:
                place.death = place.death._replace(exit_code=exit_code)

    def _replace_nursery(self, now_s: float, *, is_hanging: bool = False) -> None:
        """Start another one, and ask it for the workers that were not born yet."""
        if self._ready_s is None and not is_hanging:
            raise CrewError("the process that workers come from has ended before it was ready")
        is_quick = not is_hanging and now_s - (self._ready_s or 0.0) < QUICK_S
        self._quick_nurseries = self._quick_nurseries + 1 if is_quick else 0
        if self._quick_nurseries >= MOST_QUICK_NURSERIES:
            raise CrewError("the process that workers come from ends again and again")
        self._selector.unregister(self._nursery.control)
        self._nursery.close()
        self._nursery = self._open_nursery()
        for place in self._places:
            if place.process is None:
                self._replace(place)


def _kill(process: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(process, signal.SIGKILL)
