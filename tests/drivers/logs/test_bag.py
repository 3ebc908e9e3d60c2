"""Bags of ROS 1 and 2, written by rosbags: a clip of a flight comes back as it was."""

import numpy as np
import pytest

from drivers.endpoint import parse_endpoint
from drivers.events import Imu, Position, ReferenceAttitude
from drivers.logs.open import imu_events, open_log
from estimator.errors import InputError
from estimator.geometry.frames import flu_from_frd, swap_ned_enu
from estimator.types import IDENTITY
from tests.drivers.logs.writers import DATA, gaps_s, imu_times, json_mcap, malformed, mcap_file, of
from tests.vocabulary import assert_attitude_close

rosbag1 = pytest.importorskip("rosbags.rosbag1", reason="the extra 'bags' is not installed")
rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")

BEGIN_US = 1_700_000_000_000_000
UNKNOWN = np.array([-1.0, *8 * [0.0]])
UP = (0.0, 0.1, -9.8)
KINDS = ("folder.mcap", "folder.db3", "ros1.bag")


@pytest.fixture(scope="module")
def flown():
    """A clip's events, of one IMU."""
    with open_log(DATA / "sitl_copter_4hz.tlog") as log:
        return [e for e in log if getattr(e, "message", "") != "SCALED_IMU2"]


class Bag:
    def __init__(self, path):
        self.is_ros1 = path.suffix == ".bag"
        if self.is_ros1:
            self.types = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
            self.writer = rosbag1.Writer(path)
        else:
            self.types = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
            plugin = rosbag2.StoragePlugin["SQLITE3" if path.suffix == ".db3" else "MCAP"]
            self.writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
        self.connections = {}
        self.covariances = np.zeros(9)

    def new(self, name, *values, **fields):
        return self.types.types[name.replace("/", "/msg/")](*values, **fields)

    def put(self, topic, kind, time_us, **fields):
        us = BEGIN_US + time_us
        moment = (us // 10**6, us % 10**6 * 1000)
        head = [0] if self.is_ros1 else []  # its number
        head += [self.new("builtin_interfaces/Time", *moment), "base_link"]
        header = self.new("std_msgs/Header", *head)
        message = self.new(kind, header, **fields)
        name = message.__msgtype__
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, name, typestore=self.types)
        write = self.types.serialize_ros1 if self.is_ros1 else self.types.serialize_cdr
        self.writer.write(self.connections[topic], us * 1000, bytes(write(message, name)))

    def imu(self, topic, time_us, q_wxyz, covariance, gyr, acc):
        """The covariance is the orientation's; what is nothing but zeros has ``covariances``."""
        w, x, y, z = q_wxyz
        zeros = np.zeros(9)
        self.put(
            topic,
            "sensor_msgs/Imu",
            time_us,
            orientation=self.new("geometry_msgs/Quaternion", x, y, z, w),
            orientation_covariance=covariance,
            angular_velocity=self.vector(gyr),
            angular_velocity_covariance=zeros if any(gyr) else self.covariances,
            linear_acceleration=self.vector(acc),
            linear_acceleration_covariance=zeros if any(acc) else self.covariances,
        )

    def field(self, topic, time_us, tesla):
        self.put(
            topic,
            "sensor_msgs/MagneticField",
            time_us,
            magnetic_field=self.vector(tesla),
            magnetic_field_covariance=np.zeros(9),
        )

    def vector(self, v):
        return self.new("geometry_msgs/Vector3", *flu_from_frd(v))


def write(path, events):
    """The IMU raw, attitudes in a filtered Imu beside it, another IMU, field and place."""
    bag = Bag(path)
    with bag.writer:
        for event in events:
            match event:
                case Imu(sample=s):
                    if s.has_mag:
                        bag.field("/imu/mag", s.time_us, [1e-4 * x for x in s.mag_gauss])
                    bag.imu("/imu/data_raw", s.time_us, (1.0, 0.0, 0.0, 0.0), UNKNOWN, *s[1:3])
                    bag.imu("/camera/imu", s.time_us, (1.0, 0.0, 0.0, 0.0), UNKNOWN, s[2], s[1])
                case ReferenceAttitude(source="autopilot", time_us=us, q_ned_frd=q):
                    bag.imu("/imu/data", us, swap_ned_enu(q), np.zeros(9), *2 * [(0,) * 3])
                case Position(message="GLOBAL_POSITION_INT"):
                    for status in (0, -1):
                        bag.put(
                            "/fix",
                            "sensor_msgs/NavSatFix",
                            event.time_us + 1,
                            status=bag.new("sensor_msgs/NavSatStatus", status=status, service=1),
                            latitude=event.latitude_deg,
                            longitude=event.longitude_deg + 90 * status,
                            altitude=event.altitude_m,
                            position_covariance=np.zeros(9),
                            position_covariance_type=0,
                        )
    return path


