"""The axes of a frame turn vectors as its quaternion does."""

import pytest
from hypothesis import given

from estimator.geometry.axes import axes_of, down_of, to_body, to_frame
from estimator.geometry.quaternion import rotate, rotate_inverse
from tests.vocabulary import any_rotation, unit_vectors


@given(any_rotation(), unit_vectors())
def test_there_and_back(q, v):
    axes = axes_of(q)
    assert to_frame(axes, v) == pytest.approx(rotate(q, v), abs=1e-9)
    assert to_body(axes, v) == pytest.approx(rotate_inverse(q, v), abs=1e-9)
    assert down_of(q) == axes.down
