import json
import signal

from fuzzbee.cli import main
from tests.fuzzbee.processes import default_session, free_port, started
from tests.fuzzbee.test_streams import shell


def lines_of(process, count):
    return [json.loads(process.stdout.readline()) for _ in range(count)]


def assert_without_gaps(records):
    sequence = [record["sequence"] for record in records]
    assert sequence == list(range(sequence[0], sequence[0] + len(sequence)))


def test_a_watcher_before_and_one_beside_a_service_that_is_restarted():
    session = default_session(free_port())
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


def test_plain_lines_when_nobody_looks():
    session = default_session(free_port())
    with started("run", *session), started("watch", *session) as watcher:
        # a status may come first: then the first line has no attitude yet
        line = next(text for text in watcher.stdout if "roll" in text)
        assert "heading" in line
        watcher.send_signal(signal.SIGTERM)
        _, err = watcher.communicate(timeout=60)
    assert watcher.returncode == 0
    assert err == "" or "is fuzzbee run started" in err


def test_a_bounded_watch_that_gets_nothing_has_failed(capfd):
    assert main(["watch", "--seconds", "0.3", *default_session(free_port())]) == 1
    assert capfd.readouterr().out == ""


def test_a_reader_that_leaves_is_no_error():
    session = default_session(free_port())
    with started("run", *session):
        done = shell('"$@" | head -n 3', "watch", "--json", *session)
    assert len(done.stdout.splitlines()) == 3
    assert done.returncode == 0
    assert "Traceback" not in done.stderr
    assert "Broken" not in done.stderr
