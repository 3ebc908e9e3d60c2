"""The loop's tests run in real time: compile before them, as the command does."""

import pytest

from estimator.profile import load_profile
from service.warm_up import warm_up


@pytest.fixture(scope="session", autouse=True)
def _compiled():
    warm_up(load_profile("paper"), None)
