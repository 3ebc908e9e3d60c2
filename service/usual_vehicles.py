"""Vehicles whose samples just go on with those before, all taken in one call of compiled code.

:class:`~service.vehicle.Vehicle` holds the rules for everything that may happen to one, in Python.
What they come to for a vehicle that runs, and sends sound samples of the IMU message in use, with
velocity and others' rates or without, is here, for many at a time and to the same bits. A row that
is anything
else is left to Python, with all that follow of its vehicle; what is known of that is handed back
before, and taken over again behind it.
"""

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from functools import cache
from math import inf
from typing import Any, NamedTuple, Self

import numba
import numpy as np
from numba.core import types

from drivers.events import VehicleId
from drivers.mavlink.framing import ADDRESSES
from drivers.mavlink.readings import Readings
from estimator.compilation.direct import direct
from estimator.estimator import Estimator
from estimator.live.reports import MOST_WAITING
from service.attitude_rows import ROW_WHOLE, SHOWN_NUMBERS, AttitudeRows
from service.attitude_text import NUMBER_OF_WORD
from service.usual_columns import (
    CHECK,
    COMPARE,
    DOUBT,
    HAS_RATES,
    HEARD,
    HERE,
    LEFT,
    LOOK_US,
    REPORT_SIZE,
    RING,
    SOURCE,
    STATE_NUMBERS,
    STATE_SIZE,
    TELL,
    WAITING,
    Floats,
    Whole,
)
from service.usual_reports import sample_of, write_sample
from service.usual_rows import MORE, SHOWN, new_fleet, put, show_rows, take_rows
from service.vehicle import Vehicle

# numba ships no types; arrays of int64 and float64
_typeof: Any = numba.typeof
_types: Any = types
# At first there are places for so many.
LEAST_PLACES = 16


class Rest(NamedTuple):
    """Rows with more to do than to be taken; by what it is."""

    looks: Sequence[int] = ()  # magnitudes are to be looked at
    left: Sequence[int] = ()
    checks: Sequence[int] = ()  # an estimate is to be checked,
    doubts: Sequence[int] = ()  # or judged,
    compared: Sequence[int] = ()  # or compared with an attitude,
    told: Sequence[int] = ()  # or a velocity told to whoever does so


RESTS = (LEFT, CHECK, DOUBT, COMPARE, TELL)


class _Here(NamedTuple):
    """The vehicles that are here."""

    addresses: list[VehicleId]
    places: Whole
    known: frozenset[VehicleId]

    @classmethod
    def of(cls, vehicles: list[Vehicle | None]) -> Self:
        """Those of the places that are taken."""
        here = [(each.address, k) for k, each in enumerate(vehicles) if each is not None]
        addresses = [address for address, _ in here]
        return cls(addresses, np.array([k for _, k in here], np.int64), frozenset(addresses))


