"""PARAM_VALUE of the autopilot, and of those who send its parameters."""

import struct

import pytest

from drivers.events import Parameter, VehicleId
from drivers.mavlink.constants import mavlink
from drivers.mavlink.decoder import MOST_WAITING, MavlinkDecoder
from estimator.profile import load_profile
from fuzzbee.replays.trace import Replay
from service.pipeline import Pipeline
from tests.drivers.mavlink.messages import ARDUPILOT, PX4, S, decode_all, heartbeat, raw_imu

NO_AUTOPILOT = 8
REAL, INT32 = 9, 6
m = mavlink()


def events_of(*sent):
    """The events of (system, component, message), each through real bytes."""
    decoder = MavlinkDecoder()
    return [
        event
        for system, component, message in sent
        for event in decode_all([message], decoder, system=system, component=component)
    ]


def parameter(name=b"AHRS_TRIM_X", value=0.05, kind=REAL):
    return m.MAVLink_param_value_message(name, value, kind, 1, 0)


ONE, TWO = VehicleId(1, 1), VehicleId(1, 2)


@pytest.mark.parametrize(
    ("sent", "expected"),
    [
        ([(1, 1, parameter())], [ONE]),
        ([(1, 1, heartbeat()), (1, 190, parameter())], [ONE]),  # MAVProxy's
        ([(1, 190, parameter()), (1, 1, heartbeat())], [ONE]),  # before any autopilot was
        ([(1, 190, parameter()), (1, 190, heartbeat(NO_AUTOPILOT))], []),
        ([(1, 1, heartbeat()), (2, 190, parameter())], []),  # another system's
        ([(1, 1, heartbeat()), (0, 190, parameter())], []),
        ([(1, 2, raw_imu()), (1, 190, parameter())], [TWO]),  # an autopilot by what it sends
        ([(1, 2, heartbeat()), (1, 1, heartbeat()), (1, 190, parameter())], [ONE]),
        ([(1, 2, heartbeat()), (1, 1, heartbeat()), (1, 2, parameter())], [TWO]),
    ],
)
def test_whose_a_parameter_is(sent, expected):
    assert [e.vehicle for e in events_of(*sent) if isinstance(e, Parameter)] == expected


@pytest.mark.parametrize(("autopilot", "value"), [(PX4, 21.0), (ARDUPILOT, 2.942726775082116e-44)])
def test_an_integer_is_read_as_its_autopilot_writes_it(autopilot, value):
    bits = struct.unpack("<f", struct.pack("<i", 21))[0]
    sent = parameter(b"MAV_TYPE", bits, INT32)
    for order in (
        [(1, 1, heartbeat(autopilot)), (1, 190, sent)],
        [(1, 190, sent), (1, 1, heartbeat(autopilot))],
    ):
        (found,) = (e for e in events_of(*order) if isinstance(e, Parameter))
        assert found.value == value


def test_what_waits_is_bounded_and_the_latest_of_each_name():
    others = [(1 + k % 8, 190, parameter(b"P%d" % k)) for k in range(MOST_WAITING)]
    sent = [(1, 190, parameter(b"A", 1.0)), (1, 190, parameter(b"A", 2.0)), *others]
    found = events_of(*sent, *((system, 1, heartbeat()) for system in range(1, 9)))
    found = [event for event in found if isinstance(event, Parameter)]
    assert len(found) == MOST_WAITING
    assert [event.value for event in found if event.name == "A"] == [2.0]


def test_replay_and_service_take_them():
    """AHRS_TRIM for the comparison, COMPASS_OFS all zero for the heading's sigma."""
    offsets = [(1, 190, parameter(f"COMPASS_OFS_{axis}".encode(), 0.0)) for axis in "XYZ"]
    sent = [(1, 1, heartbeat()), (1, 1, raw_imu()), (1, 190, parameter()), *offsets]
    replay = Replay(load_profile("imu"))
    replay.run(events_of(*sent))
    assert replay.traces[ONE].vehicle.parameters.view.trim[1] == pytest.approx(0.025, abs=1e-4)
    assert set(replay.traces) == {ONE}
    pipeline = Pipeline(load_profile("imu"))
    for event in events_of(*sent):
        pipeline.handle(event)
    assert pipeline.vehicle(ONE).estimator.attitude(S).sigma_heading_rad > 0.7
