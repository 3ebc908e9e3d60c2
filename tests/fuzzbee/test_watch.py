"""``fuzzbee watch`` beside services that come and go."""

import json
import signal

import pytest

from fuzzbee.cli import main
from tests.fuzzbee.processes import default_session, shell, started
from tests.service.sessions import assert_without_gaps


@pytest.fixture
def session():
    return default_session()


def lines_of(process, count):
    return [json.loads(process.stdout.readline()) for _ in range(count)]


def ended(process, number):
    """Its messages, after a signal."""
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0
    return err


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
        assert "Traceback" not in ended(watcher, signal.SIGINT)


def test_plain_lines_when_nobody_looks(session):
    with started("run", *session), started("watch", *session) as watcher:
        # a status may come first: then the first line has no attitude yet
        line = next(text for text in watcher.stdout if "roll" in text)
        assert "heading" in line
        err = ended(watcher, signal.SIGTERM)
    assert err == "" or "is fuzzbee run started" in err


def test_a_bounded_watch_that_gets_nothing_has_failed(session, capfd):
    assert main(["watch", "--seconds", "0.3", *session]) == 1
    assert capfd.readouterr().out == ""


def test_a_reader_that_leaves_is_no_error(session):
    with started("run", *session):
        done = shell('"$@" | head -n 3', "watch", "--json", *session)
    assert len(done.stdout.splitlines()) == 3
    assert "Traceback" not in done.stderr
    assert "Broken" not in done.stderr
