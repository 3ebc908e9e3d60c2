"""The latest records as Prometheus metrics, served on loopback."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from estimator.errors import InputError, missing_extra
from service.health import State
from service.http_door import Answer, HttpDoor
from service.records import AttitudeRecord, Departed, Output, Published, StatusRecord, vehicle_name
from service.second_opinion import Verdict

if TYPE_CHECKING:
    from prometheus_client.metrics_core import Metric

HOST = "127.0.0.1"  # to reach them from elsewhere, run a proxy or an agent on this computer
MOST_LOST = 64  # lost vehicles that a scrape has
_SIGMA = "68 % of the {}'s errors lie under it."


Values = Mapping[str, float]
# Name, help, and the number of an attitude
OF_ATTITUDE: tuple[tuple[str, str, Callable[[AttitudeRecord], float]], ...] = (
    ("roll_degrees", "Roll.", lambda r: r.euler_deg[0]),
    ("pitch_degrees", "Pitch.", lambda r: r.euler_deg[1]),
    ("heading_degrees", "Heading, 0 to 360.", lambda r: r.euler_deg[2]),
    ("error", "The paper's e from the measurements, 0 to 1.", lambda r: r.error),
    ("gain", "The paper's K.", lambda r: r.gain),
    ("gravity_confidence", "Confidence in gravity.", lambda r: r.confidence.gravity),
    ("magnetic_confidence", "Confidence in the field.", lambda r: r.confidence.magnetic),
    ("inclination_sigma_degrees", _SIGMA.format("inclination"), lambda r: r.sigma_deg.inclination),
    ("heading_sigma_degrees", _SIGMA.format("heading"), lambda r: r.sigma_deg.heading),
)
# Name, help, a second label, and the numbers of a status by that label
OF_STATUS: tuple[tuple[str, str, str, Callable[[StatusRecord], Values]], ...] = (
    (
        "state",
        "1 for the state it is in.",
        "state",
        lambda s: {each.value: float(s.state == each) for each in State},
    ),
    (
        "autopilot",
        "1 for the verdict on it.",
        "verdict",
        lambda s: (
            {word.value: float(s.autopilot.verdict == word) for word in Verdict}
            if s.autopilot is not None
            else {}
        ),
    ),
    (
        "autopilot_inclination_degrees",
        "Between the autopilot's vertical and ours.",
        "",
        lambda s: {} if s.autopilot is None else {"": s.autopilot.inclination_deg},
    ),
    (
        "autopilot_heading_degrees",
        "The autopilot's heading less ours.",
        "",
        lambda s: {} if s.autopilot is None else {"": s.autopilot.heading_deg},
    ),
    ("imu_rate_hertz", "IMU samples a second.", "", lambda s: {"": s.imu_rate_hz}),
    ("worst_gap_seconds", "Worst gap so far.", "", lambda s: {"": s.worst_gap_s}),
)


class MetricsSink:
    """Serves ``http://127.0.0.1:PORT/metrics``; ``now_s`` is a monotonic clock, for the ages.

    The latest of each vehicle is written by the sink's thread and read by the server's.

    Raises:
        InputError: the extra is not installed, or the port is taken.
    """

    name = "metrics"

    def __init__(self, port: int, now_s: Callable[[], float] = time.monotonic) -> None:
        try:
            from prometheus_client import CollectorRegistry
        except ImportError:
            raise missing_extra("--metrics", "metrics") from None
        self._now_s = now_s
        self._lock = threading.Lock()
        self._attitudes: dict[str, tuple[AttitudeRecord, float]] = {}
        self._statuses: dict[str, StatusRecord] = {}
        self._lost: dict[str, None] = {}  # the one that was lost last comes last
        # One answer at a time: of thousands of vehicles it takes long, and must not take all of it.
        self._answering = threading.Lock()
        self._registry = CollectorRegistry(auto_describe=False)
        self._registry.register(self)
        try:
            self._door = HttpDoor(self.name, (HOST, port), self._respond)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise InputError(f"--metrics {port}: {reason}; choose another port") from error

    @property
    def port(self) -> int:
        """The port in use."""
        return self._door.address[1]

    def handle(self, outputs: Sequence[Output]) -> None:
        """Remember the latest records."""
        with self._lock:
            for output in outputs:
                match output:
                    case Published(vehicle=vehicle, record=AttitudeRecord() as record):
                        self._attitudes[vehicle_name(vehicle)] = (record, self._now_s())
                    case Published(vehicle=vehicle, record=StatusRecord() as status):
                        name = vehicle_name(vehicle)
                        self._statuses[name] = status
                        if status.state == State.LOST:
                            self._lost.setdefault(name)
                        else:
                            self._lost.pop(name, None)
                    case Departed(vehicle=vehicle):
                        for known in (self._attitudes, self._statuses, self._lost):
                            known.pop(vehicle_name(vehicle), None)

    def close(self) -> None:
        """End the server."""
        self._door.close()

    def _respond(self, _target: str, headers: Mapping[str, str]) -> Answer:
        """All metrics, in the format that the scraper asks for."""
        from prometheus_client.exposition import choose_encoder

        encode, kind = choose_encoder(headers.get("Accept", ""))
        with self._answering:
            return Answer(kind, encode(self._registry))

    def collect(self) -> "Iterator[Metric]":
        """All metrics for one scrape. A lost vehicle's attitude is left out but for its age.

        Of the lost ones only the last count: an answer about thousands takes a second of all.
        """
        from prometheus_client.core import CounterMetricFamily as Counter

        with self._lock:
            attitudes, statuses = dict(self._attitudes), dict(self._statuses)
            for name in [*self._lost][:-MOST_LOST]:
                attitudes.pop(name, None)
                del statuses[name]
        now_s = self._now_s()
        counted, ages_s = {}, {}
        for name, (record, heard_s) in attitudes.items():
            counted[name] = {"": record.sequence + 1.0}
            ages_s[name] = {"": record.age_ms / 1e3 + max(0.0, now_s - heard_s)}
        yield _family("attitudes", "Attitudes published.", "", counted, is_count=True)
        yield _family("imu_age_seconds", "Age of the last IMU sample.", "", ages_s)
        lost = {name for name, status in statuses.items() if status.state == State.LOST}
        current = {name: each for name, (each, _) in attitudes.items() if name not in lost}
        for metric, text, value in OF_ATTITUDE:
            values = {name: {"": value(record)} for name, record in current.items()}
            yield _family(metric, text, "", values)
        for metric, text, label, values_of in OF_STATUS:
            found = {name: values_of(status) for name, status in statuses.items()}
            yield _family(metric, text, label, found)
        rejected = {name: dict(status.rejected) for name, status in statuses.items()}
        yield _family("rejected", "Samples refused.", "reason", rejected, is_count=True)
        overruns = max((status.overruns for status in statuses.values()), default=0)
        dropped = max((status.dropped for status in statuses.values()), default=0)
        yield Counter("fuzzbee_overruns", "Ticks that came late.", value=overruns)
        yield Counter("fuzzbee_dropped", "Events and records lost.", value=dropped)


def _family(
    name: str, text: str, label: str, values: Mapping[str, Values], *, is_count: bool = False
) -> "Metric":
    """The numbers of each vehicle, by another label if there is one."""
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

    kind = CounterMetricFamily if is_count else GaugeMetricFamily
    labels = ["vehicle", label] if label else ["vehicle"]
    family = kind(f"fuzzbee_{name}", text, labels=labels)
    for vehicle, numbers in values.items():
        for word, number in numbers.items():
            family.add_metric([vehicle, word] if label else [vehicle], number)
    return family
