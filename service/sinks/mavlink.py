"""Back to MAVLink: attitude, covariance and STATUSTEXT from an onboard computer of the vehicle.

The sender is the vehicle's system with component 191 (MAV_COMP_ID_ONBOARD_COMPUTER),
never the autopilot: a ground station must not mix the two, and no vehicle should fly by our
attitude without being asked to. A heartbeat each second shows what we are.
"""

import time
from collections.abc import Callable, Sequence

from drivers.endpoint import Endpoint
from drivers.events import VehicleId
from drivers.mavlink import constants as mav
from drivers.mavlink import encoder
from drivers.mavlink.connection import Connection
from drivers.mavlink.recorder import Recorder
from estimator.geometry.frames import euler_rad
from service import records
from service.records import AttitudeRecord, Output, Published, StatusRecord
from service.second_opinion import Verdict

ATTITUDE_US = 20_000  # between two of a vehicle: 2.6 kB/s, which a 57600 baud radio can take
COVARIANCE_US = 200_000  # between two ATTITUDE_QUATERNION_COV: sigma changes slowly
HEARTBEAT_US = 1_000_000
ANNOUNCED_US = 10_000_000


class MavlinkSink:
    """Sends over a link of its own, and opens it again when it broke.

    Each vehicle's attitudes, if ``attitudes``; and a text every ten seconds for as long as the
    autopilot's differs from ours, if ``announces``.

    With ``appears_as`` the attitudes of the first vehicle are those of a vehicle of that address,
    generic and in standby: what ground stations show. It answers nothing.

    Of several components of one system only the one seen first is sent: they
    would share one address.

    Raises:
        InputError: the endpoint is no link, its port is taken, its device missing
            or its host unknown.
    """

    name = "mavlink"

    def __init__(
        self,
        endpoint: Endpoint,
        *,
        attitudes: bool = True,
        announces: bool = False,
        appears_as: VehicleId | None = None,
    ) -> None:
        self._attitudes = attitudes
        self._announces = announces
        self._appears_as = appears_as
        self._shown: VehicleId | None = None  # the vehicle that appears so
        self._senders: dict[int, Sender] = {}
        self._failures: list[str] = []  # not reported yet
        self._connection = Connection(endpoint, report=self._failures.append)
        self._connection.open()

    def handle(self, outputs: Sequence[Output]) -> None:
        """Send what is due of the outputs.

        Raises:
            ConnectionError: the link broke, or could not be opened: at once, then once a minute.
        """
        frames = [frame for output in outputs for frame in self._frames(output)]
        self._connection.receive(0.0)  # learns whom to send to; what they send is not used
        for frame in frames:
            self._connection.send(frame)
        self._connection.take_events()
        failures, self._failures[:] = [*self._failures], []
        if failures:
            raise ConnectionError(failures[-1])

    def close(self) -> None:
        """Release the link."""
        self._connection.close()

    def _frames(self, output: Output) -> list[bytes]:
        if isinstance(output, records.Evicted):
            sender = self._senders.get(output.vehicle.system_id)
            if sender is not None and sender.vehicle == output.vehicle:
                del self._senders[output.vehicle.system_id]  # another component may be sent
        if not isinstance(output, Published):
            return []
        if self._appears_as is not None and isinstance(output.record, AttitudeRecord):
            return self._frames_as(self._appears_as, output.vehicle, output.record)
        system, component = output.vehicle
        sender = self._senders.setdefault(system, Sender(output.vehicle))
        if sender.vehicle != output.vehicle or component == mav.MAV_COMP_ID_ONBOARD_COMPUTER:
            return []
        if isinstance(output.record, AttitudeRecord):
            return sender.frames(output.record) if self._attitudes else []
        return sender.announcement(output.record, output.time_unix_us) if self._announces else []

    def _frames_as(
        self, other: VehicleId, vehicle: VehicleId, record: AttitudeRecord
    ) -> list[bytes]:
        """Of the vehicle that appears as another one; never under an address that there is."""
        if vehicle.system_id == other.system_id:
            name = records.vehicle_name(vehicle)
            raise ConnectionError(f"vehicle {name} is there already, not shown as another")
        self._shown = self._shown or vehicle
        if vehicle != self._shown:
            return []
        sender = self._senders.setdefault(other.system_id, Sender(other, is_vehicle=True))
        return sender.frames(record)


