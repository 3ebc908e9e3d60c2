"""A flight written as every kind of log, byte by byte, and what is asked of its events."""

import json
import struct
from collections import Counter
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import pytest
from pymavlink.DFReader import FORMAT_TO_STRUCT

from drivers.events import Imu, Malformed, Rejected
from drivers.logs.open import ULOG_MAGIC
from drivers.simulation.simulated_vehicle import SimulatedVehicle
from tests.drivers.mavlink.messages import UNIX, S, m

DATA = Path(__file__).parents[2] / "data"
RATE_HZ, LAST_S = 50.0, 24.0


def flight():
    """(seconds, sample) of the paper's motion with a tenth of its noise."""
    vehicle = SimulatedVehicle(seed=6, rate_hz=RATE_HZ, noise=0.1, bias=0.1)
    for _ in range(round(LAST_S * RATE_HZ)):
        sample = next(vehicle)
        yield sample.time_us / S, sample._replace(time_us=sample.time_us + 5 * S)


class DataflashWriter:
    def __init__(self):
        self._formats = {}
        self.data = b""
        self.format("FMT", "BBnNZ", "Type,Length,Name,Format,Columns", 0x80)

    def format(self, name, codes, columns, number=None):
        number = number or 0x81 + len(self._formats)
        layout = "<" + "".join(FORMAT_TO_STRUCT[code][0] for code in codes)
        self._formats[name] = (number, layout, codes)
        self.write("FMT", number, struct.calcsize(layout) + 3, name, codes, columns)

    def write(self, name, *values):
        raw, codes = [], self._formats[name][2]
        for code, value in zip(codes, values, strict=True):
            scale = FORMAT_TO_STRUCT[code][1]
            raw.append(value.encode() if isinstance(value, str) else value)
            if scale is not None and isinstance(value, int | float):
                raw[-1] = round(value / scale)
        self.store(name, *raw)

    def store(self, name, *raw):
        """The message of numbers and bytes as they are stored."""
        number, layout, _ = self._formats[name]
        self.data += b"\xa3\x95" + bytes([number]) + struct.pack(layout, *raw)

    def save(self, folder):
        path = folder / "flight.bin"
        path.write_bytes(self.data)
        return path


class UlogWriter:
    def __init__(self):
        self.data = ULOG_MAGIC + b"\x01" + struct.pack("<Q", 1000)

    def write(self, kind, body):
        self.data += struct.pack("<H", len(body)) + kind + body
        return self

    def sensors(self):
        self.topic(7, "sensor_combined", "float[3] gyro_rad;float[3] accelerometer_m_s2")
        return self.topic(8, "vehicle_magnetometer", "float[3] magnetometer_ga")

    def sample(self, time_us, gyr, acc):
        return self.row(7, "6f", time_us, *gyr, *acc)

    def mag(self, time_us, gauss):
        return self.row(8, "3f", time_us, *gauss)

    def topic(self, number, name, fields):
        self.write(b"F", f"{name}:uint64_t timestamp;{fields};".encode())
        return self.write(b"A", b"\0" + struct.pack("<H", number) + name.encode())

    def row(self, number, layout, time_us, *values):
        return self.write(b"D", struct.pack("<HQ" + layout, number, time_us, *values))

    def save(self, folder):
        path = folder / "flight.ulg"
        path.write_bytes(self.data)
        return path


def tlog(samples, folder, arrival_us=lambda k: UNIX + round((k + 1) * S / RATE_HZ), lost=None):
    """HIGHRES_IMU and the truth; ``lost``: before which sample frames are missing, how many."""
    data, link = b"", m.MAVLink(None, srcSystem=1, srcComponent=1)
    for k, sample in enumerate(samples):
        vectors = (*sample.acc_m_s2, *sample.gyr_rad_s, *sample.mag_gauss)
        imu = m.MAVLink_highres_imu_message(sample.time_us, *vectors, 0, 0, 0, 0, 0)
        truth = m.MAVLink_sim_state_message(*sample.q_ned_frd, *[0] * 17)
        if lost is not None and k == lost[0]:
            link.seq = (link.seq + lost[1]) % 256
        for message in (imu, truth):
            data += arrival_us(k).to_bytes(8, "big") + bytes(message.pack(link))
            link.seq = (link.seq + 1) % 256
    path = folder / "flight.tlog"
    path.write_bytes(data)
    return path


