"""For the tests: a simulated vehicle as events, and what is found in outputs."""

from drivers.events import Event, Imu, VehicleId
from drivers.simulation.simulated_vehicle import SimulatedVehicle
from drivers.simulation.source import imu_sample
from service.records import AttitudeRecord, Message, Published, StatusRecord

START_US = 1_700_000_000_000_000
ONE = VehicleId(1, 1)


def imu_events(count, *, vehicle=ONE, message="RAW_IMU", seed=0, start_us=START_US) -> list[Event]:
    """``count`` samples of the paper's motion at 100 Hz, 2 ms under way."""
    source = SimulatedVehicle(seed=seed)
    events: list[Event] = []
    for _ in range(count):
        sample = imu_sample(next(source))
        arrival_us = start_us + sample.time_us + 2_000
        events.append(Imu(vehicle, arrival_us, sample.time_us, message, sample))
    return events


def attitudes(outputs):
    records = [each.record for each in outputs if isinstance(each, Published)]
    return [record for record in records if isinstance(record, AttitudeRecord)]


def statuses(outputs):
    records = [each.record for each in outputs if isinstance(each, Published)]
    return [record for record in records if isinstance(record, StatusRecord)]


def texts(outputs):
    return [each.text for each in outputs if isinstance(each, Message)]