@pytest.fixture(scope="module", params=KINDS)
def bag(request, tmp_path_factory, flown):
    return write(tmp_path_factory.mktemp("bags") / request.param, flown)


def test_a_flight_comes_back_as_it_was(bag, flown):
    events = list(imu_events(open_log(bag)))
    ours, theirs = of(Imu, events), of(Imu, flown)
    assert {event.message for event in ours} == {"/imu/data_raw"}
    shift_us = ours[0].sample.time_us - theirs[0].sample.time_us
    for a, b in zip((e.sample for e in ours), (e.sample for e in theirs), strict=True):
        near = pytest.approx(b.mag_gauss, rel=1e-12)  # through tesla and back
        assert a == b._replace(time_us=b.time_us + shift_us, mag_gauss=near)
    attitudes = of(ReferenceAttitude, events)
    reported = [event for event in of(ReferenceAttitude, flown) if event.source == "autopilot"]
    assert len(attitudes) == len(reported) > 100
    assert_attitude_close(attitudes[-1].q_ned_frd, reported[-1].q_ned_frd, 1e-9)
    places = of(Position, events)
    there = [event for event in of(Position, flown) if event.message == "GLOBAL_POSITION_INT"]
    assert len(places) == len(there)
    assert places[-1].longitude_deg == there[-1].longitude_deg
    if bag.is_dir():  # the file inside is a log, too
        assert parse_endpoint(str(bag)).kind == "log"
        (inside,) = (each for each in bag.iterdir() if each.suffix != ".yaml")
        assert of(Imu, open_log(inside)) == ours
        assert open_log(bag).sha256() != open_log(inside).sha256()


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
@pytest.mark.parametrize(
    ("options", "finishes", "place"),
    [({}, True, 0), ({"use_chunking": False}, False, 0), ({"chunk_size": 2000}, True, 7)],
    ids=["whole", "its writer was killed", "by two threads"],
)
def test_an_mcap_file_of_others(tmp_path, encoding, options, finishes, place):
    """No profile, another topic in JSON; without an index, or with chunks that overlap."""
    path, put = tmp_path / "a.mcap", []
    store = Bag(tmp_path / ("unused.bag" if encoding == "ros1" else "unused"))
    store.writer.open()
    store.writer.write = lambda _, time_ns, data: put.append((time_ns, data))
    for k in range(96):
        store.imu("/imu", 20_000 * (k + 1), (0.8, 0.6, 0, 0), np.zeros(9), (0.1, 0.2, 0.01 * k), UP)
    store.writer.close()
    with mcap_file(path, finishes=finishes, **options) as writer:
        other = writer.register_schema("note", "jsonschema", b"{}")
        notes = writer.register_channel("/note", "json", other)
        name = "sensor_msgs/Imu" if encoding == "ros1" else "sensor_msgs/msg/Imu"
        imus = writer.register_channel("/imu", encoding, writer.register_schema(name, "", b""))
        for k in range(96):
            time_ns, data = put[k ^ place]
            writer.add_message(notes, time_ns, b"{}", time_ns)
            writer.add_message(imus, time_ns, data, time_ns)
    events = list(open_log(path))
    rates = [event.sample.gyr_rad_s[2] for event in of(Imu, events)]
    assert rates == pytest.approx([0.01 * k for k in range(96)])
    # the same topic has the readings and somebody's attitude
    assert len(of(ReferenceAttitude, events)) == 96


@pytest.mark.parametrize("covariance", [UNKNOWN, np.zeros(9)])
def test_a_cameras_halves_of_an_imu_are_read_only_if_there_is_no_other(tmp_path, covariance):
    """Its rates come by themselves, most often of all, its forces too."""
    for path, others in ((tmp_path / "one", ["/imu/data"]), (tmp_path / "none", [])):
        bag = Bag(path)
        bag.covariances = covariance
        with bag.writer:
            for k in range(1, 61):
                rate = (0.1, 0.2, 0.001 * k)
                bag.imu("/camera/gyro", 10_000 * k, IDENTITY, UNKNOWN, rate, (0.0, 0.0, 0.0))
                if k % 2:
                    bag.imu("/camera/accel", 10_000 * k, IDENTITY, UNKNOWN, (0.0, 0.0, 0.0), UP)
                if k % 3 == 0:
                    for topic in others:
                        bag.imu(topic, 10_000 * k, IDENTITY, np.zeros(9), rate, UP)
        imus = of(Imu, open_log(path))
        assert {event.message for event in imus} == set(others)
        assert len(imus) == 20 * len(others)