def dataflash(samples, folder):
    log = DataflashWriter()
    log.format("IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.format("MAG", "QBfff", "TimeUS,I,MagX,MagY,MagZ")
    log.format("SIM", "Qffff", "TimeUS,Q1,Q2,Q3,Q4")
    for sample in samples:
        log.write("MAG", sample.time_us, 0, *(1000 * x for x in sample.mag_gauss))
        log.write("IMU", sample.time_us, 0, *sample.gyr_rad_s, *sample.acc_m_s2)
        log.write("SIM", sample.time_us, *sample.q_ned_frd)
    return log.save(folder)


def ulog(samples, folder):
    log = UlogWriter().sensors().topic(9, "vehicle_attitude_groundtruth", "float[4] q")
    for sample in samples:
        log.mag(sample.time_us, sample.mag_gauss)
        log.sample(sample.time_us, sample.gyr_rad_s, sample.acc_m_s2)
        log.row(9, "4f", sample.time_us, *sample.q_ned_frd)
    return log.save(folder)


def table(samples, folder):
    """Dated: the first row counts as zero."""
    axes = [f"{name}_{axis}{unit}" for name, unit in SENSORS.items() for axis in "xyz"]
    lines = [",".join(["time_s", *axes, "w", "x", "y", "z"])]
    for sample in samples:
        vectors = (*sample.gyr_rad_s, *sample.acc_m_s2, *sample.mag_gauss, *sample.q_ned_frd)
        lines.append(f"{1.7e9 + sample.time_us / S:.6f}," + ",".join(f"{x:.9g}" for x in vectors))
    path = folder / "flight.csv"
    path.write_text("\n".join(lines))
    path.with_suffix(".toml").write_text('truth = { columns = ["w", "x", "y", "z"] }')
    return path


def mcap(samples, folder, recorded_ns=lambda k: k):
    """As JSON, without the truth."""

    def messages():
        for k, s in enumerate(samples):
            mag, gyr, acc = (
                {"x": x, "y": -y, "z": -z}
                for x, y, z in ([1e-4 * x for x in s.mag_gauss], s.gyr_rad_s, s.acc_m_s2)
            )
            stamp_ns = 1_700_000_000 * 10**9 + 1000 * s.time_us
            imu = {"angular_velocity": gyr, "linear_acceleration": acc}
            yield "MagneticField", recorded_ns(k), stamp_ns, {"magnetic_field": mag}
            yield "Imu", recorded_ns(k), stamp_ns, imu

    return json_mcap(folder / "flight.mcap", messages())


@contextmanager
def mcap_file(path, *, finishes=True, **options):
    """A writer of an MCAP file; one that is killed does not finish."""
    writers = pytest.importorskip("mcap.writer")
    with path.open("wb") as file:
        writer = writers.Writer(file, **options)
        writer.start()
        yield writer
        if finishes:
            writer.finish()


def json_mcap(path, messages):
    """Messages of sensor_msgs (kind, time of recording and stamp in ns, fields), as rosbridge's."""
    channels = {}
    with mcap_file(path) as log:
        for kind, recorded_ns, stamp_ns, fields in messages:
            if kind not in channels:
                schema = log.register_schema(f"sensor_msgs/{kind}", "jsonschema", b"{}")
                channels[kind] = log.register_channel(f"/{kind.lower()}", "json", schema)
            second, rest = divmod(stamp_ns, 10**9)
            head = {"header": {"stamp": {"sec": second, "nsec": rest}}}
            data = json.dumps(head | fields).encode()
            log.add_message(channels[kind], recorded_ns, data, recorded_ns)
    return path


SENSORS = {"gyro": "_rad_s", "acc": "_m_s2", "mag": "_gauss"}
WRITERS = {"tlog": tlog, "dataflash": dataflash, "ulog": ulog, "csv": table}
ALL_WRITERS = {**WRITERS, "mcap": mcap}


def noisy(rng, vector, sigma=0.01):
    return tuple(x + rng.gauss(0.0, sigma) for x in vector)


def of(kind, events, message=None):
    found = [event for event in events if isinstance(event, kind)]
    return [event for event in found if message is None or event.message == message]


def imu_times(events, message=None):
    return [event.sample.time_us for event in of(Imu, events, message)]


def gaps_s(times_us):
    return [(b - a) / S for a, b in pairwise(times_us)]


def malformed(events):
    return sum(event.frames for event in of(Malformed, events))


def reasons(events):
    return Counter(str(event.reason) for event in of(Rejected, events))
