"""Signed frames on receipt: what is let in, and what a restart remembers."""

import json
from itertools import pairwise

import pytest

from drivers.events import Notice, RefusedFrames, VehicleId
from drivers.mavlink import signing
from drivers.mavlink.encoder import FrameEncoder, heartbeat
from drivers.mavlink.framing import FrameReader
from drivers.mavlink.gate import FrameGate, Policy
from drivers.mavlink.signing import AHEAD_TICKS, SigningCheck, state_path
from estimator.errors import InputError
from tests.drivers.mavlink.messages import VEHICLE, S, only

NOW = 1_700_000_000 * S
KEY, OTHER_KEY = bytes(range(32)), bytes(32)
TOO_OLD = "signature_too_old"


def signed(now_us=NOW, key=KEY, vehicle=VEHICLE, link=0):
    (frame,) = FrameReader().feed(FrameEncoder(vehicle, key, link).frame(heartbeat(2, 3), now_us))
    return frame


def judge(check, frame, unix_us):
    """As a frame that arrives alone, and is used afterwards."""
    reason = check.refusal(frame, unix_us)
    check.keep_ahead(unix_us)
    return reason


@pytest.fixture
def file(tmp_path):
    return tmp_path / "state" / "signing.json"


@pytest.fixture
def writes(file, monkeypatch):
    writes, replace = [], type(file).replace
    monkeypatch.setattr(type(file), "replace", lambda *a: (writes.append(1), replace(*a)))
    return writes


TWO, YEAR, OFF = VehicleId(2, 1), 365 * 86_400 * S, 3 * 86_400 * S
# what comes in a row: when it was signed and by whom, when it arrives, and why it is refused
CASES = {
    "a good one is let in once": [
        (NOW, {}, NOW, None),
        (NOW, {}, NOW, "replayed"),
        (NOW - 10, {}, NOW, "replayed"),
        (NOW + 10, {}, NOW, None),
    ],
    "unsigned or with another key": [
        (NOW, {"key": None}, NOW, "unsigned"),
        (NOW, {"key": OTHER_KEY}, NOW, "wrong_signature"),
    ],
    "a forged time locks the vehicle not out": [
        (NOW + 3600 * S, {"key": OTHER_KEY}, NOW, "wrong_signature"),
        (NOW, {}, NOW, None),
    ],
    "streams of one vehicle have times of their own": [
        (NOW + S, {"link": 0}, NOW, None),
        (NOW, {"link": 1}, NOW, None),
    ],
    "more than a minute old": [(NOW - 61 * S, {}, NOW, TOO_OLD), (NOW - 59 * S, {}, NOW, None)],
    "years ahead, which locks nobody out": [
        (NOW + YEAR + S, {}, NOW, "signature_too_new"),
        (NOW + 10**9 * S, {}, NOW, "signature_too_new"),
        (NOW + 59 * S, {}, NOW, None),
        (NOW, {"vehicle": TWO}, NOW, None),
    ],
    "what did not arrive is too old after a minute": [
        (NOW, {}, NOW, None),
        *((NOW + second * S, {}, NOW + 300 * S, TOO_OLD) for second in range(1, 100)),
        (NOW + 300 * S, {}, NOW + 300 * S, None),
    ],
    # three days behind, and then set right by the network
    "a host whose clock stood still while it was off": [
        (NOW, {}, NOW - OFF, None),
        (NOW, {}, NOW - OFF + S, "replayed"),
        (NOW + 20 * S, {}, NOW + 20 * S, None),
    ],
}


@pytest.mark.parametrize("frames", CASES.values(), ids=CASES)
def test_what_is_let_in(file, frames):
    check = SigningCheck(KEY, file)
    for signed_us, by, now_us, reason in frames:
        assert judge(check, signed(signed_us, **by), now_us) == reason


@pytest.mark.parametrize("byte", [4, 6, 12, -13, -12, -1])
def test_a_changed_byte_is_a_wrong_signature(file, byte):
    frame = signed()
    data = bytearray(frame.data)
    data[byte] ^= 1
    frame = frame._replace(data=bytes(data))
    assert judge(SigningCheck(KEY, file), frame, NOW) == "wrong_signature"


@pytest.mark.parametrize("crash_s", [None, 4, 600])
def test_a_sender_that_counts_frames_instead_of_time_goes_on(file, crash_s):
    """As pymavlink does: its stamps fall behind, second by second, but never back."""
    check, refused_s = SigningCheck(KEY, file), []
    for second in range(1200):
        if second == crash_s:
            check = SigningCheck(KEY, file)
        if judge(check, signed(NOW + 10 * second), NOW + second * S) is not None:
            refused_s.append(second)
    # the file is ahead by as many frames as came in two seconds
    assert refused_s in ([], *([*range(crash_s or 0, (crash_s or 0) + n)] for n in (1, 2, 3)))


