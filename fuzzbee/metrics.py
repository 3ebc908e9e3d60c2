"""The latest records as Prometheus metrics, served on loopback."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from prometheus_client import CollectorRegistry, Metric
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.exposition import choose_encoder

from estimator.errors import InputError
from fuzzbee.latest import Latest, Row
from service.http_door import Answer, HttpDoor
from service.records import Output, State
from service.second_opinion import Verdict

HOST = "127.0.0.1"  # to reach them from elsewhere, run a proxy or an agent on this computer
MOST_LOST = 64  # lost vehicles that a scrape has: thousands would take a second of all threads
_SIGMA = "68 % of errors lie under it."


def _parts(row: Row) -> dict[str, Any]:
    return {
        "age_ms": row.age_ms,
        "attitude": row.attitude,
        "valid": None if _is_lost(row) else row.attitude,
        "status": row.status,
        "autopilot": row.status and row.status.autopilot,
    }


def _is_lost(row: Row) -> bool:
    return row.status is not None and row.status.state == State.LOST


# Of a part of a row: a metric's name, its help, and its number, or numbers by LABELS' label.
METRICS: tuple[tuple[str, str, str, Callable[[Any], Any]], ...] = (
    ("age_ms", "imu_age_seconds", "Of the last sample.", lambda age_ms: age_ms / 1e3),
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
    """Serves the latest records at ``http://127.0.0.1:PORT/metrics``.

    Raises:
        InputError: the port is taken.
    """

    name = "metrics"

    def __init__(self, port: int) -> None:
        self._latest = Latest()
        self._answering = threading.Lock()  # one answer at a time
        self._registry = CollectorRegistry(auto_describe=False)
        self._registry.register(self)
        try:
            self._door = HttpDoor(self.name, (HOST, port), self._respond)
        except OSError as error:
            raise InputError(f"--metrics {port}: {error.strerror}; choose another port") from error
        self.port = self._door.server_port  # the one in use

    def handle(self, outputs: Sequence[Output]) -> None:
        """Remember the latest records."""
        self._latest.take(outputs, time.monotonic())

    def close(self) -> None:
        """End the server."""
        self._door.close()

    def _respond(self, _target: str, headers: Mapping[str, str]) -> Answer:
        encode, kind = choose_encoder(headers.get("Accept", ""))
        with self._answering:
            return Answer(kind, encode(self._registry))

    def collect(self) -> Iterator[Metric]:
        """All metrics for one scrape. A lost vehicle's attitude is left out but for its age."""
        rows = self._latest.rows(time.monotonic())
        lost = sorted(filter(_is_lost, rows), key=lambda row: row.attitude_s)
        left_out = {row.name for row in lost[:-MOST_LOST]}
        latest = {row.name: _parts(row) for row in rows if row.name not in left_out}
        for part, metric, text, number in METRICS:
            kind = CounterMetricFamily if metric in COUNTERS else GaugeMetricFamily
            further = LABELS.get(metric, ())
            family = kind(f"fuzzbee_{metric}", text, labels=("vehicle", *further))
            for name, each in latest.items():
                if (record := each[part]) is not None:
                    found = number(record)
                    for word, value in found.items() if further else (("", found),):
                        family.add_metric([name, word][: 1 + len(further)], value)
            yield family
        statuses = [each["status"] for each in latest.values() if each["status"] is not None]
        for metric, text in TOTALS.items():
            most = max((getattr(status, metric) for status in statuses), default=0)
            yield CounterMetricFamily(f"fuzzbee_{metric}", text, value=most)
