"""A log replayed: a table of estimates and samples, references, counts."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from math import radians
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers import events
from drivers.logs.log_file import LogFile
from drivers.logs.open import open_log
from drivers.logs.reference_track import ReferenceTrack
from drivers.logs.table import Table
from drivers.logs.time_window import WHOLE_LOG, TimeWindow, WindowedEvents
from estimator.errors import InputError
from estimator.estimator import Estimator
from estimator.geometry.quaternion import exp, scale
from estimator.live.rows import BIAS, RATE, SIGMA, Q
from estimator.profile import Profile
from estimator.types import Attitude, Floats, ImuSample, Vec3
from fuzzbee.attitudes import PLACE
from service.pipeline import Pipeline
from service.publishing import is_finite
from service.records import Message
from service.vehicle import Vehicle
from tuning.online.retuner import RetunedEstimator

MUCH_REFUSED = 0.1  # of all readings: a line is printed
MOST_REASONS = 3  # that it names
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
    """How a log is replayed."""

    fixed_gain: float | None = None  # in place of the fuzzy one
    system_id: int | None = None  # the vehicle; without it the one with most IMU samples
    start_wrong_deg: float = 0.0  # once, about WRONG_START_AXIS (NED), when a reference is known
    retune: bool = False  # a few numbers of the profile, on the way
    smooth: bool = False  # the attitudes are by the whole log
    columns: Path | None = None  # the file that describes those of a table
    window: TimeWindow = WHOLE_LOG  # all that is read
    reading: Callable[[LogFile], AbstractContextManager[object]] = nullcontext  # entered meanwhile
    new_estimator: Callable[[Profile], Estimator] | None = None  # not those of retune and smooth
    fits_built_in: bool = False  # see service.pipeline.Pipeline


AS_LIVE = How()


class VehicleTrace(Table):
    """One vehicle's estimates and references in the order of the log.

    Its columns are :data:`COLUMNS`, and those that :func:`fuzzbee.replays.score.compare` adds.
    """

    def __init__(self, address: events.VehicleId) -> None:
        super().__init__(**COLUMNS)
        self.address = address
        self.log: LogFile  # what it was read from, if it was
        self.vehicle: Vehicle  # since the first sample
        self.kind: tuple[int | None, int | None] = None, None  # MAV_AUTOPILOT, MAV_TYPE
        self.imu_messages: Counter[str] = Counter()  # samples used of each
        self.references = {"sim": ReferenceTrack(), "autopilot": ReferenceTrack()}
        self.velocities = defaultdict[str, Table](lambda: Table(**VELOCITIES))  # by message
        self.reference: str | None = None  # the one that it is compared with
        self.warned_s: Counter[str] = Counter()  # for how long each warning stood
        self.malformed = 0  # rows or frames of the log that cannot be read, of any sender
        self.last_us: int | None = None  # the latest sample
        self.has_heading = False  # whether there is one to score: by a field or by velocity
        self.turned_at_us: int | None = None
        self.log_zero_us: int | None = None  # where the log's seconds begin, of a window of it
        self.parameters: dict[str, float] = {}
        # when a mode, arming or disarming, and each warning first came
        self.modes: list[tuple[int, int]] = []
        self.arming: list[tuple[int, int]] = []
        self.texts: dict[str, int] = {}
        self.lines: list[str] = []  # for a person

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
    def refused(self) -> str:
        """One line, where a good part of the log was refused."""
        counts, used = self.rejected, len(self)
        if counts.total() <= MUCH_REFUSED * (counts.total() + used):
            return ""
        reasons = ", ".join(f"{n} x {reason}" for reason, n in counts.most_common(MOST_REASONS))
        return f"much was refused: {reasons}; {used} samples were used"

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

    @property
    def zero_us(self) -> int:
        """The time that all seconds count from: the log's first IMU sample."""
        return int(self["time_us"][0]) if self.log_zero_us is None else self.log_zero_us

    @property
    def time_s(self) -> Floats:
        """Seconds (N,) of the log at the samples."""
        return np.array(1e-6 * (self["time_us"] - self.zero_us), dtype=float)


