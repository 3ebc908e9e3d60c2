"""The result of replaying a log: a table of estimates and samples, references, counts."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, nullcontext
from math import radians
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers import events
from drivers.logs.log_file import LogFile
from drivers.logs.reference_track import ReferenceTrack
from drivers.logs.table import Table
from drivers.logs.time_window import WHOLE_LOG, TimeWindow, WindowedEvents
from estimator.arrays import Floats
from estimator.estimator import Estimator
from estimator.geometry.quaternion import exp, scale
from estimator.live.rows import BIAS, NORTHS, RATE, SIGMA, Q
from estimator.profile import Profile
from estimator.types import Attitude, ImuSample, Vec3
from fuzzbee.attitudes import PLACE
from service.pipeline import Pipeline
from service.publishing import attitude_record, is_finite
from service.records import AttitudeRecord, Message
from service.vehicle import Vehicle
from tuning.online.retuner import RetunedEstimator

LEAST_SEVERITY = 4  # MAV_SEVERITY_WARNING; greater numbers are less severe
# The axis (NED) of a wrong start: every sensor can see a turn about it.
WRONG_START_AXIS: Vec3 = (3**-0.5, 3**-0.5, 3**-0.5)
# A row: when it came, its time by the clock that stamped the log, the attitude after it (the
# reference of its heading by the place in NORTHS), its sample, and whether velocity helped.
COLUMNS = {
    "arrival_us": "i8",
    "unix_us": "i8",
    "time_us": "i8",
    "q_ned_frd": "4f8",
    "rate_rad_s": "3f8",
    "gyro_bias_rad_s": "3f8",
    **dict.fromkeys(Attitude._fields[4:-1], "f8"),
    "heading_reference": "u1",
    "gyr_rad_s": "3f8",
    "acc_m_s2": "3f8",
    "mag_gauss": "3f8",
    "has_mag": "?",
    "is_aided": "?",
}
VELOCITIES = {"time_us": "i8", "velocity_ned_m_s": "3f8"}


class How(NamedTuple):
    """How a log is replayed.

    ``fixed_gain`` stands in for the fuzzy one. Of several vehicles it is the one with
    ``system_id``, or with most IMU samples. ``start_wrong_deg`` turns the vehicle's estimate about
    NED (1,1,1)/sqrt 3, once, at the first sample for which a reference is known. With ``retune`` a
    few numbers of the profile are retuned on the way, with ``smooth`` the attitudes are by the
    whole log. ``columns`` describes a table. Only ``window`` is read; its seconds count from the
    log's beginning. ``notify`` is given lines for a person, ``reading`` is entered with the log
    while it is read, ``new_estimator`` makes other estimators than those of ``retune`` and
    ``smooth``.
    """

    fixed_gain: float | None = None
    system_id: int | None = None
    start_wrong_deg: float = 0.0
    retune: bool = False
    smooth: bool = False
    columns: Path | None = None
    window: TimeWindow = WHOLE_LOG
    notify: Callable[[str], None] = lambda _: None
    reading: Callable[[LogFile], AbstractContextManager[object]] = nullcontext
    new_estimator: Callable[[Profile], Estimator] | None = None


AS_LIVE = How()


class VehicleTrace(Table):
    """One vehicle's estimates and references in the order of the log.

    Its columns are :data:`COLUMNS`, and those that :func:`fuzzbee.replays.score.compare` adds.
    """

    def __init__(self, address: events.VehicleId) -> None:
        super().__init__(**COLUMNS)
        self.address = address
        self.vehicle: Vehicle  # since the first sample
        self.kind: tuple[int | None, int | None] = None, None  # MAV_AUTOPILOT, MAV_TYPE
        self.imu_messages: Counter[str] = Counter()  # samples used of each
        self.references = {"sim": ReferenceTrack(), "autopilot": ReferenceTrack()}
        self.velocities = defaultdict[str, Table](lambda: Table(**VELOCITIES))  # by message
        self.reference: str | None = None  # the one that it is compared with
        self.warned_s: Counter[str] = Counter()  # for how long each warning stood
        self.malformed = 0  # rows or frames of the log that cannot be read, whoever sent them
        self.last_us: int | None = None  # the latest sample
        self.has_heading = False  # whether there is one to score: by a field or by velocity
        self.turned_at_us: int | None = None
        self.log_zero_us: int | None = None  # where the log's seconds begin, of a window of it
        self.parameters: dict[str, float] = {}
        # when a mode, arming or disarming, and each warning first came
        self.modes: list[tuple[int, int]] = []
        self.arming: list[tuple[int, int]] = []
        self.texts: dict[str, int] = {}

    @property
    def message(self) -> str:
        """The IMU message that was used most."""
        return max(self.imu_messages, key=lambda name: self.imu_messages[name], default="")

    @property
    def step_s(self) -> float:
        """The median time between two samples; 0 of one alone."""
        return 1e-6 * float(np.median(np.diff(self["time_us"]))) if len(self) > 1 else 0.0

    @property
    def rejected(self) -> Counter[str]:
        """What was refused, by reason: samples, and what of the log cannot be read."""
        return Counter[str](self.vehicle.rejected) + Counter(malformed=self.malformed)

    @property
    def available(self) -> list[str]:
        """The references that there are, the best first."""
        return [name for name, track in self.references.items() if track.message is not None]

    @property
    def has_peer(self) -> bool:
        """Whether the autopilot's own estimate stands beside a truth."""
        return self.reference == "sim" and "autopilot" in self.available

    def take(
        self, arrival_us: int, unix_us: int, attitude: Attitude, sample: ImuSample, aided: bool
    ) -> None:
        """Take the attitude after a sample."""
        self.last_us = attitude.time_us
        north = PLACE[attitude.heading_reference]
        self.has_heading |= sample.has_mag or north > 0
        self.append(arrival_us, unix_us, *attitude[:-1], north, *sample[1:], aided)

    def published(
        self, rows: slice, stamps_us: Iterable[int]
    ) -> Iterator[tuple[AttitudeRecord | None, ImuSample]]:
        """What the service would have published with samples, whose Unix times are given."""
        each = zip(self._rows(Attitude, rows), self._rows(ImuSample, rows), stamps_us, strict=True)
        for attitude, sample, unix_us in each:
            times = {"time_unix_us": unix_us, "time_boot_us": sample.time_us}
            yield attitude_record(attitude, sequence=0, **times), sample

    def _rows(self, kind: Any, rows: slice) -> Iterator[Any]:
        """The attitudes or the samples of some rows as the estimator has them."""
        columns = []
        for name in kind._fields:
            found = self[name][rows]
            values = np.array(NORTHS)[found] if name == "heading_reference" else found
            columns.append(map(tuple, values.tolist()) if values.ndim > 1 else values.tolist())
        return map(kind, *columns)

    @property
    def zero_us(self) -> int:
        """The time that all seconds count from: the log's first IMU sample."""
        return int(self["time_us"][0]) if self.log_zero_us is None else self.log_zero_us

    @property
    def time_s(self) -> Floats:
        """Seconds (N,) of the log at the samples."""
        return np.array(1e-6 * (self["time_us"] - self.zero_us), dtype=float)


