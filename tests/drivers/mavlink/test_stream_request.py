"""Requests for a rate, and heartbeats: what a link sends, given events and times."""

import itertools

import pytest

from drivers.endpoint import parse_endpoint
from drivers.events import ClockReset, CommandAck, Forgotten, Heartbeat, Imu, VehicleId
from drivers.mavlink.constants import mavlink
from drivers.mavlink.gate import Policy
from drivers.mavlink.outgoing import MOST_REPEATS, MOST_REQUESTS, MOST_STREAMS, Outbound
from estimator.errors import InputError
from estimator.types import ZERO_VEC3, ImuSample

VEHICLE = VehicleId(3, 1)
SECOND = 1_000_000


def outbound(asked_hz, url="udpin"):
    return Outbound(parse_endpoint(f"{url}:127.0.0.1:14550"), asked_hz, Policy())


def sent(outbound, now_us):
    return mavlink().MAVLink(None).parse_buffer(b"".join(outbound.take_frames(now_us))) or []


class Conversation:
    """Drives a request at 10 ms steps; the vehicle streams at ``rate_hz``, if it does."""

    def __init__(self, autopilot=3, *, accepts=False):
        self.outbound = outbound(50.0)
        self.now_us = 0
        self.boot_us = 0.0
        self.rate_hz = 4.0
        self.message = "RAW_IMU"
        self.commands = []
        self.notices = []
        self.on_command = self.accept if accepts else lambda _: None
        self.met = Heartbeat(VEHICLE, 0, autopilot, 2)

    def run(self, seconds):
        self.event(self.met)
        for _ in range(round(seconds * 100)):
            self.now_us += 10_000
            while self.rate_hz and self.boot_us <= self.now_us:
                sample = ImuSample(int(self.boot_us), *[ZERO_VEC3] * 3, False)
                self.event(Imu(VEHICLE, self.now_us, sample.time_us, self.message, sample))
                self.boot_us += SECOND / self.rate_hz
            self.event()
        return self

    def ack(self, result):
        self.event(CommandAck(VEHICLE, self.now_us, 511, result))

    def accept(self, command):
        self.rate_hz = SECOND / command.param2
        self.ack(0)

    def event(self, *events):
        self.notices += [each.text for each in self.outbound.react(events, self.now_us)]
        for message in sent(self.outbound, self.now_us):
            assert (message.get_srcSystem(), message.get_srcComponent()) == (3, 191)
            if message.get_type() == "COMMAND_LONG":
                self.commands.append((self.now_us, message))
                self.on_command(message)

    @property
    def command_times_s(self):
        return [round(t / SECOND, 1) for t, _ in self.commands]


@pytest.mark.parametrize(
    ("autopilot", "message", "number"), [(3, "RAW_IMU", 27), (12, "HIGHRES_IMU", 105)]
)
def test_asks_by_message_interval_and_stays_content(autopilot, message, number):
    dialogue = Conversation(autopilot, accepts=True)
    dialogue.message = message
    dialogue.run(60)
    ((at, command),) = dialogue.commands
    assert at == 0
    assert command.command == 511
    assert (command.target_system, command.target_component) == VEHICLE
    assert (command.param1, command.param2, command.confirmation) == (number, 20_000, 0)
    assert dialogue.notices == []


@pytest.mark.parametrize(("url", "asked_hz"), [("udpin", 50.0), ("udpout", 50.0), ("udpout", None)])
def test_heartbeats_are_an_onboard_controller_s_at_1_hz(url, asked_hz):
    """In the vehicle's system, once one is known; where the link must send first, in any case."""
    link, beats = outbound(asked_hz, url), []
    assert len(sent(link, 0)) == (url == "udpout")
    link.react([Heartbeat(VEHICLE, 0, 3, 2)], 0)
    for k in range(1, 1001):
        beats += [each for each in sent(link, 10_000 * k) if each.get_type() == "HEARTBEAT"]
    assert len(beats) == 10
    for message in beats:
        assert (message.type, message.autopilot) == (18, 8)
        system_id = 1 if asked_hz is None else 3
        assert (message.get_srcSystem(), message.get_srcComponent()) == (system_id, 191)


def test_nothing_is_sent_before_a_vehicle_is_known_nor_after_it_is_forgotten():
    link, ground_station = outbound(50.0), Heartbeat(VehicleId(255, 190), 0, 8, 6)
    for events in ([], [ground_station], [Heartbeat(VEHICLE, 0, 3, 2), Forgotten(VEHICLE, 0)]):
        assert link.react(events, 10 * SECOND) == []
        assert sent(link, 10 * SECOND) == []