class Replay:
    """Feeds events through the live pipeline and keeps its estimates."""

    def __init__(self, profile: Profile, how: How = AS_LIVE) -> None:
        self._how = how
        self.why_empty: str | None = None  # why nothing of the log lay in the window
        self.pipeline = Pipeline(
            profile,
            system_id=how.system_id,
            new_estimator=how.new_estimator or self._new_estimator,
            fits_built_in=how.fits_built_in,
        )
        self._wrong_turn = exp(scale(radians(how.start_wrong_deg), WRONG_START_AXIS))
        self.traces: dict[events.VehicleId, VehicleTrace] = {}  # of all that sent anything
        self.lines: list[str] = []  # the pipeline's

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

    def _trace(self, event: events.VehicleEvent) -> VehicleTrace:
        if event.vehicle not in self.traces:
            self.traces[event.vehicle] = VehicleTrace(event.vehicle)
        return self.traces[event.vehicle]

    def _take(self, event: events.Event) -> None:
        outputs = self.pipeline.handle(event)
        self.lines += [output.text for output in outputs if isinstance(output, Message)]
        match event:
            case events.Imu():
                self._after_imu(event)
            case events.ReferenceAttitude(source=source):
                self._trace(event).references[source].add(event)
            case events.Velocity(message=name, sample=sample):
                self._trace(event).velocities[name].append(*sample[: len(VELOCITIES)])
            case events.Parameter(name=name, value=value):
                self._trace(event).parameters[name] = value
            case events.StatusText() if event.severity <= LEAST_SEVERITY:
                self._trace(event).texts.setdefault(event.text, event.arrival_us)
            case events.Heartbeat() | events.ModeChange():
                trace = self._trace(event)
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
        trace = self._trace(event)
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


def replay_log(path: Path, profile: Profile, how: How = AS_LIVE) -> VehicleTrace:
    """The trace of one vehicle.

    Raises:
        InputError: the log cannot be read, or holds no IMU data that can be used.
    """
    replay = Replay(profile, how)
    with open_log(path, how.columns) as log, how.reading(log):
        replay.run(log)
    trace = replay.longest()
    if trace is None:
        whose = "" if how.system_id is None else f" of system id {how.system_id}"
        none = f"no IMU data{whose} that can be used{_seen_text(replay)}"
        raise InputError(f"{path}: {replay.why_empty or log.advice(how.system_id) or none}")
    trace.log, trace.lines = log, replay.lines
    if trace.refused:
        trace.lines.append(trace.refused)
    if how.smooth:
        _smooth(trace)
    return trace


def _seen_text(replay: Replay) -> str:
    """What the log has instead of usable IMU data, for the error message."""
    pipeline = replay.pipeline
    refused = sum((each.rejected for each in pipeline.vehicles), start=Counter[str]())
    if refused:
        return ": " + ", ".join(f"{n} x {reason}" for reason, n in sorted(refused.items()))
    if ids := sorted(pipeline.systems | {address.system_id for address in replay.traces}):
        return f" (vehicles seen: {', '.join(map(str, ids))})"
    return f": {pipeline.malformed} x malformed" if pipeline.malformed else ""


def _smooth(trace: VehicleTrace) -> None:
    """Put the smoothed attitudes into the trace; what the end knows of north holds for all."""
    from estimator.smoothing import Recorder, smooth_all

    assert isinstance(trace.vehicle.estimator, Recorder)
    times_us, now = smooth_all(trace.vehicle.estimator)
    trace.vehicle.estimator.recordings().clear()  # for each sample its readings
    at, north = np.searchsorted(times_us, trace["time_us"]), trace["heading_reference"]
    trace.put("q_ned_frd", [now[at, Q]])
    trace.put("rate_rad_s", [now[at, RATE]])
    trace.put("gyro_bias_rad_s", [now[at, BIAS]])
    trace.put("sigma_inclination_rad", [now[at, SIGMA][:, 0]])
    trace.put("sigma_heading_rad", [now[at, SIGMA][:, 1]])
    trace.put("heading_reference", [np.full_like(north, north[-1])])