@pytest.mark.parametrize(
    ("lag_s", "reason"), [(205, None), (215, TOO_OLD), (95, None), (85, TOO_OLD)]
)
def test_a_late_stream_may_leap_neither_way_by_more_than_a_minute(file, lag_s, reason):
    check, now_us = SigningCheck(KEY, file), NOW
    for late_s in (0, 50, 100, 150):
        now_us += 100 * S
        assert judge(check, signed(now_us - late_s * S), now_us) is None
    now_us += 100 * S
    assert judge(check, signed(now_us - lag_s * S), now_us) == reason


def test_our_stamps_grow_also_over_a_restart_with_the_clock_set_back(file):
    check = SigningCheck(KEY, file)
    stamps = [check.stamp(us) for us in (NOW, NOW, NOW + 3 * S, NOW)]
    check.close()
    check = SigningCheck(KEY, file)
    stamps += [check.stamp(NOW - 3600 * S), check.stamp(NOW - 3600 * S)]
    check = SigningCheck(KEY, file)  # the second one was killed
    stamps += [check.stamp(NOW - 7200 * S), check.stamp(0)]
    assert all(a < b for a, b in pairwise(stamps))
    assert stamps[-1] < stamps[0] + 10 * AHEAD_TICKS


def test_two_processes_keep_their_streams_in_one_file(file):
    """Each knows the other's from its start only, and must not write that back."""
    judge(SigningCheck(KEY, file), signed(vehicle=TWO), NOW)
    here, there = SigningCheck(KEY, file), SigningCheck(KEY, file)
    for now in range(NOW + 3 * S, NOW + 20 * S, S):
        assert judge(here, signed(now), now) is None
        assert judge(there, signed(now, vehicle=TWO), now) is None
    there.close()
    here.close()
    again = SigningCheck(KEY, file)
    assert judge(again, signed(now), now) == "replayed"
    assert judge(again, signed(now, vehicle=TWO), now) == "replayed"
    assert judge(again, signed(now + 10), now) is None  # after a regular end


