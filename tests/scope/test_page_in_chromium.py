"""The page in a real browser: each picture is drawn, it follows the module, and only this server is asked."""

import base64
import contextlib
import json
import os
import select
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Self

import pytest

from processes import Process, Started

NAMES = ("chromium", "chromium-browser", "google-chrome")
PATIENCE_S = 180.0
# What the browser answers when a page is left while an expression is evaluated in it.
LEFT = ("navigated or closed", "context was destroyed", "Cannot find context")


class PageLeft(Exception):
    """The page was left while a command was carried out in it."""


class Chromium:
    """Use it as a context manager; ``folder`` holds its profile."""

    def __init__(self, folder: Path) -> None:
        program = next((found for name in NAMES if (found := shutil.which(name))), None)
        assert program, "chromium is needed: apt-get install chromium"
        commands, self._commands = os.pipe()
        self._answers, answers = os.pipe()
        # The browser reads commands from descriptor 3 and answers at 4.
        line = 'exec 3<&"$1" 4>&"$2"; shift 2; exec "$@"'
        self._child = subprocess.Popen(
            [
                "bash", "-c", line, "bash", str(commands), str(answers),
                program, "--headless=new", "--remote-debugging-pipe", f"--user-data-dir={folder}",
                "--no-first-run", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
                "--disable-background-networking", "--disable-component-update", "--disable-sync",
                "--disable-quic",
                "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1, EXCLUDE localhost",
                "about:blank",
            ],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            env={**os.environ, "HOME": str(folder)}, pass_fds=(commands, answers),
        )  # fmt: skip
        os.close(commands)
        os.close(answers)
        self._number = 0
        self._read = b""
        self._session: str | None = None
        self.events: list[dict[str, Any]] = []

    def __enter__(self) -> Self:
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Network", "Runtime", "Log"):
            self.call(f"{domain}.enable")
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._session = None
            self.call("Browser.close")
            self._child.wait(PATIENCE_S)
        finally:
            self._child.kill()
            self._child.wait()
            os.close(self._commands)
            os.close(self._answers)

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """A command of the protocol; its result."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._commands, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                if any(words in str(answer.get("error", "")) for words in LEFT):
                    raise PageLeft(answer["error"])
                assert "error" not in answer, (method, answer["error"])
                return answer["result"]
            self.events.append(answer)

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._read:
            ready, _, _ = select.select([self._answers], [], [], PATIENCE_S)
            assert ready, "the browser does not answer"
            data = os.read(self._answers, 1 << 16)
            assert data, "the browser has gone"
            self._read += data
        text, _, self._read = self._read.partition(b"\0")
        return json.loads(text)

    def look(self, expression: str) -> Any:
        """The value of a JavaScript expression, or of a promise; in the next page, if this one is left."""
        done: dict[str, Any] = {}
        while not done:
            with contextlib.suppress(PageLeft):
                done = self.call(
                    "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
                )
        assert "exceptionDetails" not in done, done["exceptionDetails"]
        return done["result"].get("value")

    def text(self, selector: str = "body") -> str:
        """What can be read of the first element with this selector."""
        return self.look(f"document.querySelector({json.dumps(selector)}).innerText")

    def go(self, address: str) -> None:
        """Open an address; wait until it is loaded."""
        self.call("Page.navigate", url="about:blank")  # the page before, whose server is gone, may complain
        self.wait_for(lambda: self.look("location.href") == "about:blank", "empty page")
        self.events.clear()
        self.call("Page.navigate", url=address)
        self.wait_for(lambda: self.look("document.readyState") == "complete", address)

    def wait_for(self, true: Callable[[], Any], what: str) -> None:
        """Until it is true; a failure, which shows the page, after PATIENCE_S."""
        end = time.monotonic() + PATIENCE_S
        while not true():
            assert time.monotonic() < end, f"no {what}; the page has:\n{self.text()}\n{self.complaints()}"
            assert self._child.poll() is None, f"the browser has ended: {self._child.returncode}"
            select.select([self._answers], [], [], 0.05)

    def complaints(self) -> list[str]:
        """Errors on the console, exceptions and violations of the content policy."""
        found = []
        for event in self.events:
            params = event["params"]
            if event["method"] == "Runtime.exceptionThrown":
                found.append(str(params["exceptionDetails"]))
            if event["method"] == "Log.entryAdded" and params["entry"]["level"] == "error":
                found.append(str(params["entry"]))
            if event["method"] == "Runtime.consoleAPICalled" and params["type"] == "error":
                found.append(str(params["args"]))
        return found

    def size(self, width: int, height: int, *, dark: bool = False) -> None:
        """The window, pixels, and the colour scheme."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )
        value = "dark" if dark else "light"
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": value}])

    def picture(self) -> bytes:
        """What can be seen, as PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])


PICTURES = ("position", "velocity", "residual", "amplitude", "faults", "deviation")
# How many pixels of a canvas are not empty.
DRAWN = """(() => { const one = document.querySelector('%s');
  const data = one.getContext('2d').getImageData(0, 0, one.width, one.height).data; let drawn = 0;
  for (let n = 3; n < data.length; n += 4) drawn += data[n] > 0; return drawn })()"""


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Chromium]:
    with Chromium(tmp_path) as one:
        yield one


@pytest.fixture
def page(started: Started) -> Process:
    return started(sys.executable, "-m", "canfb", "try")


def test_the_page(browser: Chromium, page: Process) -> None:
    address = page.wait_for("^open http").split()[1]
    server = address.partition("#")[0]
    browser.size(1400, 1900)
    browser.go(server)
    browser.wait_for(lambda: "Open the address printed at the last start" in browser.text("#lost"), "refusal")
    browser.go(address)
    browser.wait_for(lambda: "with the active" in browser.text("#deviation"), "legend")
    browser.wait_for(lambda: "% rms" in browser.text("#curve"), "deviation of a machine that turns")
    assert browser.text("#curve").startswith("no table is active: ")
    assert browser.look("location.hash") == ""
    assert "node 32 (20h) OPERATIONAL" in browser.text("#name")
    assert "PDO mapping: module" in browser.text("#mapping")
    assert "valid" in browser.text("#lines")
    assert "lost" in browser.text("#counters")
    assert browser.look(DRAWN % "#tracks") > 1000
    for name in PICTURES:
        assert browser.look(DRAWN % f"#{name} canvas") > 500, name
    looks = browser.look("document.body.dataset.looks")
    browser.wait_for(lambda: browser.look("document.body.dataset.looks") != looks, "next look")
    colours = []
    for dark in (False, True):
        browser.size(1400, 1900, dark=dark)
        assert len(browser.picture()) > 50_000, "bytes: no empty page"
        colours.append(browser.look("getComputedStyle(document.body).backgroundColor"))
    assert colours == ["rgb(243, 245, 246)", "rgb(13, 17, 23)"]
    browser.size(400, 800)
    browser.wait_for(lambda: browser.look("document.documentElement.scrollWidth") <= 400, "narrow page")
    asked = [event["params"].get("request", {}).get("url", server) for event in browser.events]
    assert all(one.startswith((server, "data:")) for one in asked)
    assert [one for one in browser.complaints() if "403" not in one] == []
    page.stop()
    browser.wait_for(lambda: "The connection to canfb is lost" in browser.text("#lost"), "note at the end")
