"""Headless Chromium on a pipe of the DevTools protocol: https://chromedevtools.github.io/devtools-protocol/."""

import base64
import json
import os
import select
import shutil
import subprocess
import time
from contextlib import contextmanager

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless=new", "--remote-debugging-pipe", "--no-first-run", "--window-size=1280,800",
    "--no-sandbox",  # containers have none to offer
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist", "--disable-background-networking", "--disable-component-update",
)  # fmt: skip


def program():
    return next((found for name in PROGRAMS if (found := shutil.which(name))), None)


class Page:
    """One page of a browser."""

    def __init__(self, to_browser, from_browser):
        self._to, self._from = to_browser, from_browser
        self._pending = b""
        self._number = 0
        self._session = None

    def open(self, url):
        target = self.call("Target.createTarget", url=url)["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]

    def screenshot(self):
        """PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def resize(self, width, height):
        """As a phone of this size shows it."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": True}
        self.call("Emulation.setDeviceMetricsOverride", **size)

    def value(self, expression):
        """What a line of JavaScript gives."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait_for(self, expression, timeout_s=60.0):
        """The first value of an expression that is true."""
        end_s = time.monotonic() + timeout_s
        while not (value := self.value(expression)):
            assert time.monotonic() < end_s, expression
            time.sleep(0.05)
        return value

    def call(self, method, timeout_s=60.0, **parameters):
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        end_s = time.monotonic() + timeout_s
        while True:
            answer = self._next(end_s)
            if answer.get("id") == self._number:
                assert "error" not in answer, answer
                return answer["result"]

    def _next(self, end_s):
        while b"\0" not in self._pending:
            ready, _, _ = select.select([self._from], [], [], max(0.0, end_s - time.monotonic()))
            assert ready, "the browser does not answer"
            data = os.read(self._from, 1 << 20)
            assert data, "the browser has ended"
            self._pending += data
        message, self._pending = self._pending.split(b"\0", 1)
        return json.loads(message)


@contextmanager
def page(url, folder):
    """An open page; the browser ends with the context. ``folder`` is its profile."""
    read_by_it, to_it = os.pipe()
    from_it, written_by_it = os.pipe()

    def as_descriptors_3_and_4():
        os.dup2(read_by_it, 13)
        os.dup2(written_by_it, 14)
        os.dup2(13, 3)
        os.dup2(14, 4)

    process = subprocess.Popen(
        [program(), *FLAGS, f"--user-data-dir={folder}", "about:blank"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        preexec_fn=as_descriptors_3_and_4,  # noqa: PLW1509 - dup2 only
        close_fds=False,
        process_group=0,
    )
    os.close(read_by_it)
    os.close(written_by_it)
    try:
        made = Page(to_it, from_it)
        made.open(url)
        yield made
    finally:
        os.killpg(process.pid, 9)
        process.wait()
        os.close(to_it)
        os.close(from_it)
