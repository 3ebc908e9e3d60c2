"""``run --workers``: real processes, real UDP, real Zenoh sessions."""

import json
import os
import signal
import socket
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from drivers.events import Imu, VehicleId
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.framing import FrameReader, frame_end
from drivers.simulation.autopilot import VehicleOptions
from drivers.simulation.fleet import Fleet
from estimator.profile import load_profile
from fuzzbee.cli import main
from service.attitude_text import texts_of_records
from service.pipeline import Pipeline
from service.records import AttitudeRecord
from tests.fuzzbee.processes import free_port, started
from tests.service.sinks.test_zenoh import plain_client, wait_for
from tests.service.sinks.test_zenoh_faults import router

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/task").exists(), reason="looks for processes in /proc"
)

RATE_HZ = 50.0
SLOW_HZ = 20.0  # a short stall of a busy computer leaves no sample out


@contextmanager
def flight(vehicles, *ports, rate_hz=RATE_HZ, seconds=60.0):
    """The same datagrams to each port, in real time; yields how many datagrams have been sent."""
    fleet = Fleet(VehicleOptions(rate_hz=rate_hz), vehicles)
    ended = threading.Event()
    sent = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:

        def send(data):
            sent.append(data)
            for port in ports:
                sender.sendto(data, ("127.0.0.1", port))

        def fly():
            begin_s = time.monotonic()
            while not ended.is_set() and time.monotonic() < begin_s + seconds:
                fleet.send_due(1e6 * (time.monotonic() - begin_s), time.time_ns() // 1000, send)
                time.sleep(0.002)

        thread = threading.Thread(target=fly)
        thread.start()
        try:
            yield sent
        finally:
            ended.set()
            thread.join()


@contextmanager
def service(port, *options):
    """A running service that is listening; all its processes are gone at the end."""
    with started(
        "run", f"udpin:127.0.0.1:{port}", "--json", "--rate", "50", "--profile", "paper", *options
    ) as process:
        await_line(process, "listening")
        family = descendants(process.pid)
        try:
            yield process
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
            family += descendants(process.pid) if process.poll() is None else []
            wait_for(lambda: not any(map(is_alive, family)), 10.0)


def only(endpoint):
    """The options of a session that has this address and looks for no other."""
    return "-l", endpoint, "-e", endpoint


def await_line(process, words):
    said = ""
    for line in process.stderr:
        said += line
        if words in line:
            return said
    pytest.fail(f"{words!r} was never said, but: {said}")


def keep_reading(process):
    """Standard error, so that nobody waits for it to be read."""
    lines = []
    threading.Thread(target=lambda: lines.extend(process.stderr), daemon=True).start()
    return lines


def descendants(process):
    found = []
    for task in Path(f"/proc/{process}/task").glob("*/children"):
        for child in task.read_text().split():
            found += [int(child), *descendants(int(child))]
    return found


def is_alive(process):
    """Whether there is such a process that is no zombie."""
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def workers_of(process):
    """The nursery and the workers, in their order."""
    nursery, *workers = descendants(process.pid)
    return nursery, sorted(workers)


def end(process, lines):
    process.send_signal(signal.SIGINT)
    out = process.stdout.read()
    assert process.wait(10) == 0
    assert not [line for line in lines if "Traceback" in line]
    return json.loads(out)


def recorded(path):
    """Arrival and bytes of each frame of a tlog."""
    data, at, frames = path.read_bytes(), 0, []
    while at < len(data):
        behind = frame_end(data, at + 8)
        frames.append((int.from_bytes(data[at : at + 8], "big"), data[at + 8 : behind]))
        at = behind
    return frames


class Subscriber:
    """Attitudes and the last status of each vehicle."""

    def __init__(self, session):
        self.attitudes = {}
        self.statuses = {}
        session.declare_subscriber("fuzzbee/*/attitude", self.on_attitude)
        session.declare_subscriber("fuzzbee/*/status", self.on_status)

    def on_attitude(self, sample):
        name = str(sample.key_expr).split("/")[1]
        record = json.loads(sample.payload.to_string())
        self.attitudes.setdefault(name, []).append((time.time(), record))

    def on_status(self, sample):
        name = str(sample.key_expr).split("/")[1]
        self.statuses[name] = json.loads(sample.payload.to_string())

    def count(self, name):
        return len(self.attitudes.get(name, ()))


def test_workers_publish_and_record_what_one_process_does(tmp_path):
    """To the last digit: each attitude is that of one pipeline on the recording, at its time."""
    shared, alone = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_DGRAM)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    logs = tmp_path / "shared.tlog", tmp_path / "alone.tlog"
    with (
        service(shared, "--workers", "2", "--record", str(logs[0]), *only(endpoint)) as process,
        service(alone, "--no-zenoh", "--record", str(logs[1])) as single,
        plain_client(endpoint) as session,
    ):
        lines, others = keep_reading(process), keep_reading(single)
        seen = Subscriber(session)
        time.sleep(0.3)
        with flight(4, shared, alone, rate_hz=SLOW_HZ) as sent:
            wait_for(lambda: all(seen.count(str(n)) > 100 for n in range(1, 5)), 30.0)
        time.sleep(0.3)
        family = descendants(process.pid)
        result, expected = end(process, lines), end(single, others)
        assert not any(map(is_alive, family))  # Ctrl-C leaves nobody
    frames = [frame for _, frame in recorded(logs[0])]
    assert frames == [frame for _, frame in recorded(logs[1])]
    assert b"".join(frames) == b"".join(sent)
    whole = [
        number
        for number in range(1, 5)
        if not any(each["vehicles"][str(number)]["shed"] for each in (result, expected))
    ]
    assert {status["worker"] for status in seen.statuses.values()} == {1, 2}
    if not whole:
        pytest.skip("a long stall: samples of all were left out, and nobody knows which")
    for number in whole:
        vehicle, alike = (each["vehicles"][str(number)] for each in (result, expected))
        assert vehicle["samples"] == alike["samples"]
        assert vehicle["rejected"] == alike["rejected"]
        records = [record for _, record in seen.attitudes[str(number)]]
        assert_one_pipeline_says(records, recorded(logs[0]), number)