def test_a_bag_without_an_imu_is_reported_what_it_has(tmp_path, refused):
    path = tmp_path / "a.mcap"
    with mcap_file(path) as writer:
        kind = writer.register_schema("foxglove.Imu", "protobuf", b"")
        for topic, encoding in (("/imu", "protobuf"), ("/note", "json")):
            channel = writer.register_channel(topic, encoding, kind)
            writer.add_message(channel, 1, b"{}", 1)
    line = refused("replay", path)
    assert "no sensor_msgs/Imu; it has /imu (foxglove.Imu, protobuf), /note (foxglove.Imu)" in line


def imu(k):
    """An IMU's message as JSON, and its times."""
    rate, force = {"x": 0.1, "y": -0.2, "z": -0.01 * k}, {"x": 0.0, "y": 0.0, "z": 9.8}
    stamp_ns = 1_700_000_000 * 10**9 + 20_000_000 * k
    return "Imu", k, stamp_ns, {"angular_velocity": rate, "linear_acceleration": force}


def test_an_mcap_file_in_json(tmp_path):
    """Readings as rosbridge and web recorders write them: no orientation, a stamp in nsec."""
    messages = []
    for k in range(40):
        _, *times_ns, _ = message = imu(k)
        field = {"magnetic_field": {"x": 2e-5, "y": 1e-7 * k, "z": -4e-5}}
        messages += [("MagneticField", *times_ns, field), message]
    messages.append(("NavSatFix", *times_ns, {"latitude": 47.0, "longitude": 8.0}))
    path = json_mcap(tmp_path / "a.mcap", messages)
    events = list(open_log(path))
    samples = [event.sample for event in of(Imu, events)]
    assert [sample.gyr_rad_s for sample in samples] == [
        pytest.approx((0.1, 0.2, 0.01 * k)) for k in range(40)
    ]
    assert gaps_s(imu_times(events)) == [0.02] * 39
    assert samples[-1].acc_m_s2 == pytest.approx((0.0, 0.0, -9.8))
    assert samples[30].mag_gauss == pytest.approx((0.2, -0.03, 0.4), abs=2e-3)
    (place,) = of(Position, events)
    assert (place.latitude_deg, place.longitude_deg) == (47.0, 8.0)
    assert not of(ReferenceAttitude, events)
    assert not malformed(events)


@pytest.mark.parametrize(
    "damage",
    [
        {"header": {"stamp": {"sec": 10**19}}},
        {"header": 5},
        {"angular_velocity": [1, 2, 3]},
        {"linear_acceleration": {"x": 10**400, "y": 0, "z": 0}},
    ],
)
def test_a_message_that_cannot_be_is_counted_and_the_next_one_read(tmp_path, refused, damage):
    path = tmp_path / "a.mcap"

    def write(is_damaged):
        messages = (imu(k) for k in range(40))
        json_mcap(path, [(*m[:3], m[3] | damage if is_damaged(m[1]) else m[3]) for m in messages])

    write(lambda k: k == 7)
    events = list(open_log(path))
    assert (len(of(Imu, events)), malformed(events)) == (39, 1)
    write(lambda _: True)
    line = refused("replay", path)
    assert line == f"fuzzbee: {path}: no IMU data that can be used: 40 x malformed"


def test_a_damaged_bag_ends_or_is_one_line(bag, tmp_path, refused):
    """Cut short, and garbage in the middle; there may be some events, and no exception else."""
    file = next(each for each in bag.iterdir() if each.suffix != ".yaml") if bag.is_dir() else bag
    content = file.read_bytes()
    middle = len(content) // 2
    garbled = content[:middle] + bytes(range(256)) * 40 + content[middle + 10240 :]
    reported = []
    for name, damaged in (("cut", content[:middle]), ("garbled", garbled)):
        path = tmp_path / f"{name}{file.suffix}"
        path.write_bytes(damaged)
        try:
            events = list(open_log(path))
        except InputError as error:
            reported.append(str(error))
        else:
            assert malformed(events) <= 1
    assert all("cannot read this bag" in line and "\n" not in line for line in reported)
    path = tmp_path / "unnamed"
    path.write_bytes(content)
    line = refused("replay", path)
    assert "a bag: its name should end in .mcap, .db3, .bag" in line
