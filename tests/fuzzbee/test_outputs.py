"""What is asked for beside the attitude, refused before anything is opened."""

import pytest

from estimator.errors import InputError
from fuzzbee import options, outputs


def test_a_viewer_without_its_extra_is_refused(monkeypatch):
    monkeypatch.setattr(options, "find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"\[viewer\]"):
        outputs.viewer_options("web", None)


def test_without_a_viewer_nobody_needs_the_extra(monkeypatch):
    monkeypatch.setattr(options, "find_spec", lambda _: None)
    assert outputs.viewer_options(None, None) is None


def test_an_unknown_view_is_refused():
    with pytest.raises(InputError, match="--view hologram"):
        outputs.viewer_options("hologram", None)
