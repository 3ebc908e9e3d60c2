"""The script of the documents' pictures, and the page that explains them."""

import sys
from pathlib import Path

import pytest

from fuzzbee.verdict import HEADING_DEG, HORIZON_DEG, WORDS

DOCS = Path(__file__).parents[2] / "docs"

pytestmark = pytest.mark.checkout


@pytest.fixture
def pictures(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(DOCS))
    import pictures

    monkeypatch.setattr(pictures, "FOLDER", tmp_path)
    yield pictures
    del sys.modules["pictures"]


def test_watch_is_drawn_of_recorded_flights(pictures, tmp_path):
    pictures.draw_watch()
    pictures.draw_watch_one()
    table = (tmp_path / "watch.svg").read_text("utf-8")
    for part in ("running", "tilt", "3.8"):
        assert part in table
    one = (tmp_path / "watch-one.svg").read_text("utf-8")
    assert any(word.upper() in one.replace("&#160;", " ") for word in WORDS.values())
    assert "horizon" in one
    for picture in (table, one):
        assert "http" not in picture.replace("http://www.w3.org/2000/svg", "")  # fetches nothing


def test_the_page_names_the_bounds_and_words_that_are_used():
    text = (DOCS / "views.md").read_text("utf-8")
    for bound in (*HORIZON_DEG, *HEADING_DEG):
        assert f"over {bound:g}°" in text
    for word in WORDS.values():
        assert f"**{word}**" in text