def assert_one_pipeline_says(records, frames, system):
    """Each attitude is what the pipeline has after the sample that it is propagated from.

    A tick that comes late names its own time, and a sample may have arrived since: with age 0 the
    record does not tell which was the last.
    """
    pipeline, decoder = Pipeline(load_profile("paper")), MavlinkDecoder(references=False)
    address = VehicleId(system, 1)
    events = []
    for arrival_us, data in frames:
        [frame] = FrameReader().feed(data)
        if frame.system_id == system:
            events += decoder.events(frame, arrival_us)
    told = [record for record in records if record["age_ms"] > 0.0]
    assert len(told) > 0.8 * len(records)
    for record in told:
        time_us = record["time_unix_us"]
        last_us = time_us - round(1e3 * record["age_ms"])
        while events and (not isinstance(events[0], Imu) or events[0].arrival_us <= last_us):
            pipeline.handle(events.pop(0))
        vehicle = pipeline.vehicle(address)
        vehicle.attitudes = record["sequence"]
        vehicle.on_time(time_us)
        attitude = vehicle.attitude(time_us)
        assert isinstance(attitude, AttitudeRecord)
        (text,) = texts_of_records([attitude])
        alone = json.loads(text)
        for key in ("q_ned_frd", "rate_rad_s", "sigma_deg", "time_boot_us"):
            assert alone[key] == record[key]


