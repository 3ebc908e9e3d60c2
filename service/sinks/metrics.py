"""The latest records as Prometheus metrics, served on loopback."""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

from estimator.errors import InputError, missing_extra
from service.health import State
from service.records import AttitudeRecord, Departed, Output, Published, StatusRecord, vehicle_name
from service.second_opinion import Verdict

if TYPE_CHECKING:
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
    from prometheus_client.metrics_core import Metric

HOST = "127.0.0.1"  # to reach them from elsewhere, run a proxy or an agent on this computer
MOST_LOST = 64  # vehicles of which a scrape tells more than their age


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


class _Server(WSGIServer):
    """Whoever leaves or says nothing is no error."""

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Nothing."""


class _Handler(WSGIRequestHandler):
    """Logs nothing, and does not wait for long for who asks nothing."""

    timeout = 1.0  # s

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - its name there
        """Nothing."""


class MetricsSink:
    """Serves ``http://127.0.0.1:PORT/metrics``; ``now_s`` is a monotonic clock, for the ages.

    The latest of each vehicle is written by the sink's thread and read by the server's.

    Raises:
        InputError: the extra is not installed, or the port is taken.
    """

    name = "metrics"

    def __init__(self, port: int, now_s: Callable[[], float] = time.monotonic) -> None:
        try:
            from prometheus_client import CollectorRegistry, make_wsgi_app
        except ImportError:
            raise missing_extra("--metrics", "metrics") from None
        self._now_s = now_s
        self._lock = threading.Lock()
        self._attitudes: dict[str, tuple[AttitudeRecord, float]] = {}
        self._statuses: dict[str, StatusRecord] = {}
        self._lost: dict[str, None] = {}  # the one that was lost last comes last
        registry = CollectorRegistry(auto_describe=False)
        registry.register(self)
        try:
            answer = make_wsgi_app(registry)
            self._server = make_server(HOST, port, answer, _Server, _Handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise InputError(f"--metrics {port}: {reason}; choose another port") from error
        # One answer at a time: of thousands of vehicles it takes long, and must not take all of it.
        self._thread = threading.Thread(
            target=self._server.serve_forever, name="metrics", daemon=True
        )
        self._thread.start()

    @property
    def port(self) -> int:
        """The port in use."""
        return int(self._server.server_port)

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
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def collect(self) -> "Iterator[Metric]":
        """All metrics for one scrape. A lost vehicle's attitude is left out but for its age.

        Of the lost ones only the last count: an answer about thousands takes a second of all.
        """
        with self._lock:
            attitudes, statuses = dict(self._attitudes), dict(self._statuses)
            long_lost = [*self._lost][:-MOST_LOST]
        for name in long_lost:
            attitudes.pop(name, None)
            del statuses[name]
        now_s = self._now_s()
        counts = {name: record.sequence + 1.0 for name, (record, _) in attitudes.items()}
        yield _metric("attitudes", "Attitudes published.", counts, is_count=True)
        ages_s = {
            name: record.age_ms / 1e3 + max(0.0, now_s - heard_s)
            for name, (record, heard_s) in attitudes.items()
        }
        yield _metric("imu_age_seconds", "Age of the last IMU sample.", ages_s)
        current = {
            name: record
            for name, (record, _) in attitudes.items()
            if name not in statuses or statuses[name].state != State.LOST
        }
        for gauge in GAUGES:
            values = {name: gauge.value(record) for name, record in current.items()}
            yield _metric(gauge.name, gauge.help, values)
        yield from _status_metrics(statuses)


def _metric(
    name: str, text: str, values: dict[str, float], *, is_count: bool = False
) -> "GaugeMetricFamily | CounterMetricFamily":
    """A number of each vehicle."""
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

    kind = CounterMetricFamily if is_count else GaugeMetricFamily
    family = kind(f"fuzzbee_{name}", text, labels=["vehicle"])
    for vehicle, value in values.items():
        family.add_metric([vehicle], value)
    return family


def _autopilot_metrics(statuses: dict[str, StatusRecord]) -> "Iterator[Metric]":
    """The autopilot's attitude beside ours, of vehicles that send it."""
    from prometheus_client.core import GaugeMetricFamily

    known = {name: each.autopilot for name, each in statuses.items() if each.autopilot is not None}
    verdict = GaugeMetricFamily(
        "fuzzbee_autopilot", "1 for what is said of it.", labels=["vehicle", "verdict"]
    )
    for name, said in known.items():
        for word in Verdict:
            verdict.add_metric([name, word.value], float(said.verdict == word))
    yield verdict
    for what in ("inclination", "heading"):
        values = {name: getattr(said, f"{what}_deg") for name, said in known.items()}
        text = f"How far the autopilot's {what} is off ours."
        yield _metric(f"autopilot_{what}_degrees", text, values)


def _status_metrics(statuses: dict[str, StatusRecord]) -> "Iterator[Metric]":
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

    state = GaugeMetricFamily(
        "fuzzbee_state", "1 for the state it is in.", labels=["vehicle", "state"]
    )
    rejected = CounterMetricFamily(
        "fuzzbee_rejected", "Samples refused.", labels=["vehicle", "reason"]
    )
    for name, status in statuses.items():
        for each in State:
            state.add_metric([name, each.value], float(status.state == each))
        for reason, number in status.rejected.items():
            rejected.add_metric([name, reason], number)
    yield state
    yield from _autopilot_metrics(statuses)
    rates = {name: status.imu_rate_hz for name, status in statuses.items()}
    yield _metric("imu_rate_hertz", "IMU samples a second.", rates)
    gaps = {name: status.worst_gap_s for name, status in statuses.items()}
    yield _metric("worst_gap_seconds", "Worst gap so far.", gaps)
    yield rejected
    overruns = max((status.overruns for status in statuses.values()), default=0)
    dropped = max((status.dropped for status in statuses.values()), default=0)
    yield CounterMetricFamily("fuzzbee_overruns", "Ticks that came late.", value=overruns)
    yield CounterMetricFamily("fuzzbee_dropped", "Events and records lost.", value=dropped)