def test_without_an_answer_the_request_is_repeated_then_paused_and_given_up_in_the_end():
    dialogue = Conversation().run(1000)
    confirmations = [message.confirmation for _, message in dialogue.commands]
    assert confirmations == [*range(MOST_REPEATS + 1)] * MOST_REQUESTS
    # 1.5 s for each answer, then 5 s of pause, and again from the start
    assert dialogue.command_times_s[:5] == [0, 1.5, 3.0, 4.5, 11.0]
    assert dialogue.command_times_s[-1] < 300
    first, last = dialogue.notices
    assert "does not answer: asking again" in first
    assert "not asking again" in last


def test_an_accepted_rate_that_does_not_come_is_asked_for_again():
    dialogue = Conversation()
    dialogue.on_command = lambda _: dialogue.ack(0)  # accepts and goes on at 4 Hz
    dialogue.run(400)
    assert len(dialogue.commands) == MOST_REQUESTS
    assert "sends RAW_IMU at 4.0 Hz" in dialogue.notices[0]
    gaps = [b - a for a, b in itertools.pairwise(dialogue.command_times_s)]
    assert all(later > 1.3 * earlier for earlier, later in itertools.pairwise(gaps))


def test_a_ground_station_s_reset_is_noticed_and_undone():
    dialogue = Conversation(accepts=True).run(20)
    dialogue.rate_hz = 2.0
    dialogue.run(20)
    assert len(dialogue.commands) == 2
    assert dialogue.rate_hz == 50
    for _ in range(MOST_REQUESTS + 2):  # success in between: it goes on asking
        dialogue.rate_hz = 2.0
        dialogue.run(20)
    assert len(dialogue.commands) == 2 + MOST_REQUESTS + 2
    assert len(dialogue.notices) == 1


@pytest.mark.parametrize(
    ("result", "rate_hz", "seconds", "problem"),
    [
        (0, 0.0, 9, "sends no RAW_IMU"),
        *((result, 4.0, 300, f"MAV_RESULT {result}") for result in (2, 3, 4)),
    ],
)
def test_no_sample_is_a_failure_and_a_refusal_is_final(result, rate_hz, seconds, problem):
    dialogue = Conversation()
    dialogue.rate_hz = rate_hz
    dialogue.on_command = lambda _: dialogue.ack(result)
    dialogue.run(seconds)
    assert len(dialogue.commands) == 1
    assert problem in dialogue.notices[0]


def test_temporary_rejection_is_not():
    dialogue = Conversation()
    answers = iter([1, 1, 0])

    def answer(command):
        result = next(answers)
        dialogue.rate_hz = 50 if result == 0 else 4
        dialogue.ack(result)

    dialogue.on_command = answer
    dialogue.run(100)
    assert dialogue.command_times_s == [0, 5, 15]


def test_a_reboot_is_asked_at_once():
    dialogue = Conversation(accepts=True).run(10)
    dialogue.rate_hz = 4.0
    dialogue.event(ClockReset(VEHICLE, dialogue.now_us, "reboot", -10.0))
    assert len(dialogue.commands) == 2
    dialogue.event(ClockReset(VEHICLE, dialogue.now_us, "jump", 10.0))
    assert len(dialogue.commands) == 2


@pytest.mark.parametrize("rate", [0, -1, float("nan"), float("inf"), 1e6])
def test_impossible_rates_are_refused(rate):
    with pytest.raises(InputError, match="rate"):
        outbound(rate)


def test_a_flood_of_heartbeats_is_not_answered_without_end():
    link, asked = outbound(50.0), set()
    for system in range(1, 256):
        for component in range(1, 5):
            link.react([Heartbeat(VehicleId(system, component), 0, 3, 2)], 0)
            asked |= {
                (message.target_system, message.target_component)
                for message in sent(link, 0)
                if message.get_type() == "COMMAND_LONG"
            }
    assert len(asked) == MOST_STREAMS


def test_what_failed_before_a_reboot_does_not_count_behind_it():
    dialogue = Conversation().run(120)
    dialogue.event(ClockReset(VEHICLE, dialogue.now_us, "reboot", -100.0))
    dialogue.run(30)
    assert not [notice for notice in dialogue.notices if "not asking again" in notice]
