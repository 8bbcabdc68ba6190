"""A headless Chromium, driven through the pipe of its DevTools protocol; its requests are noted."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import select
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

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

    def addresses(self) -> list[str]:
        """What was asked for since the last :meth:`go`."""
        told = [event["params"] for event in self.events]
        return [one["request"]["url"] for one in told if "request" in one and "url" in one["request"]]

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
