"""The loop's tests run in real time: kernels are loaded before them, as the command does."""

import pytest

from service.process import load_kernels


@pytest.fixture(scope="session", autouse=True)
def _compiled():
    load_kernels()