class UsualVehicles:
    """Keeps the numbers of the vehicles that it steps; see :meth:`hand_back`."""

    def __init__(self) -> None:
        self._fleet: Any = None
        self._index = np.zeros(ADDRESSES, np.int64)
        self._state = _state_arrays(0)
        self._vehicles: list[Vehicle | None] = []
        self._here: _Here | None = None  # who of them is here, once it has been looked for
        self._references = np.zeros((0, 2), np.int64)
        self._places: dict[VehicleId, int] = {}
        self._free: list[int] = []  # at the end the next: never one beyond those that were taken
        self._batch = 0
        self._take: Any = None
        self._show: Any = None
        self._put: Any = None

    def take(self, readings: Readings) -> "Rest | None":
        """Take the rows that just go on; returns what else there is to do, if there is."""
        n = len(readings.arrivals_us)
        if self._fleet is None:
            return Rest(left=list(range(n)))
        self._batch += 1
        left = np.empty(n, np.int64)
        rows = (readings.whole, readings.numbers, readings.arrivals_us)
        addresses = readings.addresses
        unusual = self._take(
            self._fleet, self._index, self._state, self._batch, addresses, rows, left
        )
        if not unusual and not readings.complaints:  # as nearly always
            return None
        looks = [k for k in readings.complaints if left[k] != LEFT]
        return Rest(looks, *((left == done).nonzero()[0].tolist() for done in RESTS))

    def show(self, now_us: int, wanted: int) -> tuple[AttitudeRows | None, AbstractSet[VehicleId]]:
        """What is published at a tick, and of which vehicles nothing else is to be said."""
        if self._here is None:
            self._here = _Here.of(self._vehicles)
        addresses, places, known = self._here
        n = len(addresses)
        if not n:
            return None, known
        done = np.empty(n, np.int64)
        shown = (np.empty((n, ROW_WHOLE), np.int64), np.empty((n, SHOWN_NUMBERS)))
        references = self._references
        count = self._show(
            self._fleet, places, self._state, references, now_us, wanted, done, shown
        )
        if count == n:  # as nearly always
            return AttitudeRows(addresses, *shown), known
        more = (done == MORE).nonzero()[0].tolist()
        vehicles = [addresses[k] for k in (done == SHOWN).nonzero()[0].tolist()]
        found = AttitudeRows(vehicles, *(each[:count] for each in shown)) if count else None
        return found, known - {addresses[k] for k in more} if more else known

    def has(self, address: VehicleId) -> bool:
        """Whether a vehicle's numbers are here."""
        return address in self._places

    def note_heard(self, address: VehicleId, arrival_us: int) -> bool:
        """Note that something of a vehicle has come, if its numbers are here; whether they are."""
        place = self._places.get(address)
        if place is not None:
            self._state[0][place, HEARD] = arrival_us
        return place is not None

    def take_over(self, vehicle: Vehicle) -> None:
        """Take a vehicle's numbers, if it just goes on."""
        numbers = vehicle.numbers()
        lent = None if numbers is None else vehicle.estimator.lend()
        if numbers is None or lent is None:
            return
        if not self._free:
            self._grow(lent.inside)
        place = self._places[vehicle.address] = self._free.pop()
        self._vehicles[place] = vehicle
        self._references[place] = [NUMBER_OF_WORD[word] for word in lent.norths]
        self._here = None
        self._put(self._fleet, place, lent.inside)
        self._index[_number(vehicle.address)] = place + 1
        state, reals, left_in, waiting = self._state
        here_deg = lent.here_deg or (inf, inf)
        state[place, :SOURCE], reals[place, :HERE] = numbers
        state[place, SOURCE:WAITING] = (
            lent.source,
            lent.minds_gaps,
            lent.knows_north,
            lent.has_rates,
        )
        state[place, WAITING:] = len(lent.reports), lent.minds_places
        reals[place, HERE:] = here_deg
        left_in[place] = 0
        for at, report in zip(waiting[place], lent.reports, strict=False):
            write_sample(at, report)

    def tell(self, address: VehicleId) -> None:
        """Have a vehicle know its numbers, for whoever changes nothing that is kept here."""
        place = self._places.get(address)
        if place is None:
            return
        vehicle = self._vehicles[place]
        assert vehicle is not None
        state, reals, _, waiting = self._state
        vehicle.know(state[place, :RING].tolist(), reals[place, :HERE].tolist())
        reports = waiting[place, : state[place, WAITING]].tolist()
        vehicle.estimator.take_back(
            tuple(map(sample_of, reports)), has_rates=bool(state[place, HAS_RATES])
        )

    def go_on(self, vehicle: Vehicle) -> bool:
        """Whether a vehicle just goes on that was told its numbers, and has been checked since.

        If not, they are its own alone from now on.
        """
        if not vehicle.just_goes_on:
            self._let_go(vehicle.address)
            return False
        self._state[0][self._places[vehicle.address], LOOK_US] = vehicle.next_look_us
        return True

    def hand_back(self, address: VehicleId) -> None:
        """Give a vehicle its numbers back, before anybody else uses it."""
        self.tell(address)
        self._let_go(address)

    def _let_go(self, address: VehicleId) -> None:
        place = self._places.pop(address, None)
        vehicle = None if place is None else self._vehicles[place]
        if place is not None and vehicle is not None:
            vehicle.resume(self._state[0][place, :SOURCE].tolist())
            self._index[_number(address)] = 0
            self._free.append(place)
            self._vehicles[place] = self._here = None

    def _grow(self, inside: Any) -> None:
        """Make places for as many vehicles again, and bind the steps at the first."""
        n = len(self._vehicles)
        grown = _state_arrays(max(LEAST_PLACES, 2 * n))
        for before, after in zip(self._state, grown, strict=True):
            after[:n] = before
        self._state = grown
        more = len(grown[0]) - n
        self._vehicles += [None] * more
        self._references = np.vstack((self._references, np.zeros((more, 2), np.int64)))
        self._free += range(n + more - 1, n - 1, -1)
        if self._fleet is None:
            arguments = argument_types(_typeof(inside))
            self._take, self._show, self._put = (
                direct(kernel, arguments[kernel]) for kernel in (take_rows, show_rows, put)
            )
            self._fleet = direct(new_fleet, arguments[new_fleet])(inside)


def rehearse(estimator: Estimator) -> None:
    """Compile or load the kernels for such an estimator, if there is compiled code."""
    inside = estimator.inside
    if inside is not None:
        for kernel, arguments in argument_types(_typeof(inside)).items():
            direct(kernel, arguments)


def _number(address: VehicleId) -> int:
    return address.system_id << 8 | address.component_id


def _state_arrays(vehicles: int) -> tuple[Whole, Floats, Whole, Floats]:
    whole = np.zeros((vehicles, STATE_SIZE), np.int64)
    waiting = np.zeros((vehicles, MOST_WAITING, REPORT_SIZE))
    return whole, np.zeros((vehicles, STATE_NUMBERS)), np.zeros(vehicles, np.int64), waiting


@cache
def argument_types(inside: Any) -> dict[Any, tuple[Any, ...]]:
    """What numba calls the types of the kernels' arguments; a handle's is ``inside``."""
    fleet, whole = _types.ListType(inside), _types.int64
    numbers, two = _typeof(np.zeros(0, np.int64)), _typeof(np.zeros((0, 0), np.int64))
    state, reals = _typeof(_state_arrays(0)), _typeof(np.zeros((0, 0)))
    rows = _types.Tuple((two, reals, numbers))
    return {
        new_fleet: (inside,),
        put: (fleet, whole, inside),
        take_rows: (fleet, numbers, state, whole, numbers, rows, numbers),
        show_rows: (
            *(fleet, numbers, state, two, whole, whole, numbers),
            _types.Tuple((two, reals)),
        ),
    }
