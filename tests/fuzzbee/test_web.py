"""The light page: its server over real sockets, the page itself in a real browser."""

import http.client
import json
import os
import re
from contextlib import ExitStack, closing
from importlib.resources import files
from pathlib import Path

import msgspec
import pytest

from drivers.events import VehicleId
from estimator.errors import InputError
from fuzzbee.web.server import WebPage, open_page, parse_address
from service.http_door import MOST_CONNECTIONS, STREAM_PART
from service.records import Evicted, ImuDifference, Published, State
from tests.fuzzbee import browser
from tests.service.records import differing, record, status

ONE, OTHER = VehicleId(1, 1), VehicleId(2, 154)


@pytest.fixture
def clock():
    return [100.0]


@pytest.fixture
def page(clock):
    with closing(WebPage(("127.0.0.1", 0), "a test", now_s=lambda: clock[0])) as made:
        yield made


def asked(page, path):
    """The answer, which can be read from."""
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=10)
    connection.request("GET", path)
    return connection.getresponse()


def event(page, path="/events"):
    with asked(page, path) as answer:
        assert answer.status == 200
        assert answer.getheader("Content-Type") == "text/event-stream"
        return json.loads(answer.readline().removeprefix(b"data: "))


def running(words=(), **changes):
    return status(warnings=words, mode="LOITER", armed=True, **changes)


def test_an_event_has_all_vehicles_or_one(page, clock):
    page.handle([Published(OTHER, record(state=State.LOST)), Published(ONE, record(10, -20, 30))])
    page.handle([Published(ONE, running(("accelerometer_contradicts",)))])
    clock[0] += 2.0
    both = event(page)
    assert [each["name"] for each in both["vehicles"]] == ["1", "2-154"]
    one, lost = both["vehicles"]
    assert one["flight"] == ["LOITER", "armed"]
    assert (one["word"], one["level"], one["age_ms"]) == ("do not trust", 2, 2005)
    assert one["reasons"] == [[2, "accelerometer contradicts"]]
    (sentence,) = one["warnings"]
    assert sentence == "warning: the magnetic field contradicts the accelerometer's vertical"
    assert one["attitude"]["euler_deg"] == [10.0, -20.0, 30.0]
    assert (one["attitude"]["horizon"], one["attitude"]["north"]) == ("unsure", "unsure")
    assert one["attitude"]["sigma_deg"] == [1.0, 5.0]
    assert one["plates"] == [[2, sentence.removeprefix("warning: ")]]
    assert (lost["word"], lost["attitude"]) == ("no attitude", None)
    assert [each["name"] for each in event(page, "/events?vehicle=1")["vehicles"]] == ["1"]
    clock[0] += 2.0  # the service publishes nothing any more
    assert event(page)["vehicles"][0]["reasons"] == [[3, "the service is silent"]]
    page.handle([Evicted(ONE), Evicted(OTHER)])
    assert event(page)["vehicles"] == []


def test_another_attitude_of_the_autopilot_is_reported(page):
    page.handle([Published(ONE, record()), Published(ONE, differing("heading", 25.0))])
    (one,) = event(page)["vehicles"]
    assert one["autopilot"] == [0.0, 0.0, 25.0]
    assert one["reasons"] == [[1, "autopilot heading 25° off"]]
    assert one["warnings"] == ["warning: autopilot heading 25° off ours; its own is likely wrong"]


def test_records_are_those_of_zenoh(page):
    sent = record(10, -20, 30)
    page.handle([Published(ONE, sent), Published(ONE, running()), Published(OTHER, record())])
    with asked(page, "/vehicles") as answer:
        assert answer.getheader("Content-Type") == "application/json"
        assert json.loads(answer.read()) == ["1", "2-154"]
    with asked(page, "/vehicles/1/attitude") as answer:
        assert answer.read() == msgspec.json.encode(sent)
    with asked(page, "/vehicles/1/status") as answer:
        assert json.loads(answer.read())["imu_message"] == "RAW_IMU"
    for path in ("/vehicles/9/attitude", "/vehicles/2-154/status", "/vehicles/1", "/../etc/passwd"):
        with asked(page, path) as answer:
            assert answer.status == 404, path


def test_the_page_needs_nothing_else(page):
    with asked(page, "/") as answer:
        content = answer.read()
        assert answer.getheader("Content-Security-Policy").startswith("default-src 'none'")
    assert content == files("fuzzbee.web").joinpath("page.html").read_bytes()
    assert len(content) < 300_000
    links = re.findall(r"(?:https?:)?//[\w.]+", re.sub(r"^.*// .*$", "", content.decode()))
    assert set(links) <= {"http://www.w3.org"}  # the name of SVG, which nobody fetches