def test_a_worker_that_is_killed_is_replaced_with_all_that_its_vehicles_had(tmp_path):
    port, endpoint = free_port(socket.SOCK_DGRAM), f"tcp/127.0.0.1:{free_port()}"
    log = tmp_path / "flight.tlog"
    with (
        service(port, "--workers", "2", "--record", str(log), *only(endpoint)) as process,
        plain_client(endpoint) as session,
        flight(4, port) as sent,
    ):
        lines = keep_reading(process)
        seen = Subscriber(session)
        wait_for(lambda: all(seen.count(str(n)) > 30 for n in range(1, 5)), 30.0)
        wait_for(lambda: len(seen.statuses) == 4, 10.0)
        changed = put_profile(session, "1", {"filter": {"gain": "fixed", "fixed_gain": 3.5}})
        assert changed["filter"]["fixed_gain"] == 3.5
        wait_for(lambda: seen.attitudes["1"][-1][1]["gain"] == 3.5, 5.0)
        time.sleep(1.1)  # a worker hands its counts over once a second
        nursery, workers = workers_of(process)
        victim = seen.statuses["1"]["worker"]
        killed_s = time.time()
        os.kill(workers[victim - 1], signal.SIGKILL)
        later = lambda n: [r for s, r in seen.attitudes[n] if 1e-6 * r["time_unix_us"] > killed_s]  # noqa: E731
        wait_for(lambda: all(len(later(str(n))) > 20 for n in range(1, 5)), 20.0)
        wait_for(lambda: any("was killed by SIGKILL" in line for line in lines), 5.0)
        wait_for(lambda: seen.statuses["1"]["restarts"] == 1, 5.0)
        assert later("1")[-1]["gain"] == 3.5
        for n in range(1, 5):
            sequences = [record["sequence"] for _, record in seen.attitudes[str(n)]]
            assert sequences == list(range(sequences[0], sequences[0] + len(sequences)))
        same_nursery, workers = workers_of(process)
        assert same_nursery == nursery
        # the process that workers come from, too: without it nobody lists them
        os.kill(nursery, signal.SIGKILL)
        os.kill(workers[0], signal.SIGKILL)
        count = {str(n): seen.count(str(n)) for n in range(1, 5)}
        wait_for(lambda: all(seen.count(n) > count[n] + 20 for n in count), 60.0)
        # one that is stopped, while both its workers die
        stopped, workers = workers_of(process)
        os.kill(stopped, signal.SIGSTOP)
        for each in workers:
            os.kill(each, signal.SIGKILL)
        count = {str(n): seen.count(str(n)) for n in range(1, 5)}
        wait_for(lambda: all(seen.count(n) > count[n] + 20 for n in count), 60.0)
        wait_for(lambda: any(f"({stopped}) hung and is replaced" in line for line in lines), 5.0)
        told = [f"(process {each})" for each in workers]
        wait_for(lambda: all(any(each in line for line in lines) for each in told), 5.0)
        family = descendants(process.pid)
        os.kill(family[0], signal.SIGSTOP)
        process.kill()  # nobody is told, and nobody stays
        process.wait()
        wait_for(lambda: not any(map(is_alive, family)), 10.0)
    frames = [frame for _, frame in recorded(log)]
    stream = b"".join(sent)
    assert b"".join(frames) in stream  # nothing is missing in between
    assert len(b"".join(frames)) > 0.5 * len(stream)


def test_a_maker_of_workers_that_is_stopped_before_it_has_made_one_is_replaced():
    port = free_port(socket.SOCK_DGRAM)
    command = ("run", f"udpin:127.0.0.1:{port}", "--json", "--workers", "2", "--no-zenoh")
    with started(*command, "--profile", "paper") as process, flight(2, port):
        is_there = lambda p: b"import serve" in Path(f"/proc/{p}/cmdline").read_bytes()  # noqa: E731
        wait_for(lambda: any(map(is_there, descendants(process.pid))), 30.0)
        (stopped, *_) = descendants(process.pid)
        os.kill(stopped, signal.SIGSTOP)
        await_line(process, f"({stopped}) hung and is replaced")
        lines = keep_reading(process)
        wait_for(lambda: any("vehicle 2: running" in line for line in lines), 30.0)
        family = descendants(process.pid)
        end(process, lines)
    assert stopped not in family
    assert not any(map(is_alive, family))


