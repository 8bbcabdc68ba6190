"""A headless Chromium, driven through its DevTools protocol; every request that it makes is noted."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

from tornado.websocket import WebSocketClientConnection, websocket_connect

NAMES = ("chromium", "chromium-browser", "google-chrome")
PATIENCE_S = 180.0
# Through all shadow roots, which Bokeh's parts have.
DEEP = """
const walk = (node) => { const found = []; const go = (one) => { found.push(one);
  if (one.shadowRoot) go(one.shadowRoot); for (const child of one.children || []) go(child); };
  go(node); return found; };
const all = walk(document.documentElement);
"""
# What the browser answers when a page is left while an expression is evaluated in it.
LEFT = ("navigated or closed", "context was destroyed", "Cannot find context")
SEEN_BUTTONS = "all.filter(one => one.tagName === 'BUTTON' && one.checkVisibility())"


class PageLeft(Exception):
    """The page was left while a command was carried out in it."""


class Chromium:
    """Use it as a context manager; ``folder`` holds its profile."""

    def __init__(self, folder: Path) -> None:
        program = next((found for name in NAMES if (found := shutil.which(name))), None)
        assert program, "chromium is needed: apt-get install chromium"
        self._folder = folder
        self._loop = asyncio.new_event_loop()
        self._child = subprocess.Popen(
            [
                program, "--headless=new", "--remote-debugging-port=0", f"--user-data-dir={folder}",
                "--no-first-run", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
                "--disable-background-networking", "--disable-component-update", "--disable-sync",
                "--disable-quic",
                "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1, EXCLUDE localhost",
                "about:blank",
            ],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            env={**os.environ, "HOME": str(folder)},
        )  # fmt: skip
        self._socket: WebSocketClientConnection
        self._number = 0
        self.events: list[dict[str, Any]] = []

    def __enter__(self) -> Self:
        port_file = self._folder / "DevToolsActivePort"
        self._until(port_file.exists, "DevTools")
        self._until(lambda: port_file.read_text().count("\n") >= 1, "DevTools")
        port, path = port_file.read_text().splitlines()[:2]
        self._socket = self._loop.run_until_complete(_connected(f"ws://127.0.0.1:{port}{path}"))
        self._session: str | None = None
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
            self._loop.run_until_complete(self._close())
            self._loop.close()

    async def _close(self) -> None:
        self._socket.close()

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """A command of the protocol; its result."""
        return self._loop.run_until_complete(asyncio.wait_for(self._call(method, params), PATIENCE_S))

    async def _call(self, method: str, params: dict[str, Any]) -> dict[str, Any]:
        self._number += 1
        message = {"id": self._number, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        number = self._number
        await self._socket.write_message(json.dumps(message))
        while True:
            text = await self._socket.read_message()
            assert text is not None, "the browser has gone"
            answer = json.loads(text)
            if answer.get("id") == number:
                if any(words in str(answer.get("error", "")) for words in LEFT):
                    raise PageLeft(answer["error"])
                assert "error" not in answer, (method, answer["error"])
                return answer["result"]
            self.events.append(answer)

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

    def text(self) -> str:
        """All visible text of the page, that in shadow roots too."""
        return self.look(
            f"(() => {{ {DEEP} return all.filter(one => !['STYLE', 'SCRIPT'].includes(one.tagName))"
            ".flatMap(one => [...one.childNodes]).filter(one => one.nodeType === Node.TEXT_NODE)"
            ".map(one => one.data).join('\\n') })()"
        )

    def texts(self, selector: str) -> list[str]:
        """Of each element with this selector, wherever it is, its text."""
        return self.look(
            f"(() => {{ {DEEP} return all.filter(one => one.matches && one.matches({json.dumps(selector)}))"
            ".map(one => one.textContent) })()"
        )

    def buttons(self) -> list[str]:
        """Labels of the buttons that can be seen."""
        return self.look(f"(() => {{ {DEEP} return {SEEN_BUTTONS}.map(one => one.textContent.trim()) }})()")

    def press(self, label: str) -> None:
        """Press the button with this label, as soon as it can be pressed."""
        pressed = (
            f"(() => {{ {DEEP} const one = {SEEN_BUTTONS}.find(one => !one.disabled && "
            f"one.textContent.trim() === {json.dumps(label)}); if (one) one.click(); return !!one }})()"
        )
        self.wait_for(lambda: self.look(pressed), f"button {label}")

    def choose_file(self, path: Path) -> None:
        """Choose a file in the first file input of the page."""
        found = self.call(
            "Runtime.evaluate",
            expression=f"(() => {{ {DEEP} return all.find(one => one.type === 'file') }})()",
        )
        self.call("DOM.setFileInputFiles", files=[str(path)], objectId=found["result"]["objectId"])

    def type_in(self, label: str, text: str) -> None:
        """Type into the field with this label, and leave it."""
        found = (
            f"all.find(one => one.tagName === 'INPUT' && one.checkVisibility() && "
            f"one.getRootNode().textContent.includes({json.dumps(label)}))"
        )
        self.wait_for(
            lambda: self.look(f"(() => {{ {DEEP} const one = {found}; one?.focus(); return !!one }})()"),
            label,
        )
        self.call("Input.insertText", text=text)
        self.look(f"(() => {{ {DEEP} {found}.blur() }})()")

    def go(self, address: str) -> None:
        """Open an address; wait until it is loaded."""
        self.call("Page.navigate", url="about:blank")  # the page before, whose server is gone, may complain
        self.wait_for(lambda: self.look("location.href") == "about:blank", "empty page")
        self.events.clear()
        self.call("Page.navigate", url=address)
        self.wait_for(lambda: self.look("document.readyState") == "complete", address)

    def wait_for(self, true: Callable[[], Any], what: str) -> None:
        """Until it is true; a failure, which shows the page, after PATIENCE_S."""
        self._until(
            true, what, lambda: self.text() + str([e for e in self.events if "exception" in str(e).lower()])
        )

    def _until(self, true: Callable[[], Any], what: str, shown: Callable[[], str] = str) -> None:
        end = time.monotonic() + PATIENCE_S
        while not true():
            assert time.monotonic() < end, f"no {what}; the page has:\n{shown()}"
            assert self._child.poll() is None, f"the browser has ended: {self._child.returncode}"
            self._loop.run_until_complete(asyncio.sleep(0.05))

    def addresses(self) -> list[str]:
        """What was asked for since the last :meth:`go`, websockets too."""
        told = [event["params"] for event in self.events]
        return [one["request"]["url"] for one in told if "request" in one and "url" in one["request"]] + [
            event["params"]["url"] for event in self.events if event["method"] == "Network.webSocketCreated"
        ]

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


async def _connected(address: str) -> WebSocketClientConnection:
    return await websocket_connect(address, max_message_size=1 << 27)
