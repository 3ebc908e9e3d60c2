"""The messages that ROS 2 nodes receive, decoded by rosbags, which shares no code with ours."""

import struct

import msgspec
import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from drivers.events import VehicleId
from estimator.types import ImuSample
from service.records import Evicted, Published
from service.sinks import ros_messages
from service.sinks.ros import RosSink, imu_topic
from service.sinks.ros_messages import IMU_TYPE, TF_TYPE, imu_message
from service.zenoh_session import close_session
from tests.service import records
from tests.service.records import UNIX_US, record
from tests.service.sessions import tokens, wait_for
from tests.vocabulary import random_quaternion, scipy_rotation

TYPES = get_typestore(Stores.ROS2_JAZZY)
REST_FRD = (0.0, 0.0, -9.8)
# REP 103: ENU has east, north and up, FLU forward, left and up
ENU_FROM_NED = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
FRD_FROM_FLU = np.diag([1, -1, -1])


IMU, TF = "sensor_msgs/msg/Imu", "tf2_msgs/msg/TFMessage"
ARRAY = "diagnostic_msgs/msg/DiagnosticArray"


def decode(data, kind=IMU):
    return TYPES.deserialize_cdr(bytes(data), kind)


def orientation(message):
    q = message.orientation
    return Rotation.from_quat([q.x, q.y, q.z, q.w])


def xyz(vector):
    return (vector.x, vector.y, vector.z)


@pytest.mark.parametrize("store", [Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY, Stores.ROS2_KILTED])
@pytest.mark.parametrize(("kind", "prefix"), [(IMU, "IMU"), (TF, "TF"), (ARRAY, "DIAGNOSTICS")])
def test_the_type_is_the_one_of_ros(store, kind, prefix):
    package, _, name = kind.split("/")
    expected = f"{package}::msg::dds_::{name}_/{get_typestore(store).hash_rihs01(kind)}"
    assert getattr(ros_messages, f"{prefix}_TYPE") == expected


@pytest.mark.parametrize("frame", ["", "a", "base_link", "vehicle_1/base_link"])
def test_every_field_arrives(frame):
    message = decode(imu_message(record(), (1.0, 2.0, -9.0), frame))
    assert message.header.frame_id == frame
    assert message.header.stamp.sec == UNIX_US // 1_000_000
    assert message.header.stamp.nanosec == 123_456_000
    assert xyz(message.angular_velocity) == (0.1, -0.2, -0.3)
    assert xyz(message.linear_acceleration) == (1.0, -2.0, 9.0)
    # byte for byte what rosbags would have written
    again = imu_message(record(), (1.0, 2.0, -9.0), frame)
    assert bytes(TYPES.serialize_cdr(message, IMU)) == again
    without_sample = decode(imu_message(record(), None, frame))
    assert without_sample.linear_acceleration_covariance[0] == -1.0


def test_any_attitude_is_the_same_rotation_in_other_axes():
    rng = np.random.default_rng(1)
    for _ in range(50):
        q = random_quaternion(rng)
        made = msgspec.structs.replace(record(), q_ned_frd=q)
        expected = ENU_FROM_NED @ scipy_rotation(q).as_matrix() @ FRD_FROM_FLU
        got = orientation(decode(imu_message(made, None, "f"))).as_matrix()
        np.testing.assert_allclose(got, expected, atol=1e-12)


def test_the_covariance_holds_what_the_sigmas_promise():
    """Errors drawn from the covariance lie under the published bounds 68 % of the time."""
    made = record(sigma_deg=(2.0, 7.0))
    covariance = decode(imu_message(made, None, "f")).orientation_covariance.reshape(3, 3)
    draws = np.random.default_rng(2).multivariate_normal(np.zeros(3), covariance, 100_000)
    tilt = np.degrees(np.hypot(draws[:, 0], draws[:, 1]))
    heading = np.degrees(np.abs(draws[:, 2]))
    # one standard deviation of the share is 0.15 %; one sigma holds 68.3 %
    assert np.mean(tilt < 2.0) == pytest.approx(0.68, abs=0.01)
    assert np.mean(heading < 7.0) == pytest.approx(0.68, abs=0.01)


@pytest.mark.parametrize("child", ["a", "ab", "abc", "vehicle_1/base_link"])
def test_a_transform_is_the_attitude_of_the_imus_message(child):
    made = record(20, -30, 123)
    message = decode(ros_messages.tf_message(made, child), TF)
    (transform,) = message.transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", child)
    assert transform.header.stamp.sec == UNIX_US // 1_000_000
    assert transform.header.stamp.nanosec == 123_456_000
    assert transform.transform.rotation == decode(imu_message(made, None, child)).orientation
    assert xyz(transform.transform.translation) == (0.0, 0.0, 0.0)
    kept = TYPES.serialize_cdr(message, TF)
    assert bytes(kept) == ros_messages.tf_message(made, child)


def status(state="running", **changes):
    return records.status(state, rejected={"not_later": 3}, **changes)


