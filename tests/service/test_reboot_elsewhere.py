"""A simulator whose home is changed reboots beside a service that goes on."""

from math import cos, degrees, sin

import pytest

from drivers.mavlink.encoder import FrameEncoder, raw_imu
from estimator.geometry.earth import field_at
from service.pipeline import Pipeline
from tests.drivers.mavlink.messages import frame, m
from tests.service.flight_rig import IMU, ONE, Wire, attitudes

PERIOD_US = 20_000
UNIX_US = 1_735_689_600_000_000  # 2025; fields change by a tenth of a degree a year
CAPE_TOWN, SEATTLE = (-33.93, 18.42), (47.61, -122.33)
GPS_EVERY, FIRST_FIX, SAMPLES = 10, 30, 1500
FIX_3D = 3


def sent(place, uptime_us):
    """The bytes of each sample of a vehicle that stands level and faces true north."""
    encoder, here = FrameEncoder(ONE), field_at(*place, 0.0, UNIX_US)
    north, down = (here.strength_gauss * f(here.dip_rad) for f in (cos, sin))
    field = (north * cos(here.declination_rad), north * sin(here.declination_rad), down)
    for number in range(SAMPLES):
        time_us = uptime_us + number * PERIOD_US
        shake = 0.01 * (number % 5)  # a sensor that repeats itself is stuck
        yield encoder.frame(raw_imu(time_us, (shake, 0.0, -9.81), (0.0, 0.0, 0.0), field), 0)
        if number >= FIRST_FIX and number % GPS_EVERY == 0:
            lat, lon = (round(1e7 * degree) for degree in place)
            rest = (0, 90, 90, 0, 0, 12)
            yield frame(m.MAVLink_gps_raw_int_message(time_us, FIX_3D, lat, lon, *rest))


def yaw_deg(record):
    """In -180 to 180."""
    return (record.euler_deg[2] + 180.0) % 360.0 - 180.0


def test_after_a_reboot_elsewhere_north_is_that_places():
    """Declinations of -26 and 15 deg: with the first place's, the second heading is 41 deg off."""
    places = [field_at(*place, 0.0, UNIX_US) for place in (CAPE_TOWN, SEATTLE)]
    apart = abs(degrees(places[0].declination_rad - places[1].declination_rad))
    assert apart == pytest.approx(41.0, abs=1.0)
    pipeline, wire = Pipeline(IMU, rate_hz=50.0), Wire()
    now_us, flights = UNIX_US, []
    for place, uptime_us in ((CAPE_TOWN, 100_000_000), (SEATTLE, 3_000_000)):
        records = []
        for data in sent(place, uptime_us):
            now_us += PERIOD_US
            for event in wire.events(data, now_us):
                records += attitudes(pipeline.handle(event, now_us))
        flights.append(records)
        assert records[-1].heading_reference == "true"
        assert abs(yaw_deg(records[-1])) < 2.0
    # until its position has come the old place's declination counts
    assert max(abs(yaw_deg(record)) for record in flights[1]) == pytest.approx(41.0, abs=2.0)