class Traces(dict[events.VehicleId, VehicleTrace]):
    """Those of all vehicles that sent anything."""

    def __missing__(self, address: events.VehicleId) -> VehicleTrace:
        self[address] = VehicleTrace(address)
        return self[address]


class Replay:
    """Feeds events through the live pipeline and keeps its estimates."""

    def __init__(self, profile: Profile, how: How = AS_LIVE) -> None:
        self._how = how
        self.why_empty: str | None = None  # why nothing of the log lay in the window
        new_estimator = how.new_estimator or self._new_estimator
        self.pipeline = Pipeline(profile, system_id=how.system_id, new_estimator=new_estimator)
        self._wrong_turn = exp(scale(radians(how.start_wrong_deg), WRONG_START_AXIS))
        self.traces = Traces()

    def _new_estimator(self, profile: Profile) -> Estimator:
        if self._how.smooth:
            from estimator.smoothing import Recorder

            return Recorder(profile, self._how.fixed_gain)
        kind = RetunedEstimator if self._how.retune else Estimator
        return kind(profile, self._how.fixed_gain)

    def run(self, arriving: Iterable[events.Event]) -> None:
        """Take all events; a log skips what a live link skips."""
        if isinstance(arriving, LogFile):
            arriving.follow(self.pipeline.imu_in_use)
        windowed = WindowedEvents(arriving, self._how.window)
        for event in arriving if self._how.window == WHOLE_LOG else windowed:
            self._take(event)
        self.why_empty = windowed.why_empty()
        for trace in self.traces.values():
            trace.malformed = self.pipeline.malformed
            trace.log_zero_us = windowed.zero_us(trace.address)

    def longest(self) -> VehicleTrace | None:
        """The vehicle with most estimates, if there is one."""
        sending = [trace for trace in self.traces.values() if len(trace)]
        return max(sending, key=lambda t: (len(t), -t.address.system_id), default=None)

    def _take(self, event: events.Event) -> None:
        for output in self.pipeline.handle(event):
            if isinstance(output, Message):
                self._how.notify(output.text)
        match event:
            case events.Imu():
                self._after_imu(event)
            case events.ReferenceAttitude(vehicle=address, source=source):
                self.traces[address].references[source].add(event)
            case events.Velocity(vehicle=address, message=name, sample=sample):
                self.traces[address].velocities[name].append(*sample[: len(VELOCITIES)])
            case events.Parameter(vehicle=address, name=name, value=value):
                self.traces[address].parameters[name] = value
            case events.StatusText() if event.severity <= LEAST_SEVERITY:
                self.traces[event.vehicle].texts.setdefault(event.text, event.arrival_us)
            case events.Heartbeat() | events.ModeChange():
                trace = self.traces[event.vehicle]
                new = (trace.modes, event.custom_mode), (trace.arming, event.is_armed)
                for known, now in new:
                    if now is not None and (not known or known[-1][1] != now):
                        known.append((event.arrival_us, now))
                if isinstance(event, events.Heartbeat):
                    trace.kind = event.autopilot, event.vehicle_type

    def _after_imu(self, event: events.Imu) -> None:
        vehicle = self.pipeline.vehicle(event.vehicle)
        sample = None if vehicle is None else vehicle.imu.last_sample
        if vehicle is None or sample is None or vehicle.imu.last is not event:
            return
        trace = self.traces[event.vehicle]
        trace.vehicle = vehicle
        if self._how.start_wrong_deg and trace.turned_at_us is None and trace.available:
            vehicle.estimator.turn(self._wrong_turn)
            trace.turned_at_us = vehicle.estimator.snapshot.core.time_us
        attitude = vehicle.estimator.attitude(event.sample.time_us)
        if not is_finite(attitude):
            return  # as in the live service, where it is not published; the vehicle aligns anew
        trace.imu_messages[event.message] += 1
        if trace.last_us is not None and (warnings := vehicle.alarms.words):
            step_s = 1e-6 * (attitude.time_us - trace.last_us)
            trace.warned_s.update(dict.fromkeys(warnings, step_s))
        unix_us = round(attitude.time_us + vehicle.publishing.clock.offset_us)
        trace.take(event.arrival_us, unix_us, attitude, sample, vehicle.estimator.is_aided)


def smooth(trace: VehicleTrace) -> None:
    """Put the smoothed attitudes into the trace; what the end knows of north holds for all."""
    from estimator.smoothing import Recorder, smooth_all

    assert isinstance(trace.vehicle.estimator, Recorder)
    times_us, now = smooth_all(trace.vehicle.estimator)
    trace.vehicle.estimator.recordings().clear()  # for each sample its readings
    at, north = np.searchsorted(times_us, trace["time_us"]), trace["heading_reference"]
    smoothed = {
        "q_ned_frd": now[at, Q],
        "rate_rad_s": now[at, RATE],
        "gyro_bias_rad_s": now[at, BIAS],
        "sigma_inclination_rad": now[at, SIGMA][:, 0],
        "sigma_heading_rad": now[at, SIGMA][:, 1],
        "heading_reference": np.full_like(north, north[-1]),
    }
    for name, values in smoothed.items():
        trace.put(name, [values])
