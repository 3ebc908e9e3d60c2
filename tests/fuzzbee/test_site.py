"""The documentation as a site: generated pages and pictures, the tour; nothing is fetched."""

import importlib.util
import re
import shutil
from pathlib import Path

import pytest

import fuzzbee
from fuzzbee.app import build_command
from fuzzbee.verdict import WORDS
from tests.fuzzbee import browser
from tests.programs import run_python

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"

pytestmark = pytest.mark.checkout


def script(name):
    """A script of docs/ as a module."""
    spec = importlib.util.spec_from_file_location(f"docs_{name}", DOCS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_of_commands_has_every_option_with_its_help():
    page = script("site").commands_page()
    rows = re.findall(r"^\| `(.+?)` \| .*? \| (.*) \|$", page, re.MULTILINE)
    app = build_command(decorated=False)
    verbs = [name for name in app.commands if name != "profile"]
    verbs += ["profile"] * len(app.commands["profile"].commands)
    assert [section.split("\n")[0].split()[1] for section in page.split("\n## ")[1:]] == verbs
    for name, command in app.commands.items():
        for parameter in getattr(command, "params", []):
            is_shown = parameter.param_type_name == "option" and not parameter.hidden
            if is_shown and name != "profile":
                assert f"`{parameter.opts[0]}" in page or f", {parameter.opts[0]}" in page
    assert len(rows) > 60
    assert all(text for _, text in rows), [names for names, text in rows if not text]
    assert "| `--rate HZ` | `100.0` |" in page


def test_the_page_for_programs_has_every_name():
    page = script("site").programs_page()
    for name in set(fuzzbee.__all__) - {"__version__"}:
        assert f"\n## {name}\n" in page
    assert "mag_gauss: ArrayLike | None = None" in page
    assert "\n## Estimator.update_batch\n" in page


def test_links_to_the_repositorys_root_become_links_between_pages():
    links = script("site").site_links
    assert links("[a](docs/python.md#x) [b](../README.md)") == "[a](python.md#x) [b](index.md)"
    assert links("[c](CONTRIBUTING.md), [d](../CONTRIBUTING.md)").count("(contributing.md)") == 2


def test_watch_is_drawn_of_recorded_flights(monkeypatch, tmp_path):
    pictures = script("pictures")
    monkeypatch.setattr(pictures, "FOLDER", tmp_path)
    pictures.draw_watch()
    pictures.draw_watch_one()
    table, one = ((tmp_path / f"{name}.svg").read_text("utf-8") for name in ("watch", "watch-one"))
    assert all(part in table for part in ("running", "tilt", "3.8"))
    assert any(word.upper() in one.replace("&#160;", " ") for word in WORDS.values())
    assert "horizon" in one
    for picture in (table, one):
        assert "http" not in picture.replace("http://www.w3.org/2000/svg", "")  # fetches nothing


@pytest.mark.slow
def test_the_tour_shows_what_its_blocks_print(tmp_path):
    """Digits may differ by a fifth: they are measured."""
    pytest.importorskip("matplotlib")
    page = (DOCS / "tour.md").read_text("utf-8")
    again = script("tour").run_page(page, tmp_path)
    number = re.compile(r"-?\d+\.\d+")
    assert number.sub("#", again) == number.sub("#", page)
    measured = [float(each) for each in number.findall(again)]
    shown = [float(each) for each in number.findall(page)]
    assert measured == pytest.approx(shown, rel=0.2, abs=0.11)
    for picture in re.findall(r"\]\((tour-\w+\.png)\)", page):
        drawn, kept = ((folder / picture).stat().st_size for folder in (tmp_path, DOCS))
        assert drawn == pytest.approx(kept, rel=0.2)


@pytest.mark.slow
def test_the_site_is_built_without_a_warning_and_fetches_nothing(tmp_path):
    pytest.importorskip("material")
    for name in ("docs", "mkdocs.yml", "README.md", "CONTRIBUTING.md", "CHANGELOG.md"):
        source = ROOT / name
        copy = shutil.copytree if source.is_dir() else shutil.copyfile
        copy(source, tmp_path / name)
    site = tmp_path / "site"
    command = ("-m", "mkdocs", "build", "--strict", "-q", "-d", str(site))
    done = run_python(*command, timeout_s=900, folder=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    pages = list(site.glob("*.html"))
    assert len(pages) >= 20
    fetched = (
        r"<(?:script|img|iframe)[^>]*\ssrc=\"?(https?:)?//|<link[^>]*rel=\"?"
        r"(?:stylesheet|preconnect|preload)[^>]*href=\"?(https?:)?//"
    )
    imported = r"url\([\"']?(https?:)?//|@import"
    for file in (*pages, *site.rglob("*.css")):
        pattern = imported if file.suffix == ".css" else fetched
        assert not re.search(pattern, file.read_text("utf-8")), file
    if browser.program() is not None:  # opened as a file, it is searched, too
        with browser.page((site / "index.html").as_uri(), tmp_path / "profile") as page:
            field = "document.querySelector('[data-md-component=search-query]')"
            page.wait_for(f"document.readyState == 'complete' && !!{field}")
            page.wait_for(  # typed again until somebody listens
                f"({field}.focus(), {field}.value = 'magnetometer',"
                f" {field}.dispatchEvent(new Event('input', {{bubbles: true}})),"
                f" {field}.dispatchEvent(new KeyboardEvent('keyup', {{bubbles: true, key: 'r'}})),"
                " document.querySelectorAll('.md-search-result__item').length > 3)"
            )
