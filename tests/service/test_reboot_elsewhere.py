"""A simulator whose home is changed reboots beside a service that goes on: over a real socket."""

import socket
import time
from math import cos, degrees, sin

import pytest

from drivers.endpoint import parse_endpoint
from drivers.mavlink.constants import mavlink
from drivers.mavlink.encoder import FrameEncoder, raw_imu
from drivers.source import open_live
from estimator.geometry.earth import field_at
from estimator.profile import load_profile
from service.pipeline import Pipeline
from service.process import load_kernels
from service.runner import Runner
from service.sinks.sink import Outbox
from tests.fuzzbee.processes import free_port
from tests.service.sinks.test_sink import Collector
from tests.service.streams import ONE, attitudes

HOST = "127.0.0.1"
PATIENCE_S = 120.0  # a slow machine fails no test
PERIOD_S = 0.02
UNIX_US = 1_735_689_600_000_000  # 2025; fields change by a tenth of a degree a year
CAPE_TOWN, SEATTLE = (-33.93, 18.42), (47.61, -122.33)
GPS_EVERY, FIRST_FIX = 10, 30  # samples
FIX_3D = 3


class Level:
    """A vehicle that stands level and faces true north; sends when asked to."""

    def __init__(self, port):
        self._link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._port = port
        self._encoder = FrameEncoder(ONE)
        self._dialect = mavlink()
        self._mav = self._dialect.MAVLink(None, srcSystem=1, srcComponent=1)

    def close(self):
        self._link.close()

    def boot(self, place, uptime_s):
        """Anew at a place, where the field is that place's own."""
        self._place, self._uptime_s = place, uptime_s
        self._begin_s, self._sent = time.monotonic(), 0
        here = field_at(*place, 0.0, UNIX_US)
        north, down = (
            here.strength_gauss * cos(here.dip_rad),
            here.strength_gauss * sin(here.dip_rad),
        )
        turn = here.declination_rad
        self._mag = (north * cos(turn), north * sin(turn), down)

    def send_due(self):
        """What is due by now: IMU at 50 Hz, the receiver's word at 5 Hz."""
        while self._begin_s + self._sent * PERIOD_S <= time.monotonic():
            time_us = round(1e6 * (self._uptime_s + self._sent * PERIOD_S))
            shake = 0.01 * (self._sent % 5)  # a sensor that repeats itself is stuck
            imu = raw_imu(time_us, (shake, 0.0, -9.81), (0.0, 0.0, 0.0), self._mag)
            self._put(self._encoder.frame(imu, 0))
            if self._sent >= FIRST_FIX and self._sent % GPS_EVERY == 0:
                lat, lon = (round(1e7 * degree) for degree in self._place)
                fix = self._dialect.MAVLink_gps_raw_int_message(
                    time_us, FIX_3D, lat, lon, 0, 90, 90, 0, 0, 12
                )
                self._put(fix.pack(self._mav))
            self._sent += 1

    def _put(self, data):
        self._link.sendto(data, (HOST, self._port))


def yaw_deg(record):
    """In -180 to 180."""
    return (record.euler_deg[2] + 180.0) % 360.0 - 180.0


def faces_north(record, before_us, after_us):
    """Whether it is of that stretch of the vehicle's clock, and from true north."""
    inside = before_us <= record.time_boot_us < after_us
    return inside and record.heading_reference == "true" and abs(yaw_deg(record)) < 2.0


@pytest.fixture
def vehicle():
    one = Level(free_port(socket.SOCK_DGRAM))
    yield one
    one.close()


def test_after_a_reboot_elsewhere_north_is_that_places(vehicle):
    """Declinations of -26 and 15 deg: with the first place's, the second heading is 41 deg off."""
    places = [field_at(*place, 0.0, UNIX_US) for place in (CAPE_TOWN, SEATTLE)]
    apart = abs(degrees(places[0].declination_rad - places[1].declination_rad))
    assert apart == pytest.approx(41.0, abs=1.0)
    kept = Collector()
    load_kernels()  # compiling takes longer than any patience
    pipeline = Pipeline(load_profile("imu"))
    endpoint = parse_endpoint(f"udpin:{HOST}:{vehicle._port}")
    with open_live(endpoint) as source, Outbox([kept]) as outbox:
        runner = Runner(source, pipeline, outbox, rate_hz=50.0)
        for place, uptime_s in ((CAPE_TOWN, 100.0), (SEATTLE, 3.0)):
            vehicle.boot(place, uptime_s)
            begin_us = 1e6 * uptime_s

            def is_over(begin_us=begin_us):
                vehicle.send_due()
                return any(
                    faces_north(r, begin_us, begin_us + 90e6) for r in attitudes(kept.got[-9:])
                )

            runner.run(PATIENCE_S, is_over=is_over)
            assert is_over(), kept.got[-3:]
    turned = [yaw_deg(r) for r in attitudes(kept.got) if r.time_boot_us < 90e6]
    # until its position has come the old place's declination counts
    assert max(map(abs, turned)) == pytest.approx(41.0, abs=2.0)
