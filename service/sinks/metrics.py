"""The latest records as Prometheus metrics, served on loopback."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from estimator.errors import InputError, missing_extra
from service.http_door import Answer, HttpDoor
from service.records import (
    AttitudeRecord,
    Departed,
    Output,
    Published,
    State,
    StatusRecord,
    vehicle_name,
)
from service.second_opinion import Verdict

if TYPE_CHECKING:
    from prometheus_client import Metric

HOST = "127.0.0.1"  # to reach them from elsewhere, run a proxy or an agent on this computer
MOST_LOST = 64  # lost vehicles that a scrape has: thousands would take a second of all threads
_SIGMA = "68 % of errors lie under it."


class Latest(NamedTuple):
    """Of one vehicle; ``sample_s`` is when its IMU sample arrived (s, monotonic)."""

    attitude: AttitudeRecord | None = None
    sample_s: float | None = None
    status: StatusRecord | None = None

    @property
    def is_lost(self) -> bool:
        """Whether the attitude is no longer valid."""
        return self.status is not None and self.status.state == State.LOST

    def part(self, name: str) -> Any:
        """What a metric is of: a field, a valid attitude or the autopilot's; None without one."""
        if name == "valid":
            return None if self.is_lost else self.attitude
        if name == "autopilot":
            return self.status and self.status.autopilot
        return getattr(self, name)


# Of a part of the latest: a metric's name, its help, and its number, or numbers by LABELS' label.
METRICS: tuple[tuple[str, str, str, Callable[[Any], Any]], ...] = (
    ("sample_s", "imu_age_seconds", "Of the last sample.", lambda at_s: time.monotonic() - at_s),
    ("attitude", "attitudes", "Attitudes published.", lambda a: a.sequence + 1),
    ("valid", "roll_degrees", "Roll.", lambda a: a.euler_deg[0]),
    ("valid", "pitch_degrees", "Pitch.", lambda a: a.euler_deg[1]),
    ("valid", "heading_degrees", "Heading, 0 to 360.", lambda a: a.euler_deg[2]),
    ("valid", "error", "The paper's e from the measurements, 0 to 1.", lambda a: a.error),
    ("valid", "gain", "The paper's K.", lambda a: a.gain),
    ("valid", "gravity_confidence", "Confidence in gravity.", lambda a: a.confidence.gravity),
    ("valid", "magnetic_confidence", "Confidence in the field.", lambda a: a.confidence.magnetic),
    ("valid", "inclination_sigma_degrees", _SIGMA, lambda a: a.sigma_deg.inclination),
    ("valid", "heading_sigma_degrees", _SIGMA, lambda a: a.sigma_deg.heading),
    ("status", "state", "1 for the state it is in.", lambda s: {x: s.state == x for x in State}),
    ("status", "imu_rate_hertz", "IMU samples a second.", lambda s: s.imu_rate_hz),
    ("status", "worst_gap_seconds", "Worst gap so far.", lambda s: s.worst_gap_s),
    ("status", "rejected", "Samples refused.", lambda s: s.rejected),
    ("autopilot", "autopilot", "The verdict.", lambda a: {x: a.verdict == x for x in Verdict}),
    ("autopilot", "autopilot_inclination_degrees", "To ours.", lambda a: a.inclination_deg),
    ("autopilot", "autopilot_heading_degrees", "Less ours.", lambda a: a.heading_deg),
)
LABELS = {"state": ("state",), "autopilot": ("verdict",), "rejected": ("reason",)}
COUNTERS = ("attitudes", "rejected")
TOTALS = {"overruns": "Ticks that came late.", "dropped": "Events and records lost."}


class MetricsSink:
    """Serves ``http://127.0.0.1:PORT/metrics``.

    The latest of each vehicle is written by the sink's thread and read by the server's.

    Raises:
        InputError: the extra is not installed, or the port is taken.
    """

    name = "metrics"

    def __init__(self, port: int) -> None:
        try:
            from prometheus_client import CollectorRegistry
        except ImportError:
            raise missing_extra("--metrics", "metrics") from None
        self._lock = threading.Lock()
        self._latest: dict[str, Latest] = {}  # who was lost last comes last
        self._answering = threading.Lock()  # one answer at a time
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
                if isinstance(output, Departed):
                    self._latest.pop(vehicle_name(output.vehicle), None)
                elif isinstance(output, Published):
                    self._note(vehicle_name(output.vehicle), output.record)

    def _note(self, name: str, record: AttitudeRecord | StatusRecord) -> None:
        known = self._latest.get(name, Latest())
        if isinstance(record, AttitudeRecord):
            sample_s = time.monotonic() - record.age_ms / 1e3
            now = known._replace(attitude=record, sample_s=sample_s)
        else:
            now = known._replace(status=record)
        if now.is_lost and not known.is_lost:
            self._latest.pop(name, None)
        self._latest[name] = now

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
        """All metrics for one scrape. A lost vehicle's attitude is left out but for its age."""
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

        with self._lock:
            latest = dict(self._latest)
        for name in [name for name, each in latest.items() if each.is_lost][:-MOST_LOST]:
            del latest[name]
        for part, metric, text, number in METRICS:
            kind = CounterMetricFamily if metric in COUNTERS else GaugeMetricFamily
            further = LABELS.get(metric, ())
            family = kind(f"fuzzbee_{metric}", text, labels=("vehicle", *further))
            for name, each in latest.items():
                if (record := each.part(part)) is not None:
                    found = number(record)
                    for word, value in found.items() if further else (("", found),):
                        family.add_metric([name, word][: 1 + len(further)], value)
            yield family
        statuses = [each.status for each in latest.values() if each.status is not None]
        for metric, text in TOTALS.items():
            most = max((getattr(status, metric) for status in statuses), default=0)
            yield CounterMetricFamily(f"fuzzbee_{metric}", text, value=most)
