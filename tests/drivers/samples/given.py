"""One vehicle's intake, and readings for it."""

from drivers.events import VehicleId
from drivers.samples.imu_stream import Field, Stamp
from drivers.samples.intake import Intake
from drivers.samples.vehicle_clock import TimeField
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3

S = 1_000_000
UNIX = 1_700_000_000 * S
VEHICLE = VehicleId(1, 1)
BOOT_MS, GPS = TimeField.BOOT_MS, TimeField.GPS
REST = (0.0, 0.0, -STANDARD_GRAVITY_M_S2)
FIELD = (0.2, 0.0, 0.4)
PLACE = (47.0, 8.5, 500.0)


def stamp(raw_us, arrival_us=None, clock=BOOT_MS):
    return Stamp(clock, raw_us, UNIX + raw_us if arrival_us is None else arrival_us)


def imu(intake, raw_us, arrival_us=None, gyr=ZERO_VEC3, acc=REST, mag=FIELD, name="SCALED_IMU"):
    return intake.imu(name, stamp(raw_us, arrival_us), gyr, acc, Field(mag))


def kinds(events):
    return [type(event) for event in events]


def running(first_us=300 * S, count=5):
    """An intake after some IMU messages on the boot clock, and the arrival of the next."""
    intake = Intake(VEHICLE)
    for k in range(count):
        imu(intake, first_us + 250_000 * k)
    return intake, UNIX + first_us + 250_000 * count
