"""An IMU message, a source of aiding and a sink that the product has only in its tables."""

import math
from pathlib import Path

from drivers.mavlink.messages import IMU_MESSAGES, MESSAGES, ImuMessage, MessageKind
from drivers.samples.imu_stream import Stamp
from drivers.samples.vehicle_clock import TimeField
from estimator.aiding.sources.source import SOURCES
from fuzzbee.outputs import SINKS, SinkEntry, setting
from service.records import AttitudeRecord, Published
from tests.estimator.aiding.heading_source import HEADING_SOURCE, HeadingSample

HEADING_SIGMA_RAD = math.radians(0.1)
NO_YAW = 0


def hil_vectors(m):
    """HIL_SENSOR: rad/s, m/s^2 and gauss, FRD."""
    return (m.xgyro, m.ygyro, m.zgyro), (m.xacc, m.yacc, m.zacc), (m.xmag, m.ymag, m.zmag)


HIL_SENSOR = ImuMessage(
    107, "HIL_SENSOR", TimeField.TIME_USEC, hil_vectors, setting="a simulator in the loop"
)


def gps2_heading(intake, message):
    """GPS2_RAW of a receiver with two antennas: its yaw is in 0.01 degrees."""
    m = message.fields
    if m.yaw == NO_YAW:
        return []
    stamp = Stamp(TimeField.GPS, m.time_usec, message.arrival_us)
    heading_rad = math.radians(0.01 * m.yaw)
    return intake.report(
        message.name, stamp, lambda time_us: HeadingSample(time_us, heading_rad, HEADING_SIGMA_RAD)
    )


GPS2_RAW = MessageKind(124, "GPS2_RAW", gps2_heading)


class HeadingsFile:
    """A sink that writes system and heading of each attitude as a line."""

    name = "headings"

    def __init__(self, path):
        self._file = Path(path).open("w", encoding="utf-8")  # noqa: SIM115 - until close

    def handle(self, outputs):
        for output in outputs:
            if isinstance(output, Published) and isinstance(output.record, AttitudeRecord):
                print(output.vehicle.system_id, output.record.euler_deg[2], file=self._file)
        self._file.flush()

    def close(self):
        self._file.close()


HEADINGS = SinkEntry(
    {"headings": setting(str, "Write each heading into a file.", metavar="FILE")},
    lambda options, _session: HeadingsFile(options.outputs.headings),
)


def add():
    IMU_MESSAGES[HIL_SENSOR.number] = HIL_SENSOR
    MESSAGES[GPS2_RAW.number] = GPS2_RAW
    SOURCES[HeadingSample] = HEADING_SOURCE
    SINKS.append(HEADINGS)
