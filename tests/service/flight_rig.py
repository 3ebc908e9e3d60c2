"""A simulated vehicle; faults come before its frames (``change``) or behind (``deliver``)."""

import math
from collections.abc import Callable
from typing import Any

from drivers.events import Event, Imu, VehicleId
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.encoder import FrameEncoder, raw_imu
from drivers.mavlink.framing import FrameReader
from drivers.mavlink.gate import FrameGate, Policy
from drivers.simulation.simulated_vehicle import Sample, SimulatedVehicle
from estimator.geometry.metrics import angle_errors
from estimator.profile import load_profile
from estimator.types import ImuSample
from service.pipeline import Pipeline
from service.records import AttitudeRecord, Message, Published, StatusRecord
from service.vehicle_status import Load, status_record

START_US = 1_700_000_000_000_000
UNDER_WAY_US = 2_000
ONE = VehicleId(1, 1)
PAPER, IMU = load_profile("paper"), load_profile("imu")
S = 1_000_000
SETTLE_S = 8.0  # of flight before a fault


def imu_events(count, *, vehicle=ONE, seed=0, start_us=START_US, source=None) -> list[Event]:
    """``count`` samples, of the paper's motion at 100 Hz if no source is given, 2 ms under way."""
    source = source or SimulatedVehicle(seed=seed)
    events: list[Event] = []
    for _ in range(count):
        sample = ImuSample(*next(source)[:4], has_mag=True)
        arrival_us = start_us + sample.time_us + UNDER_WAY_US
        events.append(Imu(vehicle, arrival_us, sample.time_us, "RAW_IMU", sample))
    return events


def fed(events, pipeline="paper"):
    """A pipeline, or one of the profile of that name, that has taken the events."""
    if isinstance(pipeline, str):
        pipeline = Pipeline(load_profile(pipeline))
    for event in events:
        pipeline.handle(event)
    return pipeline


def attitudes(outputs, kind=AttitudeRecord):
    records = [each.record for each in outputs if isinstance(each, Published)]
    return [record for record in records if isinstance(record, kind)]


def statuses(outputs):
    return attitudes(outputs, StatusRecord)


def texts(outputs):
    return [each.text for each in outputs if isinstance(each, Message)]


class Wire:
    """Bytes to events, as a link makes them."""

    def __init__(self, decoder=None):
        self._reader, self._decoder = FrameReader(), decoder or MavlinkDecoder()

    def events(self, data, now_us):
        frames = self._reader.feed(data)
        return [event for frame in frames for event in self._decoder.events(frame, now_us)]


class Rig:
    """One vehicle at ``rate_hz`` and a service that ticks with every sample."""

    def __init__(self, profile="paper", rate_hz=50.0, *, seed=3):
        self.samples = SimulatedVehicle(seed=seed, rate_hz=rate_hz, noise=0.1, bias=0.1)
        self.pipeline = Pipeline(load_profile(profile), rate_hz=rate_hz)
        self.encoder = FrameEncoder(ONE)
        self.decoder = MavlinkDecoder(references=False)
        self.gate = FrameGate(Policy())
        self.readers: dict[str, FrameReader] = {}
        self.messages: list[str] = []
        self.records: list[AttitudeRecord] = []
        self.errors_deg: list[float] = []
        self.tilt_errors_deg: list[float] = []
        self.boot_shift_us = 0
        self.host_shift_us = 0  # a host clock that was set
        self.now_us = START_US
        self.truth = (1.0, 0.0, 0.0, 0.0)

    @property
    def vehicle(self):
        return self.pipeline.vehicle(ONE)

    @property
    def rejected(self):
        return dict(self.vehicle.rejected)

    def status(self) -> StatusRecord:
        return status_record(self.vehicle, self.now_us + self.host_shift_us, Load(), 0)

    def fly(
        self,
        seconds: float,
        change: Callable[[Sample], Sample] = lambda sample: sample,
        deliver: Callable[[bytes], list[bytes]] = lambda frame: [frame],
    ) -> "Rig":
        """Fly on; returns self. ``records`` and ``errors_deg`` are those of this stretch."""
        self.records, self.errors_deg, self.tilt_errors_deg, self.messages = [], [], [], []
        sample = next(self.samples)
        end_us = sample.time_us + seconds * S
        while True:
            self.now_us = START_US + sample.time_us + UNDER_WAY_US
            self.truth = sample.q_ned_frd
            for frame in deliver(self.frame(change(sample))):
                self.receive(frame)
            self.tick()
            if sample.time_us >= end_us:
                return self
            sample = next(self.samples)

    def frame(self, sample: Sample) -> bytes:
        vectors = sample.acc_m_s2, sample.gyr_rad_s, sample.mag_gauss
        return self.encoder.frame(
            raw_imu(sample.time_us + self.boot_shift_us, *vectors), self.now_us
        )

    def receive(self, data: bytes, peer: str = "a") -> None:
        arrival_us = self.now_us + self.host_shift_us
        for frame in self.readers.setdefault(peer, FrameReader()).feed(data):
            if self.gate.lets_in(frame, peer, arrival_us):
                self.handle(self.decoder.events(frame, arrival_us))
        self.handle(self.gate.take_refused(arrival_us))

    def handle(self, events: list[Any]) -> None:
        for event in events:
            self.take(self.pipeline.handle(event, self.now_us + self.host_shift_us))

    def tick(self, load: Load | None = None) -> None:
        self.take(self.pipeline.tick(self.now_us + self.host_shift_us, load))

    def take(self, outputs: list[Any]) -> None:
        for output in outputs:
            if isinstance(output, Message):
                self.messages.append(output.text)
            elif not isinstance(output, Published) or output.vehicle != ONE:
                continue
            elif isinstance(output.record, AttitudeRecord):
                assert math.isclose(math.hypot(*output.record.q_ned_frd), 1.0, abs_tol=1e-9)
                self.records.append(output.record)
                errors = angle_errors(output.record.q_ned_frd, self.truth)
                self.errors_deg.append(math.degrees(errors.total_rad))
                self.tilt_errors_deg.append(math.degrees(errors.inclination_rad))


def frozen(*fields):
    """A change that keeps these readings of the first sample."""
    first = []

    def change(sample):
        first.append(sample)
        return sample._replace(**{field: getattr(first[0], field) for field in fields})

    return change


def spiked(field, sizes, rng, axis=None):
    """A change that adds one of the sizes to a hundredth of the readings, on one axis or any."""

    def change(sample):
        if rng.random() > 0.01:
            return sample
        values = list(getattr(sample, field))
        values[rng.randrange(3) if axis is None else axis] += rng.choice(sizes)
        return sample._replace(**{field: tuple(values)})

    return change


def apart_deg(rig, quiet, last=0):
    """How far the errors of two flights are apart, in the last records or in all."""
    pairs = zip(rig.errors_deg[-last:], quiet.errors_deg[-last:], strict=True)
    return [abs(a - b) for a, b in pairs]


def states(rig):
    """The states of the records, without repetitions."""
    seen = []
    for record in rig.records:
        if not seen or seen[-1] != record.state:
            seen.append(record.state)
    return seen
