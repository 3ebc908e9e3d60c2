"""The loop's tests run in real time: kernels are loaded before them, as the command does."""

import socket

import pytest

from service.process import load_kernels
from service.zenoh_session import close_session
from tests.service.flight_rig import SETTLE_S, Rig

PATIENCE_S = 60.0


@pytest.fixture(scope="session", autouse=True)
def _compiled():
    load_kernels()


@pytest.fixture(autouse=True)
def _patient(monkeypatch):
    """What a person waits for is short; a test on a busy machine waits for longer."""
    monkeypatch.setattr("service.sinks.sink.CLOSE_TIMEOUT_S", PATIENCE_S)
    monkeypatch.setattr("service.sinks.sink.LONGEST_WAIT_S", PATIENCE_S)
    monkeypatch.setattr("service.parameters.ANSWER_TIMEOUT_S", PATIENCE_S)


@pytest.fixture
def endpoint():
    """Where nobody listens, for Zenoh."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture
def session(endpoint):
    """The service's own, on a port of the test's."""
    from tests.service.sinks.test_zenoh import open_session, options

    opened = open_session(options(endpoint))
    yield opened
    close_session(opened)


@pytest.fixture
def rig():
    """A flight that has settled."""
    return Rig().fly(SETTLE_S)