def test_a_crash_forgets_nothing_costs_two_seconds_and_the_file_is_written_rarely(file, writes):
    check, times = SigningCheck(KEY, file), range(NOW, NOW + 10 * S, S // 100)
    writes.clear()
    for now in times:
        assert judge(check, signed(now), now) is None
    assert len(writes) <= 13  # one a second, before it has to be
    text = file.read_text()
    assert KEY.hex() not in text
    assert set(json.loads(text)) == {"1-1-0", "ours", "floor"}
    again = SigningCheck(KEY, file)  # the first one was never closed
    for now in times:
        assert judge(again, signed(now), now) == "replayed"
    late = times[-1] + AHEAD_TICKS * 10 + 10
    assert judge(again, signed(late), late) is None


def test_two_crashes_forget_nothing_of_a_vehicle_known_before(file):
    """Under the floor for newcomers, which does not hold for whom the file names."""
    before, soon = SigningCheck(KEY, file), NOW + S
    assert judge(before, signed(), NOW) is None
    before.close()
    judge(SigningCheck(KEY, file), signed(soon, vehicle=TWO), soon)
    assert judge(SigningCheck(KEY, file), signed(NOW + S // 2), soon) is None
    assert judge(SigningCheck(KEY, file), signed(NOW + S // 2), soon) == "replayed"


def test_many_streams_that_begin_one_after_another_write_rarely(file, writes):
    """Each write is fsync'd: one at every frame would leave no time for anything else."""
    check = SigningCheck(KEY, file)
    writes.clear()
    frames = 0
    for k in range(200):  # a fleet at 50 Hz, all at once, and every 0.1 s one more
        for number in range(5, min(5 + k // 5, 45)):
            now = NOW + k * S // 50 + 100 * (number * 7 % 45)
            for frame in (0, 1, 2):  # of one datagram
                frames += 1
                one = signed(now + 10 * frame, vehicle=VehicleId(1 + number, 1))
                assert judge(check, one, now) is None
    check.close()
    assert frames == 11_700
    assert len(writes) < 20  # measured 16; it was 3,936


def test_newcomers_share_one_write_and_a_crash_forgets_none(file, writes):
    """A hundred vehicles a second begin: as one floor ahead of the clock they are in the file."""
    check, accepted = SigningCheck(KEY, file), []
    for number in range(400):
        now = NOW + number * S // 100
        vehicle = VehicleId(1 + number % 200, 1 + number // 200)
        for at in (now, now + S // 100, now + S // 50):
            frame = signed(at, vehicle=vehicle)
            assert judge(check, frame, at) is None
            accepted.append(frame)
    assert 2 <= len(writes) < 7  # measured 4 to 5; it was 400
    again = SigningCheck(KEY, file)  # the first one was never closed
    assert {judge(again, frame, now) for frame in accepted} == {"replayed"}
    late = now + AHEAD_TICKS * 10 + 10
    assert judge(again, signed(late, vehicle=VehicleId(250, 1)), late) is None


DAMAGED = (
    *(b"{", b"[1]", b'{"1-1": [3, 0]}', b'{"1-1-\xff": [3, 0]}', b'{"1-1-0": [3, 0, 0]}'),
    *(b'{"1-1-0": null}', b'{"1-1-0": 3}', b'{"1-1-0": [NaN, 0]}'),
    *(b'{"ours": []}', b'{"ours": 1e300}', b'{"ours": -1}'),
)


@pytest.mark.parametrize("content", DAMAGED)
def test_a_damaged_state_is_refused_at_the_start(file, content):
    file.parent.mkdir()
    file.write_bytes(content)
    with pytest.raises(InputError, match="damaged"):
        SigningCheck(KEY, file)


def test_a_state_that_cannot_be_kept_is_refused_at_the_start(file):
    file.parent.write_text("a file where the folder should be")
    with pytest.raises(InputError, match=r"signing\.json"):
        SigningCheck(KEY, file)


def test_the_state_is_in_the_folder_of_xdg_or_at_home(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert state_path() == tmp_path / "fuzzbee" / "signing.json"
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert state_path() == tmp_path / ".local" / "state" / "fuzzbee" / "signing.json"

    def homeless():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr("drivers.mavlink.signing.Path.home", homeless)
    with pytest.raises(InputError, match="XDG_STATE_HOME"):
        state_path()


# --- the gate


def refused(gate):
    return [(e.vehicle, e.reason, e.frames) for e in only(RefusedFrames, gate.take_refused(NOW))]


def test_only_allowed_systems_are_let_in():
    gate = FrameGate(Policy(frozenset({1})))
    assert gate.lets_in(signed(), "a", NOW)
    for _ in range(3):
        assert not gate.lets_in(signed(vehicle=TWO), "a", NOW)
    assert refused(gate) == [(TWO, "system_not_allowed", 3)]
    assert refused(gate) == []


def test_a_refused_signature_is_reported_once(file):
    gate = FrameGate(Policy(None, SigningCheck(KEY, file)))
    texts = []
    for _ in range(3):
        assert not gate.lets_in(signed(key=None), "a", NOW)
        texts += [event.text for event in only(Notice, gate.take_refused(NOW))]
    assert texts == ["system 1: frames without a signature are refused"]


def test_of_two_senders_with_one_address_the_first_is_used_until_it_falls_silent():
    gate = FrameGate(Policy())
    for peer, at_ms, is_let_in in (
        *(("a", 0, True), ("b", 100, False), ("a", 200, True)),
        *(("b", 1199, False), ("b", 1200, True), ("a", 1201, False)),
        ("a", -500, True),  # the clock was set back: nobody waits until it is that time again
    ):
        assert gate.lets_in(signed(), peer, NOW + at_ms * 1000) == is_let_in
    assert refused(gate) == [(VEHICLE, "address_conflict", 3)]


def test_a_sender_that_has_left_frees_its_addresses_at_once():
    gate = FrameGate(Policy())
    assert gate.lets_in(signed(), "a", NOW)
    gate.forget("a")
    assert gate.lets_in(signed(), "b", NOW + 1)
    gate.forget()
    assert gate.lets_in(signed(), "c", NOW + 2)


def test_many_streams_are_kept_as_one_floor_and_none_can_be_replayed(file, monkeypatch):
    """Not even by a host whose clock was set back by a day, before or after a restart."""
    monkeypatch.setattr(signing, "MOST_STREAMS", 40)
    check, accepted, now_us = SigningCheck(KEY, file), [], NOW
    slow = VehicleId(200, 1)  # it counts a third of the time
    for number in range(200):
        now_us += S
        frame = signed(now_us, vehicle=VehicleId(1 + number, 7))
        assert judge(check, frame, now_us) is None
        accepted.append(frame)
        assert judge(check, signed(NOW + number * S // 3, vehicle=slow), now_us) is None
    assert len(check._last) < 140  # the last minute's, and as many again
    assert json.loads(file.read_text())["floor"] > 0
    day_before_us = now_us - 86_400 * S
    for _ in range(2):
        for at_us in (now_us, day_before_us):
            found = {judge(check, frame, at_us) for frame in accepted}
            assert found <= {"replayed", "signature_too_old"}, at_us
        check.close()
        check = SigningCheck(KEY, file)
    later_us = now_us + 3 * S  # a newcomer waits until the floor is past
    assert judge(check, signed(now_us + S, vehicle=VEHICLE), later_us) == "replayed"
    assert judge(check, signed(later_us, vehicle=VEHICLE), later_us) is None
    assert judge(check, signed(NOW + 67 * S, vehicle=slow), later_us) is None


def test_a_floor_of_before_a_crash_never_falls(file, monkeypatch):
    """A stream of before it, older than the floor, is merged into that after the restart."""
    monkeypatch.setattr(signing, "MOST_STREAMS", 4)
    before = SigningCheck(KEY, file)
    for at_us in (NOW - 50 * S, NOW - 45 * S):
        assert judge(before, signed(at_us), at_us) is None
    last = signed(NOW + 20 * S, vehicle=TWO)
    assert judge(before, last, NOW + 20 * S) is None
    check, now_us = SigningCheck(KEY, file), NOW + 25 * S
    for number in range(10, 16):
        assert judge(check, signed(now_us, vehicle=VehicleId(number, 1)), now_us) is None
    assert VEHICLE not in {VehicleId(*stream[:2]) for stream in check._last}
    assert judge(check, last, now_us) == "replayed"