def test_a_service_that_was_stopped_publishes_nothing_old(tmp_path):
    """Its workers have gone on meanwhile: of each vehicle only what is newest still counts."""
    port, endpoint = free_port(socket.SOCK_DGRAM), f"tcp/127.0.0.1:{free_port()}"
    with (
        service(port, "--workers", "2", *only(endpoint)) as process,
        plain_client(endpoint) as session,
        flight(4, port),
    ):
        lines = keep_reading(process)
        seen = Subscriber(session)
        wait_for(lambda: all(seen.count(str(n)) > 30 for n in range(1, 5)), 30.0)
        process.send_signal(signal.SIGSTOP)
        time.sleep(2.0)
        seen.attitudes.clear()
        process.send_signal(signal.SIGCONT)
        wait_for(lambda: all(seen.count(str(n)) > 30 for n in range(1, 5)), 30.0)
        ages_s = [
            arrival_s - 1e-6 * record["time_unix_us"]
            for rows in seen.attitudes.values()
            for arrival_s, record in rows
        ]
        # each vehicle's last; a hundred more of each waited before the others were left out
        assert len([age for age in ages_s if age > 1.0]) <= 2 * 4
        result = end(process, lines)
    assert result["dropped"] > 4 * 50


def put_profile(session, name, partial):
    """The profile by which the service answers a put; asked again where a computer is so busy."""
    key = f"fuzzbee/{name}/parameters"
    for _ in range(5):
        [reply] = session.get(key, payload=json.dumps(partial), timeout=5.0)
        if reply.ok is not None:
            return json.loads(reply.ok.payload.to_string())
    return pytest.fail(reply.err.payload.to_string())


def test_a_vehicle_that_nobody_can_replace_a_worker_for_ends_the_service():
    """Workers that die again and again: a clear line, and status 1."""
    port = free_port(socket.SOCK_DGRAM)
    with service(port, "--workers", "2", "--no-zenoh") as process:
        lines = keep_reading(process)
        first = workers_of(process)[1][0]
        known = set(descendants(process.pid)) - {first}
        deaths = 0
        while process.poll() is None and deaths < 12:  # slow ones do not count
            fresh = set(descendants(process.pid)) - known
            known |= fresh
            for worker in fresh:
                os.kill(worker, signal.SIGKILL)
            deaths += len(fresh)
            time.sleep(0.01)
        assert deaths >= 4
        assert process.wait(10) == 1
    wait_for(lambda: any("4 times in a row, each time within 5 s" in line for line in lines), 5.0)


def test_two_services_on_a_router_each_with_its_share(capfd):
    """What a subscriber at the router sees is one fleet, its keys those of one service."""
    ports = [free_port(socket.SOCK_DGRAM) for _ in range(2)]
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    at_router = ("-m", "client", "-e", endpoint)
    shares = ("1,2", "3,4")
    with router(endpoint):
        first, second = (
            ("--allow-system-ids", share, *at_router, "--workers", workers)
            for share, workers in zip(shares, ("2", "1"), strict=True)
        )
        with (
            service(ports[0], *first) as one,
            service(ports[1], *second) as two,
            plain_client(endpoint) as session,
            flight(4, *ports),  # both hear all, and take their share
        ):
            seen = Subscriber(session)
            wait_for(lambda: all(seen.count(str(n)) > 30 for n in range(1, 5)), 30.0)
            results = [end(each, keep_reading(each)) for each in (one, two)]
    assert [sorted(result["vehicles"]) for result in results] == [["1", "2"], ["3", "4"]]
    for records in seen.attitudes.values():
        sequences = [record["sequence"] for _, record in records]
        assert sequences == list(range(sequences[0], sequences[0] + len(sequences)))
    capfd.readouterr()


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["udpin:127.0.0.1:14999", "--workers", "0"], "--workers 0: should be 1 to 64"),
        (["udpin:127.0.0.1:14999", "--workers", "65"], "--workers 65"),
        (["sim:", "--workers", "2"], "--workers shares out"),
        (["udpin:127.0.0.1:14999", "--workers", "2", "--retune"], "--retune"),
        (["udpin:127.0.0.1:14999", "--workers", "2", "--truth"], "--truth"),
    ],
)
def test_what_cannot_be_shared_out_is_status_2(arguments, word, capfd):
    assert main(["run", "--no-zenoh", *arguments]) == 2
    assert word in capfd.readouterr().err.splitlines()[-1]


def test_more_workers_than_cores_is_only_said(capfd):
    assert main(["run", "--no-zenoh", "sim:", "--workers", "64"]) == 2
    assert "only costs memory" in capfd.readouterr().err
