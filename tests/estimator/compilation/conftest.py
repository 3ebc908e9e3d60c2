"""What processes need that compile one kernel, or find it compiled."""

import shutil
import sys

import pytest

from tests.estimator.compilation.small_program import run


@pytest.fixture(scope="session")
def compiled_once(tmp_path_factory):
    """What the small program has printed, and the folder where it has left its compiled kernel."""
    folder = tmp_path_factory.mktemp("compiled")
    return run(NUMBA_CACHE_DIR=str(folder)).stdout, folder


@pytest.fixture
def expected(compiled_once):
    """What the small program prints."""
    return compiled_once[0]


@pytest.fixture
def cache(compiled_once, tmp_path):
    """A folder of this test's own in which the small program finds its kernel compiled."""
    shutil.copytree(compiled_once[1], tmp_path / "cache", symlinks=sys.platform != "win32")
    return tmp_path / "cache"
