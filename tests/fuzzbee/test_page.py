"""A replay as an interactive page, in a real browser that has no network."""

import json
from pathlib import Path

import numpy as np
import pytest

from fuzzbee.cli import main
from tests.fuzzbee import browser

LOG = Path(__file__).parents[1] / "data" / "sitl_copter_4hz.tlog"

pytest.importorskip("plotly", reason="the extra 'page' is not installed")
pytestmark = pytest.mark.skipif(browser.program() is None, reason="there is no Chromium")

LAYOUT = "document.getElementById('fuzzbee')._fullLayout"
TRACES = "document.getElementById('fuzzbee')._fullData"


def write_page(capsys, path, *arguments):
    assert main(["replay", *map(str, arguments), "--plot", str(path), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def open_page(page, path):
    page.call("Page.navigate", url=path.as_uri())
    page.wait_for("document.querySelectorAll('#fuzzbee .main-svg').length > 0")


def ranges(page):
    """What each panel shows of its horizontal axis."""
    of = f"Object.keys({LAYOUT}).filter(k => k.startsWith('xaxis')).map(k => {LAYOUT}[k].range)"
    return json.loads(page.value(f"JSON.stringify({of})"))


def test_a_page_shows_the_reports_figures_and_its_panels_zoom_together(capsys, tmp_path):
    report = write_page(capsys, tmp_path / "a.html", LOG)
    write_page(capsys, tmp_path / "b.html", LOG)
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()
    with browser.page("about:blank", tmp_path / "browser") as page:
        open_page(page, tmp_path / "a.html")
        error = f"{TRACES}.find(t => t.yaxis == 'y4' && t.name == 'error').y"
        rms = np.sqrt(np.nanmean(np.array(page.value(f"Array.from({error})"), float) ** 2))
        assert rms == pytest.approx(report["error_deg"]["inclination_rms"])
        shown = f"JSON.stringify({TRACES}.filter(t => t.showlegend).map(t => t.name))"
        names = {"truth", "autopilot", "estimate", "sigma", "error", "gravity", "x", "y", "z"}
        assert names <= set(json.loads(page.value(shown)))
        assert len(ranges(page)) == 8
        page.value("Plotly.relayout('fuzzbee', {'xaxis3.range': [3, 6]}).then(() => done = 1) && 0")
        page.wait_for("window.done == 1")
        assert ranges(page) == [[3, 6]] * 8
        # whatever is cut off is told on the page, too
        notes = f"JSON.stringify({LAYOUT}.annotations.map(a => a.text))"
        assert any(text.startswith("cut off: ") for text in json.loads(page.value(notes)))
        assert page.value("performance.getEntriesByType('resource').length") == 0


@pytest.mark.parametrize(
    ("arguments", "panels"),
    [
        ((LOG, "--profile", "imu", "--profile", "adaptive"), 2),
        (("sim:", "--profile", "adaptive", "--seeds", "300-302"), 7),
    ],
    ids=["profiles", "experiment"],
)
def test_every_figure_is_a_page_too(capsys, tmp_path, arguments, panels):
    write_page(capsys, tmp_path / "a.html", *arguments)
    with browser.page("about:blank", tmp_path / "browser") as page:
        open_page(page, tmp_path / "a.html")
        assert len(ranges(page)) == panels
