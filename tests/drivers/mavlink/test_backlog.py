"""Whose turn it is, and what is left out when there is too much."""

from drivers.events import Shed, VehicleId
from drivers.mavlink.backlog import (
    ALONE_S,
    LONGEST_NEW_S,
    MOST_AT_ONCE,
    MOST_NEWCOMERS,
    PATIENCE_S,
    STALL_S,
    STOPPED_S,
    TOLD_EVERY_US,
    Arrived,
    Backlog,
)
from drivers.mavlink.constants import (
    ATTITUDE_ID,
    HEARTBEAT_ID,
    PARAM_VALUE_ID,
    RAW_IMU_ID,
)
from drivers.mavlink.framing import Frame

LONG_S = 1.1 * STALL_S


def arrived(system, number, message=RAW_IMU_ID, imu=0):
    payload = bytes(26) + bytes([imu])
    frame = Frame(message, system, 1, payload, 0, len(payload), False)
    return Arrived(number, frame)


def known(backlog, *systems):
    """Have the first samples of these systems taken."""
    for system in systems:
        backlog.add([arrived(system, 0)], 0.0)
        backlog.take()
    return backlog


def taken(backlog):
    return [(each.frame.system_id, each.arrival_us) for each in backlog.take()]


def test_what_does_not_wait_for_long_is_all_taken_in_order():
    backlog = known(Backlog(), 1, 2)
    backlog.add([arrived(1, 1), arrived(2, 1)], 1.0)
    backlog.add([arrived(1, 2), arrived(2, 2)], 1.0 + 0.9 * PATIENCE_S)
    assert taken(backlog) == [(1, 1), (2, 1), (1, 2), (2, 2)]
    assert backlog.take_shed(9) == []


def test_of_what_waits_for_too_long_the_newest_has_the_oldests_turn():
    backlog = known(Backlog(), 1, 2)
    backlog.add([arrived(1, 1), arrived(2, 1), arrived(1, 2), arrived(1, 3, ATTITUDE_ID)], 1.0)
    backlog.add([arrived(2, 4), arrived(1, 5)], 1.0 + LONG_S)
    assert taken(backlog) == [(1, 5), (2, 4), (1, 3)]
    one, two = VehicleId(1, 1), VehicleId(2, 1)
    assert backlog.take_shed(9) == [Shed(one, 9, "RAW_IMU", 2), Shed(two, 9, "RAW_IMU", 1)]
    assert backlog.take_shed(9) == []
    assert backlog.shed == 3


def test_a_stall_alone_costs_nothing_and_one_soon_after_another_does():
    backlog = known(Backlog(), 1)

    def stall(begin_s, duration_s):
        backlog.add([arrived(1, 1)], begin_s)
        backlog.add([arrived(1, 2)], begin_s + duration_s)
        return len(taken(backlog))

    assert stall(1.0, 0.9 * STALL_S) == 2
    assert stall(1.5, LONG_S) == 1
    assert stall(2.0, 1.1 * PATIENCE_S) == 1
    assert stall(2.1 + ALONE_S, 0.9 * STALL_S) == 2


def test_nobody_starves_while_there_is_too_much():
    systems = range(1, 201)
    backlog = known(Backlog(), *systems)
    count = dict.fromkeys(systems, 0)
    ages = []
    for k in range(200):  # each sends at 50 Hz, of all a third can be taken
        now_s = 1.0 + 0.02 * k
        backlog.add([arrived(system, k) for system in systems], now_s)
        for system, number in taken(backlog):
            count[system] += 1
            ages.append(k - number)
    assert min(count.values()) > 0.7 * max(count.values()) > 0  # measured 0.75
    assert sum(count.values()) == 200 * MOST_AT_ONCE
    assert max(ages[MOST_AT_ONCE * 12 :]) == 0  # all that is taken is the newest


def test_as_soon_as_nothing_waits_everything_counts_again():
    backlog = known(Backlog(), 1)
    backlog.add([arrived(1, 1), arrived(1, 2)], 1.0)
    backlog.add([arrived(1, 3)], 1.0 + LONG_S)
    assert taken(backlog) == [(1, 3)]
    backlog.add([arrived(1, 4), arrived(1, 5)], 1.3)
    assert taken(backlog) == [(1, 4), (1, 5)]


def test_what_newer_samples_have_overtaken_is_left_out():
    """The heartbeat and the parameter stay, and what others wait for."""
    backlog = known(Backlog(), 1, 2)
    said = (RAW_IMU_ID, ATTITUDE_ID, HEARTBEAT_ID, PARAM_VALUE_ID)
    backlog.add([arrived(system, 1, message) for message in said for system in (1, 2)], 1.0)
    assert not backlog.is_folded
    backlog.fold()
    assert backlog.is_folded
    backlog.overtake({1 << 8 | 1})
    left = [(each.frame.system_id, each.frame.message_id) for each in backlog.take()]
    assert left == [
        (2, RAW_IMU_ID),
        (2, ATTITUDE_ID),
        *((system, message) for message in said[2:] for system in (1, 2)),
    ]
    assert backlog.take_shed(9) == [Shed(VehicleId(1, 1), 9, "RAW_IMU", 1)]


