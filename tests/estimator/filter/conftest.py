"""Both forms of the filter, for the tests that hold for each."""

import pytest

from estimator.filter import kernel, reference


@pytest.fixture(params=[reference, kernel], ids=["reference", "kernel"])
def backend(request):
    return request.param