def test_the_number_of_open_pages_is_bounded(page):
    with ExitStack() as stack:
        most = int(STREAM_PART * MOST_CONNECTIONS)
        opened = [stack.enter_context(asked(page, "/events")) for _ in range(most)]
        assert {answer.status for answer in opened} == {200}
        assert stack.enter_context(asked(page, "/events")).status == 503
        assert stack.enter_context(asked(page, "/vehicles")).status == 200


@pytest.mark.parametrize(
    ("text", "address"),
    [("8080", ("127.0.0.1", 8080)), ("0.0.0.0:80", ("0.0.0.0", 80)), ("[::1]:80", ("::1", 80))],
)
def test_an_address_is_loopback_unless_another_is_given(text, address):
    assert parse_address(text) == address


def test_a_taken_port_is_named(page):
    with pytest.raises(InputError, match=rf"--web 127.0.0.1:{page.port}: .*in use"):
        open_page(str(page.port), "again")


@pytest.mark.skipif(browser.program() is None, reason="no Chromium")
def test_a_browser_shows_one_vehicle_or_all_and_what_is_stale(page, clock, tmp_path):
    """At a phone's size; screenshots go to the folder FUZZBEE_SCREENSHOTS."""
    folder = Path(os.environ.get("FUZZBEE_SCREENSHOTS", tmp_path))
    page.handle([Published(ONE, record(10, -20, 30)), Published(ONE, running())])
    with browser.page(f"http://127.0.0.1:{page.port}/", tmp_path / "profile") as seen:
        seen.resize(390, 844)
        seen.wait_for("globalThis.at && at('heading').textContent == '030°'")
        (folder / "web-one.png").write_bytes(seen.screenshot())
        shown = seen.value("at('one').innerText")
        assert seen.value("at('zenith').getAttribute('transform')") == "rotate(-10)"
        assert "TRUST vehicle 1 · running LOITER · armed" in " ".join(shown.split())
        assert all(each in shown for each in ("+10.0°", "−20.0°", "horizon ±1.0°"))
        assert seen.value("document.documentElement.scrollWidth") == 390
        assert seen.value("document.documentElement.scrollHeight") == 844
        turned = seen.value("at('world').getAttribute('transform')")
        assert turned.startswith("rotate(-10) translate(0 -64)")  # 20 degrees down
        seen.wait_for("!at('one').classList.contains('stale')")

        seen.resize(844, 390)
        seen.wait_for("innerWidth == 844")
        seen.wait_for("!at('world').getAttribute('transform').endsWith('-64)')")
        line = "document.querySelector('#world > path').getBoundingClientRect()"
        middle = seen.value(f"({line}.top + {line}.bottom) / 2")
        sky = seen.value("at('horizon').getBoundingClientRect().top")
        assert 0.0 < middle - sky < 40.0  # 20 degrees down, yet in sight
        seen.resize(390, 844)

        page.handle([Published(ONE, running(("clock_drift",)))])
        seen.wait_for("at('plates').innerText.endsWith('clock runs too fast or too slow')")
        assert seen.value("at('sigma').innerText") == "horizon unsure"
        imus = {"SCALED_IMU2": ImuDifference(3.14, 0.04)}
        page.handle([Published(ONE, running(other_imus=imus))])
        seen.wait_for("at('imus').innerText.endsWith('IMU 2: 3.1°, 0.0°/s')")
        assert "IMU 2 off by 3.1°" in seen.value("at('plates').innerText")
        (folder / "web-warned.png").write_bytes(seen.screenshot())
        assert seen.value("document.documentElement.scrollHeight") == 844

        clock[0] += 1.1  # the service has heard nothing of it since
        seen.wait_for("at('one').classList.contains('stale')")
        assert seen.value("at('age').textContent").startswith("stale, ")

        page.handle([Published(OTHER, record(1, 2, 3)), Published(OTHER, running(("<b>x</b>",)))])
        seen.value("at('back').click()")
        seen.wait_for("at('all').tBodies[0].rows.length == 2 && !at('all').hidden")
        (folder / "web-all.png").write_bytes(seen.screenshot())
        assert "unknown warnings" in seen.value("at('all').innerText")
        assert seen.value("document.documentElement.scrollWidth") == 390
        names = "[...at('all').tBodies[0].rows].map(each => each.className).join()"
        assert seen.value(names) == "stale,"

        page.close()
        seen.wait_for("at('gone').textContent.startsWith('no connection to fuzzbee')")