@pytest.mark.parametrize(
    ("record", "level"),
    [
        (status("running"), 0),
        (status("aligning"), 1),
        (status("degraded"), 1),
        (status("lost"), 2),
        (status("waiting", imu_message=None), 3),
        (status("running", warnings=("a_word",)), 1),
        (status("running", overloaded=True), 1),
        (status("lost", warnings=("a_word",)), 2),
    ],
)
def test_a_status_is_a_diagnosis(record, level):
    data = ros_messages.diagnostics_message(record, UNIX_US, "vehicle_1")
    message = decode(data, ARRAY)
    (one,) = message.status
    assert message.header.stamp.nanosec == 123_456_000
    assert (one.level, one.name, one.hardware_id) == (level, "vehicle_1: attitude", "vehicle_1")
    assert one.message.split(", ") == [record.state, *record.warnings]
    values = {each.key: each.value for each in one.values}
    assert values["imu_rate_hz"] == "49.8"
    assert values["imu_message"] == (record.imu_message or "none")
    assert values["rejected.not_later"] == "3"
    assert bytes(TYPES.serialize_cdr(message, ARRAY)) == data


def received(client, key, sink, output, count=1):
    """Samples under a key once there are so many, of an output that comes again and again."""
    got = []
    client.declare_subscriber(key, got.append)
    wait_for(lambda: sink.handle([output]) or len(got) >= count)
    return got


def test_a_status_is_published_with_the_time_of_the_host(client, session):
    output = Published(VehicleId(7, 154), status(), time_unix_us=UNIX_US)
    got = received(client, "0/diagnostics/**", RosSink(session, "fuzzbee"), output)
    message = decode(got[0].payload.to_bytes(), ARRAY)
    assert message.header.stamp.sec == UNIX_US // 1_000_000
    assert message.status[0].hardware_id == "vehicle_7_154"


def test_topics_are_names_that_ros_allows():
    assert imu_topic("fleet/2nd-boat", VehicleId(7, 154)) == "/fleet/_2nd_boat/vehicle_7_154/imu"


def test_keys_attachments_and_tokens_are_rmw_zenohs(client, session):
    sink = RosSink(session, "fuzzbee", domain=3)
    sample = ImuSample(0, (0.0, 0.0, 0.0), REST_FRD, (0.0, 0.0, 0.0), has_mag=False)
    got = received(client, "3/**", sink, Published(VehicleId(1, 1), record(), sample), count=6)
    alive = tokens(client, "@ros2_lv/3/**")
    sink.close()
    wait_for(lambda: not tokens(client, "@ros2_lv/3/**"))
    key = f"fuzzbee/vehicle_1/imu/{IMU_TYPE}"
    assert {str(each.key_expr) for each in got} == {f"3/{key}", f"3/tf/{TF_TYPE}"}
    got = [each for each in got if "imu" in str(each.key_expr)]
    attachments = [struct.unpack("<qqB16s", each.attachment.to_bytes()) for each in got]
    first, *_, publisher_id = attachments[0]
    rest = (UNIX_US * 1000, 16, publisher_id)
    assert attachments == [(first + k, *rest) for k in range(len(got))]
    message = decode(got[0].payload.to_bytes())
    assert message.header.frame_id == "vehicle_1/base_link"
    assert xyz(message.linear_acceleration) == (0.0, 0.0, 9.8)

    node, tf, publisher = sorted(alive, key=len)
    start = f"@ros2_lv/3/{session.zid()}/0"
    assert node == f"{start}/0/NN/%/%/fuzzbee"
    assert tf == f"{start}/2/MP/%/%/fuzzbee/%tf/{TF_TYPE}/::,10:,:,:,,"
    mangled = "%fuzzbee%vehicle_1%imu/" + key.split("/imu/")[1]
    assert publisher == f"{start}/1/MP/%/%/fuzzbee/{mangled}/::,10:,:,:,,"


def test_closing_after_the_session_is_no_error(session):
    sink = RosSink(session, "fuzzbee")
    close_session(session)
    sink.close()


def test_the_topic_of_a_vehicle_that_is_forgotten_is_withdrawn(client, session):
    """Entities' numbers stay different."""
    sink = RosSink(session, "fuzzbee", domain=4)

    def topics():
        found = [token.split("/") for token in tokens(client, "@ros2_lv/4/**/MP/**")]
        assert len({words[4] for words in found}) == len(found)
        return {words[9] for words in found}

    for number in (1, 2):
        sink.handle([Published(VehicleId(number, 1), record())])
    wait_for(lambda: topics() == {"%fuzzbee%vehicle_1%imu", "%fuzzbee%vehicle_2%imu", "%tf"})
    sink.handle([Evicted(VehicleId(1, 1)), Published(VehicleId(3, 1), record())])
    wait_for(lambda: topics() == {"%fuzzbee%vehicle_3%imu", "%fuzzbee%vehicle_2%imu", "%tf"})