def test_what_is_said_once_stays_and_of_heartbeats_the_newest():
    backlog = known(Backlog(), 1)
    once = [arrived(1, k, PARAM_VALUE_ID) for k in range(3)]
    beats = [arrived(1, k, HEARTBEAT_ID) for k in range(3)]
    backlog.add([*once, *beats], 1.0)
    backlog.fold()
    assert backlog.take() == [*once, beats[-1]]
    assert backlog.take_shed(9) == []


def test_two_imus_in_one_message_are_two_streams():
    backlog = known(Backlog(), 1)
    both = [arrived(1, k, imu=k % 2) for k in range(4)]
    backlog.add(both, 1.0)
    backlog.fold()
    assert backlog.take() == both[2:]
    names = {each.message: each.samples for each in backlog.take_shed(9)}
    assert names == {"RAW_IMU": 1, "RAW_IMU:1": 1}


def test_newcomers_begin_some_at_a_time_and_others_do_not_wait_for_them():
    backlog = known(Backlog(), 1)
    newcomers = range(2, 2 + 3 * MOST_NEWCOMERS)
    backlog.add([arrived(system, 1) for system in newcomers], 1.0)
    for number in range(3):
        backlog.add([arrived(1, number)], 1.0)
        begun = newcomers[number * MOST_NEWCOMERS :][:MOST_NEWCOMERS]
        assert taken(backlog) == [(1, number), *((system, 1) for system in begun)]
    assert len(backlog) == 0


def test_all_that_a_newcomer_says_waits_for_its_turn():
    backlog, own = Backlog(), [arrived(99, k, (RAW_IMU_ID, ATTITUDE_ID)[k % 2]) for k in range(60)]
    first = [arrived(system, 1) for system in range(1, 1 + MOST_NEWCOMERS)]
    backlog.add(first, 1.0)
    backlog.add(own[:30], 1.0)
    backlog.add(own[30:], 1.0 + 0.9 * LONGEST_NEW_S)
    assert backlog.take() == first
    assert backlog.take() == own
    assert backlog.take_shed(9) == []


def test_after_a_stop_the_newest_alone_counts():
    backlog = known(Backlog(), 1)
    backlog.note_look(1.0)
    backlog.add([arrived(1, k) for k in range(5)], 1.0 + 0.9 * STOPPED_S)
    backlog.note_look(1.0 + 0.9 * STOPPED_S)
    assert len(backlog) == 5
    backlog.add([arrived(1, 5)], 1.0 + 2.0 * STOPPED_S)
    backlog.note_look(1.0 + 2.0 * STOPPED_S)
    assert taken(backlog) == [(1, 5)]


def test_what_cannot_be_left_out_is_bounded():
    backlog = Backlog(most_waiting=10)
    backlog.add([arrived(1, k, PARAM_VALUE_ID) for k in range(25)], 1.0)
    assert [number for _, number in taken(backlog)] == list(range(15, 25))
    assert backlog.dropped == 15


def test_of_a_newcomer_whose_turn_does_not_come_the_newest_waits():
    """A first attitude is of a new sample, however many begin before."""
    backlog = Backlog()
    once = arrived(99, 0, PARAM_VALUE_ID)
    samples = [arrived(99, k) for k in range(1, 8)]
    backlog.add([arrived(system, 1) for system in range(1, 1 + MOST_NEWCOMERS)], 1.0)
    backlog.add([samples[0], once, *samples[1:3]], 1.0)
    backlog.add(samples[3:4], 1.0 + 0.9 * LONGEST_NEW_S)
    assert len(backlog) == MOST_NEWCOMERS + 5
    backlog.add(samples[4:5], 1.0 + 1.1 * LONGEST_NEW_S)
    assert len(backlog) == MOST_NEWCOMERS + 2
    backlog.add(samples[5:6], 1.0 + 2.0 * LONGEST_NEW_S)  # not at each look
    assert len(backlog) == MOST_NEWCOMERS + 3
    backlog.add(samples[6:], 1.0 + 2.2 * LONGEST_NEW_S)
    backlog.take()
    assert backlog.take() == [once, samples[-1]]
    assert backlog.take_shed(9) == [Shed(VehicleId(99, 1), 9, "RAW_IMU", 6)]


def test_what_was_left_out_is_told_now_and_then():
    backlog = known(Backlog(), 1)
    for k, told in enumerate((True, False, True, False)):
        now_us = k * (1 + TOLD_EVERY_US // 2)
        backlog.add([arrived(1, 0), arrived(1, 1)], 1.0)
        backlog.fold()
        assert bool(backlog.take_shed(now_us)) == told
        backlog.take()
    assert [each.samples for each in backlog.take_shed(now_us - 1)] == []
    assert [each.samples for each in backlog.take_shed(4 * TOLD_EVERY_US)] == [1]
    assert backlog.shed == 4
