"""``fuzzbee watch`` beside services that come and go, and what it makes of what it receives."""

import io
import json
import random
import signal
from contextlib import closing, redirect_stderr, redirect_stdout

import msgspec
import pytest
from hypothesis import given
from rich.console import Console

from fuzzbee.cli import main
from fuzzbee.notify import notify, printable
from fuzzbee.reception import Reception
from fuzzbee.terminal import TerminalView
from fuzzbee.watch import show
from tests.fuzz.cases import built, fuzzed
from tests.fuzzbee.processes import default_session, shell, started
from tests.service.records import record as attitude_record
from tests.service.sessions import assert_without_gaps


@pytest.fixture
def session():
    return default_session()


def lines_of(process, count):
    return [json.loads(process.stdout.readline()) for _ in range(count)]


def test_a_watcher_before_and_one_beside_a_service_that_is_restarted(session):
    with started("watch", "--json", *session) as watcher:
        assert "is fuzzbee run started" in watcher.stderr.readline()
        for _ in range(2):
            with started("run", *session) as service, started("watch", "--json", *session) as other:
                records = lines_of(watcher, 100)
                assert_without_gaps(lines_of(other, 100))
                service.send_signal(signal.SIGTERM)
                assert service.wait(60) == 0
            records = [r for r in records if r["sequence"] >= records[-1]["sequence"] - 50]
            assert_without_gaps(records[-50:])
        watcher.send_signal(signal.SIGINT)
        _, err = watcher.communicate(timeout=60)
    assert watcher.returncode == 0
    assert "Traceback" not in err


def test_a_bounded_watch_that_gets_nothing_has_failed(session, capfd):
    assert main(["watch", "--seconds", "0.3", *session]) == 1
    assert capfd.readouterr().out == ""


def test_a_reader_that_leaves_is_no_error(session):
    with started("run", *session):
        done = shell('"$@" | head -n 3', "watch", "--json", *session)
    assert len(done.stdout.splitlines()) == 3
    assert not [word for word in ("Traceback", "Broken") if word in done.stderr]


# --- what comes from the network is data: checked, escaped, bounded, and reported once

DIFFERENCE = {"inclination_deg": 1.0, "rate_deg_s": 1.0}
ATTITUDE = json.loads(msgspec.json.encode(attitude_record()))
STATUS = {
    "state": "running", "imu_message": "RAW_IMU", "imu_rate_hz": 50.0, "worst_gap_s": 0.1,
    "rejected": {}, "overruns": 0, "dropped": 0, "sequence": 3, "mode": "LOITER", "armed": True,
    "other_imus": {"SCALED_IMU2": DIFFERENCE},
}  # fmt: skip
HOSTILE_TEXTS = ("\x1b[2J\x1b]0;owned\x07", "[bold red]x[/]", "[/]", "a\nb", "\u202etxt", "\x9b31m",
                 "x" * 100_000, "\ud800", "")  # fmt: skip
NUMBERS = (1e308, -1e308, 1e12, 721.0, -721.0, 10**30, -1, float("nan"), "1", None)


def received(key, record):
    reported = []
    payload = record if isinstance(record, bytes) else json.dumps(record).encode()
    return Reception(reported.append).record(key, payload), reported


def test_ours_are_taken():
    (name, record), reported = received("fuzzbee/12-3/attitude", ATTITUDE)
    assert (name, reported) == ("12-3", [])
    assert json.loads(msgspec.json.encode(record)) == ATTITUDE
    for message in ("RAW_IMU", "HIGHRES_IMU:1", "sensor_combined", "/imu/data_raw", "IMU2"):
        status = {**STATUS, "imu_message": message, "other_imus": {message: DIFFERENCE}}
        (name, record), reported = received("a/b/7/status", status)
        assert (name, record.imu_message, reported) == ("7", message, [])


