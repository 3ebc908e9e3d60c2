"""One status of a vehicle, from its worker's and from what the service itself has counted."""

from collections import Counter, defaultdict
from collections.abc import Callable
from functools import reduce

import msgspec

from drivers.events import RefusedFrames, Shed, VehicleId
from service.records import StatusRecord
from service.workers.job import Tally


class CommonStatus:
    """Adds to a worker's status what only the service knows.

    ``overruns``, ``dropped`` and ``malformed`` are those of all workers and of the link together;
    ``overloaded`` is said of the vehicles of the worker that is, and of all if the link is.
    """

    def __init__(self) -> None:
        self.malformed = 0
        self.restarts = 0
        self.dropped = 0  # by the link, the handout and the sinks
        self.lost = 0  # datagrams, by the system
        self.is_overloaded = False  # the link
        self.recording: Callable[[], str] = str  # a word on the files that are recorded to
        self.refused: Counter[str] = Counter()
        self._refused_of: defaultdict[VehicleId, Counter[str]] = defaultdict(Counter)
        self._shed_of: Counter[VehicleId] = Counter()
        self._tallies: dict[int, Tally] = {}
        self._dead = Tally()

    def refuse(self, event: RefusedFrames) -> None:
        """Count frames that were not let in."""
        self.refused[event.reason] += event.frames
        # whoever is refused may claim any address
        if any(event.vehicle in each.vehicles for each in self._tallies.values()):
            self._refused_of[event.vehicle][event.reason] += event.frames

    def shed(self, event: Shed) -> None:
        """Count samples that were left out before anybody was handed them."""
        self._shed_of[event.vehicle] += event.samples

    def note(self, worker: int, tally: Tally) -> None:
        """A worker's latest counts."""
        self._tallies[worker] = tally

    def forget(self, worker: int) -> Tally:
        """A worker has died: its late ticks and losses still count. Returns its last counts."""
        last = self._tallies.pop(worker, Tally())
        self._dead = self._dead.plus(last._replace(vehicles={}))
        return last

    def depart(self, vehicle: VehicleId) -> None:
        """A vehicle is forgotten."""
        self._refused_of.pop(vehicle, None)
        self._shed_of.pop(vehicle, None)

    @property
    def tally(self) -> Tally:
        """All workers' counts together; ``ticks`` are those of the one that has made most."""
        total = reduce(Tally.plus, self._tallies.values(), self._dead)
        vehicles = {
            vehicle: msgspec.structs.replace(
                counts,
                shed=counts.shed + self._shed_of[vehicle],
                rejected=self._rejected(vehicle, counts.rejected),
            )
            for vehicle, counts in total.vehicles.items()
        }
        return total._replace(dropped=total.dropped + self.dropped, vehicles=vehicles)

    def status(self, worker: int, vehicle: VehicleId, record: StatusRecord) -> StatusRecord:
        """The status to publish for one of a worker's vehicles."""
        tallies = (tally for of, tally in self._tallies.items() if of != worker)
        others = reduce(Tally.plus, tallies, self._dead)
        return msgspec.structs.replace(
            record,
            rejected=self._rejected(vehicle, record.rejected),
            overruns=record.overruns + others.overruns,
            dropped=record.dropped + others.dropped + self.dropped,
            malformed=self.malformed,
            lost=self.lost,
            overloaded=record.overloaded or self.is_overloaded,
            shed=record.shed + self._shed_of[vehicle],
            worker=worker + 1,
            restarts=self.restarts,
            recording=self.recording(),
        )

    def _rejected(self, vehicle: VehicleId, by_worker: dict[str, int]) -> dict[str, int]:
        if vehicle not in self._refused_of:
            return by_worker
        total = Counter(by_worker)
        total.update(self._refused_of[vehicle])
        return dict(sorted(total.items()))