class Sender:
    """The frames of one vehicle, paced by the records' own times."""

    def __init__(self, vehicle: VehicleId, *, is_vehicle: bool = False) -> None:
        self.vehicle = vehicle
        self._is_vehicle = is_vehicle  # itself, rather than an onboard computer of it
        component = vehicle.component_id if is_vehicle else mav.MAV_COMP_ID_ONBOARD_COMPUTER
        self._encoder = encoder.FrameEncoder(VehicleId(vehicle.system_id, component))
        self._due_us: dict[str, int] = {}  # by what is sent
        self._announcements = 0

    def announcement(self, status: StatusRecord, now_us: int) -> list[bytes]:
        """What is due to be announced of the autopilot's attitude."""
        messages, opinion = self._heartbeats(now_us), status.autopilot
        differs = opinion is not None and opinion.verdict == Verdict.DIFFERS
        if opinion and differs and self._is_due("announcement", now_us, ANNOUNCED_US):
            self._announcements += 1
            number = 1 + self._announcements % 0xFFFF
            messages += encoder.statustexts(announced(opinion), mav.MAV_SEVERITY_WARNING, number)
        return [self._encoder.frame(message, now_us) for message in messages]

    def frames(self, record: AttitudeRecord) -> list[bytes]:
        """The messages that are due at the record's time."""
        now_us = record.time_unix_us
        messages = self._heartbeats(now_us)
        if self._is_due("attitude", now_us, ATTITUDE_US):
            time_us, q, rate_rad_s = record.time_boot_us, record.q_ned_frd, record.rate_rad_s
            if self._is_vehicle:
                messages.append(encoder.attitude(time_us, euler_rad(q), rate_rad_s))
            else:
                messages.append(encoder.attitude_quaternion(time_us, q, rate_rad_s))
                if self._is_due("covariance", now_us, COVARIANCE_US):
                    level, yaw = record.variances_rad2
                    about = (time_us, q, rate_rad_s, (level, level, yaw))
                    messages.append(encoder.attitude_quaternion_cov(*about))
        return [self._encoder.frame(message, now_us) for message in messages]

    def _heartbeats(self, now_us: int) -> list[encoder.Message]:
        kind: tuple[int, ...] = (mav.MAV_TYPE_ONBOARD_CONTROLLER, mav.MAV_AUTOPILOT_INVALID)
        if self._is_vehicle:
            kind = mav.MAV_TYPE_GENERIC, mav.MAV_AUTOPILOT_GENERIC, mav.MAV_STATE_STANDBY
        is_due = self._is_due("heartbeat", now_us, HEARTBEAT_US)
        return [encoder.heartbeat(*kind)] if is_due else []

    def _is_due(self, what: str, now_us: int, period_us: int) -> bool:
        """Whether it is time, also when the clock was set back by more than a period.

        The next one is due a period after this one was, so that ticks that jitter slow nothing.
        """
        due_us = self._due_us.get(what, 0)
        late_us = now_us - due_us
        if -period_us <= late_us < 0:
            return False
        self._due_us[what] = (due_us if 0 <= late_us < period_us else now_us) + period_us
        return True


def announced(opinion: records.Autopilot) -> str:
    """A text whose first 50 letters, which any ground station shows, matter most."""
    what = opinion.in_short.replace("°", " deg")
    who = {"autopilot": "the autopilot's", "ours": "ours"}.get(opinion.wrong)
    named = f"likely wrong: {who}" if who else "which is wrong is not known"
    return f"{what} ours (+-{opinion.sigma_deg:.0f} deg); {named}"


class RecordingSink:
    """Writes changes that the service made by itself to ``recorder``, beside what arrived.

    A STATUSTEXT of component 191, so that a replay of the recording shows when it was retuned.
    """

    name = "recording"

    def __init__(
        self, recorder: Recorder, unix_us: Callable[[], int] = lambda: time.time_ns() // 1000
    ) -> None:
        self._recorder = recorder
        self._unix_us = unix_us
        self._encoders: dict[int, encoder.FrameEncoder] = {}

    def handle(self, outputs: Sequence[Output]) -> None:
        """Keep the changes among the outputs."""
        for output in outputs:
            if not isinstance(output, records.Replaced) or output.retuned is None:
                continue
            system_id, now_us = output.vehicle.system_id, self._unix_us()
            sender = VehicleId(system_id, mav.MAV_COMP_ID_ONBOARD_COMPUTER)
            own = self._encoders.setdefault(system_id, encoder.FrameEncoder(sender))
            text = f"retuned: {output.retuned}"[: encoder.STATUSTEXT_SIZE]
            messages = encoder.statustexts(text, mav.MAV_SEVERITY_INFO, 0)
            self._recorder.write(now_us, [own.frame(each, now_us) for each in messages])

    def close(self) -> None:
        """Do nothing: the recorder is closed by its owner."""