@pytest.mark.parametrize(
    ("key", "changes", "words"),
    [
        ("copter/attitude", {}, "names no vehicle"),
        ("1\n2/attitude", {}, "names no vehicle"),
        ("1" * 9000 + "/attitude", {}, "names no vehicle"),
        ("\u0661/status", {}, "names no vehicle"),
        ("1/attitude", {"schema": 2}, "schema"),
        ("1/attitude", {"state": "flying"}, "state"),
        ("1/attitude", {"heading_reference": "[b]"}, "heading_reference"),
        ("1/attitude", {"gain": 1e308}, "`float` <= 10000000.0 - at `$.gain`"),
        ("1/attitude", {"euler_deg": [0, 1e9, 0]}, "$.euler_deg[1]"),
        ("1/attitude", {"rate_rad_s": [0, 0, 1e308]}, "$.rate_rad_s[2]"),
        ("1/attitude", {"q_ned_frd": [1, 0, 0]}, "no attitude record"),
        ("1/attitude", b"[" * 5000, "no attitude record"),
        *(("1/status", {"imu_message": name}, "imu_message") for name in ("\x1b[2J", "[red]", "")),
        ("1/status", {"other_imus": {"\x1b[2J": DIFFERENCE}}, "other_imus"),
        ("1/status", {"other_imus": {f"IMU{n}": DIFFERENCE for n in range(99)}}, "other_imus"),
        ("1/status", {"other_imus": {"A": {**DIFFERENCE, "rate_deg_s": 1e300}}}, "rate_deg_s"),
        *(("1/status", {"imu_rate_hz": rate}, "imu_rate_hz") for rate in (1e308, -1.0)),
        *(("1/attitude", {"error": error}, "$.error") for error in (-0.1, 1.1)),
        *(("1/attitude", {name: -0.1}, f"$.{name}") for name in ("gain", "age_ms")),
        ("1/attitude", {"euler_deg": [0.0, 0.0, -1e4]}, "$.euler_deg[2]"),
        ("1/status", {"mode": "\x1b[2J"}, "mode"),
        ("1/status", {"rejected": {"x" * 40_000: 1}}, "bytes"),
    ],
)
def test_others_are_not_and_that_is_reported(key, changes, words):
    ours = ATTITUDE if key.endswith("attitude") else STATUS
    sent = changes if isinstance(changes, bytes) else {**ours, **changes}
    taken, reported = received(f"fuzzbee/{key}", sent)
    assert taken is None
    (line,) = reported
    assert words in line
    assert line == printable(line)
    assert len(line) < 300


def test_it_is_reported_once():
    reported = []
    reception = Reception(reported.append)
    for number in range(9):
        reception.record(f"fuzzbee/no{number}/status", json.dumps(STATUS).encode())
    assert len(reported) == 1


def changed(rng):
    """A record with some values replaced, perhaps under a hostile key."""
    kind, record = rng.choice((("attitude", ATTITUDE), ("status", STATUS)))
    record = dict(record)
    for name in rng.sample(sorted(record), rng.randint(0, 3)):
        value = record[name]
        hostile = rng.choice((*HOSTILE_TEXTS, *NUMBERS, {}, [], True))
        if isinstance(value, list) and rng.random() < 0.7:
            value = list(value)
            value[rng.randrange(len(value))] = hostile
        elif isinstance(value, dict) and rng.random() < 0.7:
            value = {**value, rng.choice((*HOSTILE_TEXTS, *value)): hostile}
        else:
            value = hostile
        record[name] = value
    name = rng.choice(("1", "1", "255-190", rng.choice(HOSTILE_TEXTS)))
    return f"fuzzbee/{name}/{kind}", json.dumps(record).encode("utf-8", "replace")


@fuzzed(150, 20000)
@given(built(lambda rng: rng))
def test_whatever_is_published_neither_ends_watch_nor_reaches_the_terminal(rng):
    """Table, plain lines and JSON; an escape sequence that is not ours is one that is theirs."""
    samples = [changed(rng) for _ in range(12)]
    for width, is_terminal in ((100, True), (60, False)):
        out, err = io.StringIO(), io.StringIO()
        look = {"force_terminal": is_terminal, "color_system": None, "width": width}
        consoles = [Console(file=file, **look) for file in (out, err)]
        view = TerminalView(*consoles, "watch", now_s=lambda: 1.0)
        reception = Reception(view.notify)
        with closing(view):
            for key, payload in samples:
                if (received := reception.record(key, payload)) is not None:
                    show(*received, view)
            view.refresh()
        shown = out.getvalue() + err.getvalue()
        for text in ("\x07", "\x9b", "\u202e", "\x1b[2J", "\x1b]0", "1e+30", "0" * 20):
            assert text not in shown
    require_a_line_for_each(samples)


def require_a_line_for_each(samples):
    """Of JSON, for what is taken of them."""
    reception, out = Reception([].append), io.StringIO()
    with redirect_stdout(out), redirect_stderr(io.StringIO()):
        given = [reception.record(key, payload) for key, payload in samples if "attitude" in key]
        count = sum(show(*each, None) for each in given if each is not None)
    written = out.getvalue().splitlines()
    assert len(written) == count
    for line in written:
        assert printable(line) == line
        assert json.loads(line)["vehicle"] in ("1", "255-190")


def test_the_cases_hold_some_that_are_shown():
    rng = random.Random(1)
    assert 40 < sum(received(*changed(rng))[0] is not None for _ in range(300)) < 240


def test_lines_for_a_person_are_printable_and_bounded(capsys):
    for text in HOSTILE_TEXTS:
        notify(f"log {text}.tlog")
    lines = capsys.readouterr().err.split("\n")
    assert len(lines) == len(HOSTILE_TEXTS) + 1
    assert all(line.isprintable() and len(line) < 1200 for line in lines)
    assert r"log \x1b[2J\x1b]0;owned\x07.tlog" in lines[0]
    view_out = io.StringIO()
    view = TerminalView(Console(file=view_out), Console(file=view_out), "run")
    view.notify("vehicle 1: \x1b[2J[red]STATUSTEXT\nfuzzbee: forged")
    assert view_out.getvalue() == "vehicle 1: \\x1b[2J[red]STATUSTEXT\\nfuzzbee: forged\n"
