"""The latest records as Prometheus metrics, served on loopback."""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from estimator.errors import InputError, missing_extra
from service.health import State
from service.records import AttitudeRecord, Departed, Output, Published, StatusRecord, vehicle_name

if TYPE_CHECKING:
    from prometheus_client.metrics_core import Metric

HOST = "127.0.0.1"  # to reach them from elsewhere, run a proxy or an agent on this computer


class Gauge(NamedTuple):
    """A number of an attitude, by its name for Prometheus."""

    name: str
    help: str
    value: Callable[[AttitudeRecord], float]


GAUGES = (
    Gauge("roll_degrees", "Roll.", lambda r: r.euler_deg[0]),
    Gauge("pitch_degrees", "Pitch.", lambda r: r.euler_deg[1]),
    Gauge("heading_degrees", "Heading, 0 to 360.", lambda r: r.euler_deg[2]),
    Gauge("error", "The paper's e from the measurements, 0 to 1.", lambda r: r.error),
    Gauge("gain", "The paper's K.", lambda r: r.gain),
    Gauge("gravity_confidence", "Confidence in gravity.", lambda r: r.confidence.gravity),
    Gauge("magnetic_confidence", "Confidence in the field.", lambda r: r.confidence.magnetic),
    Gauge(
        "inclination_sigma_degrees",
        "68 % of the inclination's errors lie under it.",
        lambda r: r.sigma_deg.inclination,
    ),
    Gauge(
        "heading_sigma_degrees",
        "68 % of the heading's errors lie under it.",
        lambda r: r.sigma_deg.heading,
    ),
)


class MetricsSink:
    """Serves ``http://127.0.0.1:PORT/metrics``; ``now_s`` is a monotonic clock, for the ages.

    Raises:
        InputError: the extra is not installed, or the port is taken.
    """

    name = "metrics"

    def __init__(self, port: int, now_s: Callable[[], float] = time.monotonic) -> None:
        try:
            from prometheus_client import CollectorRegistry, start_http_server
        except ImportError:
            raise missing_extra("--metrics", "metrics") from None
        self._board = MetricsBoard(now_s)
        registry = CollectorRegistry(auto_describe=False)
        registry.register(self._board)
        try:
            self._server: Any
            self._server, self._thread = start_http_server(port, HOST, registry)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise InputError(f"--metrics {port}: {reason}; choose another port") from error

    @property
    def port(self) -> int:
        """The port in use."""
        return int(self._server.server_port)

    def handle(self, outputs: Sequence[Output]) -> None:
        """Remember the latest records."""
        for output in outputs:
            if isinstance(output, Published):
                self._board.update(vehicle_name(output.vehicle), output.record)
            elif isinstance(output, Departed):
                self._board.remove(vehicle_name(output.vehicle))

    def close(self) -> None:
        """End the server."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class MetricsBoard:
    """The latest of each vehicle; written by the sink, read by the server's threads."""

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self._lock = threading.Lock()
        self._attitudes: dict[str, tuple[AttitudeRecord, float]] = {}
        self._statuses: dict[str, StatusRecord] = {}

    def update(self, name: str, record: AttitudeRecord | StatusRecord) -> None:
        """Remember a record."""
        with self._lock:
            if isinstance(record, AttitudeRecord):
                self._attitudes[name] = (record, self._now_s())
            else:
                self._statuses[name] = record

    def remove(self, name: str) -> None:
        """Forget a vehicle."""
        with self._lock:
            self._attitudes.pop(name, None)
            self._statuses.pop(name, None)

    def collect(self) -> "Iterator[Metric]":
        """All metrics for one scrape. A lost vehicle's attitude is left out but for its age."""
        with self._lock:
            attitudes, statuses = dict(self._attitudes), dict(self._statuses)
        yield from self._attitude_metrics(attitudes, statuses)
        yield from _status_metrics(statuses)

    def _attitude_metrics(
        self, attitudes: dict[str, tuple[AttitudeRecord, float]], statuses: dict[str, StatusRecord]
    ) -> "Iterator[Metric]":
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

        count = CounterMetricFamily("fuzzbee_attitudes", "Attitudes published.", labels=["vehicle"])
        age = GaugeMetricFamily(
            "fuzzbee_imu_age_seconds", "Age of the last IMU sample.", labels=["vehicle"]
        )
        for name, (record, heard_s) in attitudes.items():
            count.add_metric([name], record.sequence + 1)
            age.add_metric([name], record.age_ms / 1e3 + max(0.0, self._now_s() - heard_s))
        yield count
        yield age
        current = {
            name: record
            for name, (record, _) in attitudes.items()
            if name not in statuses or statuses[name].state != State.LOST
        }
        for gauge in GAUGES:
            family = GaugeMetricFamily(f"fuzzbee_{gauge.name}", gauge.help, labels=["vehicle"])
            for name, record in current.items():
                family.add_metric([name], gauge.value(record))
            yield family


def _status_metrics(statuses: dict[str, StatusRecord]) -> "Iterator[Metric]":
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

    state = GaugeMetricFamily(
        "fuzzbee_state", "1 for the state it is in.", labels=["vehicle", "state"]
    )
    rate = GaugeMetricFamily("fuzzbee_imu_rate_hertz", "IMU samples a second.", labels=["vehicle"])
    gap = GaugeMetricFamily("fuzzbee_worst_gap_seconds", "Worst gap so far.", labels=["vehicle"])
    rejected = CounterMetricFamily(
        "fuzzbee_rejected", "Samples refused.", labels=["vehicle", "reason"]
    )
    for name, status in statuses.items():
        for each in State:
            state.add_metric([name, each.value], float(status.state == each))
        rate.add_metric([name], status.imu_rate_hz)
        gap.add_metric([name], status.worst_gap_s)
        for reason, number in status.rejected.items():
            rejected.add_metric([name, reason], number)
    yield from (state, rate, gap, rejected)
    overruns = max((status.overruns for status in statuses.values()), default=0)
    dropped = max((status.dropped for status in statuses.values()), default=0)
    yield CounterMetricFamily("fuzzbee_overruns", "Ticks that came late.", value=overruns)
    yield CounterMetricFamily("fuzzbee_dropped", "Events and records lost.", value=dropped)
