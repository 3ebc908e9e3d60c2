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
_SIGMA = "68 % of errors lie under it."
# Name, help, and the number of an attitude
OF_ATTITUDE: tuple[tuple[str, str, Callable[[AttitudeRecord], float]], ...] = (
    ("roll_degrees", "Roll.", lambda a: a.euler_deg[0]),
    ("pitch_degrees", "Pitch.", lambda a: a.euler_deg[1]),
    ("heading_degrees", "Heading, 0 to 360.", lambda a: a.euler_deg[2]),
    ("error", "The paper's e from the measurements, 0 to 1.", lambda a: a.error),
    ("gain", "The paper's K.", lambda a: a.gain),
    ("gravity_confidence", "Confidence in gravity.", lambda a: a.confidence.gravity),
    ("magnetic_confidence", "Confidence in the field.", lambda a: a.confidence.magnetic),
    ("inclination_sigma_degrees", _SIGMA, lambda a: a.sigma_deg.inclination),
    ("heading_sigma_degrees", _SIGMA, lambda a: a.sigma_deg.heading),
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
        """Remember the latest records; who is lost comes last."""
        with self._lock:
            for output in outputs:
                match output:
                    case Departed(vehicle=vehicle):
                        self._attitudes.pop(vehicle_name(vehicle), None)
                        self._statuses.pop(vehicle_name(vehicle), None)
                    case Published(vehicle=vehicle, record=AttitudeRecord() as attitude):
                        self._attitudes[vehicle_name(vehicle)] = (attitude, self._now_s())
                    case Published(vehicle=vehicle, record=StatusRecord() as status):
                        name = vehicle_name(vehicle)
                        before = self._statuses.get(name)
                        if before is not None and _is_lost(status) and not _is_lost(before):
                            del self._statuses[name]
                        self._statuses[name] = status

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
        with self._lock:
            attitudes, statuses = dict(self._attitudes), dict(self._statuses)
        lost = [name for name, status in statuses.items() if _is_lost(status)]
        for name in lost[:-MOST_LOST]:
            attitudes.pop(name, None)
            del statuses[name]
        yield from _of_attitudes(attitudes, set(lost), self._now_s())
        yield from _of_statuses(statuses)


def _is_lost(status: StatusRecord) -> bool:
    return status.state == State.LOST


def _of_attitudes(
    attitudes: dict[str, tuple[AttitudeRecord, float]], lost: set[str], now_s: float
) -> "Iterator[Metric]":
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

    one = ["vehicle"]
    counts = CounterMetricFamily("fuzzbee_attitudes", "Attitudes published.", labels=one)
    ages = GaugeMetricFamily("fuzzbee_imu_age_seconds", "Age of the last IMU sample.", labels=one)
    for name, (attitude, heard_s) in attitudes.items():
        counts.add_metric([name], attitude.sequence + 1.0)
        ages.add_metric([name], attitude.age_ms / 1e3 + max(0.0, now_s - heard_s))
    yield from (counts, ages)
    for metric, text, value in OF_ATTITUDE:
        family = GaugeMetricFamily(f"fuzzbee_{metric}", text, labels=one)
        for name, (attitude, _) in attitudes.items():
            if name not in lost:
                family.add_metric([name], value(attitude))
        yield family


def _of_statuses(statuses: dict[str, StatusRecord]) -> "Iterator[Metric]":
    from prometheus_client.core import CounterMetricFamily as Counter
    from prometheus_client.core import GaugeMetricFamily as Gauge

    one = ["vehicle"]
    state = Gauge("fuzzbee_state", "1 for the state it is in.", labels=[*one, "state"])
    verdict = Gauge("fuzzbee_autopilot", "1 for the verdict on it.", labels=[*one, "verdict"])
    vertical, heading, rate, gap = (
        Gauge(f"fuzzbee_{metric}", text, labels=one)
        for metric, text in (
            ("autopilot_inclination_degrees", "Between the autopilot's vertical and ours."),
            ("autopilot_heading_degrees", "The autopilot's heading less ours."),
            ("imu_rate_hertz", "IMU samples a second."),
            ("worst_gap_seconds", "Worst gap so far."),
        )
    )
    rejected = Counter("fuzzbee_rejected", "Samples refused.", labels=[*one, "reason"])
    for name, status in statuses.items():
        for each in State:
            state.add_metric([name, each.value], status.state == each)
        if (autopilot := status.autopilot) is not None:
            for word in Verdict:
                verdict.add_metric([name, word.value], autopilot.verdict == word)
            vertical.add_metric([name], autopilot.inclination_deg)
            heading.add_metric([name], autopilot.heading_deg)
        rate.add_metric([name], status.imu_rate_hz)
        gap.add_metric([name], status.worst_gap_s)
        for reason, number in status.rejected.items():
            rejected.add_metric([name, reason], number)
    yield from (state, verdict, vertical, heading, rate, gap, rejected)
    overruns = max((status.overruns for status in statuses.values()), default=0)
    dropped = max((status.dropped for status in statuses.values()), default=0)
    yield Counter("fuzzbee_overruns", "Ticks that came late.", value=overruns)
    yield Counter("fuzzbee_dropped", "Events and records lost.", value=dropped)
