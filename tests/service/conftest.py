"""The loop's tests run in real time: kernels are loaded before them, as the command does."""

import pytest

from service.process import load_kernels
from service.zenoh_session import close_session
from tests.fuzzbee.processes import free_endpoint
from tests.service.flight_rig import SETTLE_S, Rig
from tests.service.sessions import open_session, plain_client

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
    return free_endpoint()


@pytest.fixture
def session(endpoint):
    """The service's own, on a port of the test's."""
    opened = open_session(endpoint)
    yield opened
    close_session(opened)


@pytest.fixture
def client(session, endpoint):
    """Plain Zenoh, connected to the service's session."""
    with plain_client(endpoint) as opened:
        yield opened


@pytest.fixture
def rig():
    """A flight that has settled."""
    return Rig().fly(SETTLE_S)
