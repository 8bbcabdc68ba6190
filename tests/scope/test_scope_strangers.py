"""Who is kept away from ``canfb scope``: other servers in the same browser, and other programs."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import socket
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Self
from urllib.parse import urlsplit

import pytest
from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.websocket import WebSocketClientConnection, websocket_connect

from canfb.scope.desk import TaskResult
from canfb.scope.gate import MOST_WRONG
from chromium import Chromium
from scope_running import LINES_S, Running

SAVED, STAGED = (0x2020, 6), (0x2020, 2)
PATIENT: Any = {"connect_timeout": LINES_S, "request_timeout": LINES_S}  # a busy machine is no finding


class Spy(ThreadingHTTPServer):
    """Another server of this computer, at another port of 127.0.0.1; it notes all that browsers send."""

    daemon_threads = True

    def __init__(self) -> None:
        self.got: list[str] = []

        class Noting(BaseHTTPRequestHandler):
            def do_GET(handler) -> None:
                self.got.append(f"{handler.requestline}\n{handler.headers}")
                handler.send_response(200)
                handler.send_header("Content-Type", "text/html")
                handler.send_header("Set-Cookie", "planted=1")  # browsers keep it, and send it to every port
                handler.end_headers()
                handler.wfile.write(b"<title>spy</title><p>spy</p>")

            def log_message(handler, *_: object) -> None:
                pass

        super().__init__(("127.0.0.1", 0), Noting)
        self.address = f"http://127.0.0.1:{self.server_port}"

    @contextlib.contextmanager
    def listening(self) -> Iterator[Self]:
        thread = threading.Thread(target=self.serve_forever)
        thread.start()
        try:
            yield self
        finally:
            self.shutdown()
            thread.join()
            self.server_close()


class Intruder:
    """A program that speaks Bokeh's protocol, with whatever headers it likes."""

    def __init__(self, host: str) -> None:
        self.host = host
        self.origin = {"Origin": f"http://{host}"}  # forged: programs say what they like

    async def ticket(self, headers: dict[str, str]) -> str:
        """What the server answers to these headers; empty for a refusal."""
        request = HTTPRequest(
            f"http://{self.host}/session", "POST", body="", headers={**self.origin, **headers}, **PATIENT
        )
        try:
            return (await AsyncHTTPClient().fetch(request)).body.decode()
        except HTTPClientError as refused:
            if refused.code != 403:
                raise
            return ""

    async def opened(
        self, ticket: str, headers: dict[str, str] | None = None
    ) -> WebSocketClientConnection | None:
        """The websocket, None where it is refused."""
        headers = {**self.origin, **(headers or {})}
        request = HTTPRequest(f"ws://{self.host}/live/ws", headers=headers, **PATIENT)
        try:
            return await websocket_connect(request, subprotocols=["bokeh", ticket])
        except HTTPClientError as refused:
            if refused.code != 403:
                raise
            return None


class Session:
    """One open websocket of Bokeh, with the models of its document by name."""

    def __init__(self, connection: WebSocketClientConnection) -> None:
        self._connection = connection
        self._models: dict[str, str] = {}

    async def pull(self) -> None:
        """Wait for the ACK, and get the document."""
        await self._message("ACK")
        await self._send("PULL-DOC-REQ", {})
        self._find(await self._message("PULL-DOC-REPLY"))

    async def click(self, name: str) -> None:
        event = {"type": "event", "name": "button_click"}
        values = {"type": "map", "entries": [["model", {"id": self._models[name]}]]}
        await self._patch(kind="MessageSent", msg_type="bokeh_event", msg_data={**event, "values": values})

    async def set(self, name: str, attribute: str, value: object) -> None:
        await self._patch(kind="ModelChanged", model={"id": self._models[name]}, attr=attribute, new=value)

    async def _patch(self, **event: Any) -> None:
        await self._send("PATCH-DOC", {"events": [event]})
        await self._message("OK")

    async def _send(self, kind: str, content: Any) -> None:
        for part in ({"msgid": "1", "msgtype": kind}, {}, content):
            await self._connection.write_message(json.dumps(part))

    async def _message(self, kind: str) -> Any:
        while True:
            parts = [await self._connection.read_message() for _ in range(3)]
            assert None not in parts, f"closed before {kind}"
            header, _, content = (json.loads(part or "null") for part in parts)
            for _ in range(2 * header.get("num_buffers", 0)):
                await self._connection.read_message()
            if header["msgtype"] == kind:
                return content

    def _find(self, part: Any) -> None:
        if isinstance(part, dict):
            if "id" in part and isinstance(name := part.get("attributes", {}).get("name"), str):
                self._models[name] = part["id"]
            part = list(part.values())
        if isinstance(part, list):
            for one in part:
                self._find(one)


def done(act: Any) -> Any:
    """In a loop of its own."""
    loop = asyncio.new_event_loop()
    with contextlib.closing(loop):
        return loop.run_until_complete(asyncio.wait_for(act, LINES_S))


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    with Chromium(tmp_path_factory.mktemp("chromium")) as browser:
        yield browser


def opened(browser: Chromium, address: str) -> None:
    browser.go(address)
    browser.wait_for(lambda: browser.look("document.body.dataset.ready"), "page")


def answer(address: str, request: str) -> str:
    """The first line that the server answers, and its headers."""
    where = urlsplit(address)
    with socket.create_connection((where.hostname, where.port), LINES_S) as connection:
        connection.sendall(request.replace("\n", "\r\n").encode() + b"\r\n\r\n")
        received = b""
        while b"\r\n\r\n" not in received and (part := connection.recv(65536)):
            received += part
    return received.partition(b"\r\n\r\n")[0].decode()


TRIES = """(async (host) => {
  const got = [];
  const note = async (name, act) => {
    try { const one = await act(); if (one) got.push([name, one]); } catch {}
  };
  const text = (how) => async () =>
    (await fetch(`http://${host}/session`, {method: 'POST', credentials: 'include', ...how})).text();
  const element = (kind, path, look) => () => new Promise(done => {
    const one = document.createElement(kind);
    one.src = `http://${host}/${path}`;
    one.onload = () => { try { done(look(one)); } catch { done(''); } };
    one.onerror = () => done('');
    document.body.append(one);
  });
  await note('post', text({}));
  await note('post with a token', text({headers: {Authorization: 'Bearer x'}}));
  await note('blind post', text({mode: 'no-cors'}));
  await note('page', async () => (await fetch(`http://${host}/`, {credentials: 'include'})).text());
  await note('websocket', () => new Promise(done => {
    const one = new WebSocket(`ws://${host}/live/ws`, ['bokeh', 'x']);
    one.onopen = () => done('open');
    one.onerror = () => done('');
  }));
  await note('script', element('script', 'scope.js', () => 'loaded'));
  await note('frame', element('iframe', '', one => one.contentDocument.body.innerText));
  await note('storage', () => Object.entries({...sessionStorage, ...localStorage}).join());
  await note('referrer', () => document.referrer.includes('#') ? document.referrer : '');
  await note('opener', () => window.opener ? 'opener' : '');
  return [got, document.cookie];
})"""


def test_a_server_at_another_port_gets_nothing_from_the_same_browser(
    browser: Chromium, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Visited before, between and after; a program with all that it got and a forged origin is refused."""
    running = Running(tmp_path, "--write")
    with running.started(monkeypatch) as address, Spy().listening() as spy:
        host, token = urlsplit(address).netloc, urlsplit(address).fragment
        browser.go(spy.address)
        opened(browser, address)
        (sent,) = [
            event["params"]["request"]["headers"]
            for event in browser.events
            if event["method"] == "Network.webSocketWillSendHandshakeRequest"
        ]
        ticket = sent["Sec-WebSocket-Protocol"].rpartition(" ")[2]
        assert len(ticket) > 64
        browser.look(f"location.href = '{spy.address}/linked'")
        browser.wait_for(lambda: browser.look("location.pathname") == "/linked", "linked page")
        got, cookies = browser.look(f"{TRIES}('{host}')")
        assert got == []
        assert cookies == "planted=1"
        assert {one["name"] for one in browser.call("Network.getAllCookies")["cookies"]} == {"planted"}
        assert len(spy.got) >= 2
        heard = "".join(spy.got)
        for secret in (token, ticket, running.code, running.code.replace("-", "")):
            assert secret not in heard
        opened(browser, f"http://{host}/")  # the page comes back without the address: by what its tab has
        browser.go("about:blank")
        assert_refused(host, heard, ticket)
        entry = running.networks[0].module.dictionary.entry
        assert (entry(*SAVED).value, entry(*STAGED).value) == (0, 0)


def assert_refused(host: str, heard: str, ticket: str) -> None:
    """With each word that the other server has heard, and with a ticket that was used."""
    intruder = Intruder(host)
    words = {*re.findall(r"[^\s;,]+", heard), "", "x", ticket, f"canfb-scope-{host.rpartition(':')[2]}"}

    async def tries() -> None:
        for word in words:
            for name in ("Authorization", "Cookie", "Referer"):
                assert (
                    await intruder.ticket({name: f"Bearer {word}" if name == "Authorization" else word}) == ""
                )
        for used in (ticket, "eyJzZXNzaW9uX2lkIjogIngifQ", "x"):
            assert await intruder.opened(used) is None

    done(tries())


def test_with_the_token_alone_nobody_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A program that has read the address over somebody's shoulder: it sees, and does not write."""
    running = Running(tmp_path, "--write")

    async def tries(host: str, token: str, codes: list[str]) -> None:
        intruder = Intruder(host)
        ticket = await intruder.ticket({"Authorization": f"Bearer {token}"})
        connection = await intruder.opened(ticket)
        assert connection is not None
        assert await intruder.opened(ticket) is None  # once
        session = Session(connection)
        await session.pull()
        for code in codes:
            await session.set("Save", "disabled", value=False)
            await session.click("Save")
            await session.set("code", "value", code)
            await session.click("yes")
        connection.close()

    with running.started(monkeypatch) as address:
        where = urlsplit(address)
        begun: list[object] = []
        desk = running.parts[0]._desk
        monkeypatch.setattr(desk, "_run", lambda *what: begun.append(what))
        desk.end(TaskResult(True, []))
        done(tries(where.netloc, where.fragment, ["", "AAAA-AAAA"]))
        assert begun == []
        done(tries(where.netloc, where.fragment, [running.code]))
        assert len(begun) == 1  # the same with the code: what was refused was a real task
        desk.end(TaskResult(True, []))
        done(tries(where.netloc, where.fragment, ["AAAA-AAAA"] * MOST_WRONG + [running.code]))
        assert len(begun) == 1


def test_what_was_right_at_the_last_start_is_wrong_at_this_one(
    browser: Chromium, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Running(tmp_path).started(monkeypatch) as address:
        opened(browser, address)
        browser.go("about:blank")
    port = str(urlsplit(address).port)
    with monkeypatch.context() as patched, Running(tmp_path, "--port", port).started(patched) as other:
        browser.go(address)
        browser.wait_for(lambda: "has printed at its last start" in browser.text(), "refusal")
        browser.go("about:blank")
        opened(browser, other)  # and the new one replaces it
        browser.go("about:blank")


def test_requests_of_strangers_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Running(tmp_path).started(monkeypatch) as address:
        where = urlsplit(address)
        host, kept = where.netloc, f"Cookie: canfb-scope-{where.port}={where.fragment}"
        page = answer(address, f"GET / HTTP/1.1\nHost: {host}")
        assert page.startswith("HTTP/1.1 200")
        assert "Set-Cookie" not in page
        assert "script-src 'self';" in page
        assert "frame-ancestors 'none'" in page
        websocket = (
            f"GET /live/ws HTTP/1.1\nHost: {host}\n{kept}\nUpgrade: websocket\nConnection: Upgrade\n"
            "Sec-WebSocket-Version: 13\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="
        )
        bearer = f"Authorization: Bearer {where.fragment}\nContent-Length: 0"
        for refused in (
            f"GET /live HTTP/1.1\nHost: {host}\n{kept}",
            f"GET /?token={where.fragment} HTTP/1.1\nHost: evil.example",
            f"GET /live/autoload.js?bokeh-autoload-element=x HTTP/1.1\nHost: {host}",
            f"POST / HTTP/1.1\nHost: {host}\nContent-Length: 0\n{kept}",
            f"POST /session HTTP/1.1\nHost: {host}\n{bearer}",
            f"POST /session HTTP/1.1\nHost: {host}\nOrigin: http://evil.example\n{bearer}",
            f"POST /session HTTP/1.1\nHost: localhost:{where.port}\nOrigin: http://{host}\n{bearer}",
            websocket,
            f"{websocket}\nOrigin: http://{host}",
            f"{websocket}\nOrigin: http://{host}\nSec-WebSocket-Protocol: bokeh, {where.fragment}",
        ):
            assert answer(address, refused).startswith("HTTP/1.1 403"), refused
        good = answer(address, f"POST /session HTTP/1.1\nHost: {host}\nOrigin: http://{host}\n{bearer}")
        assert good.startswith("HTTP/1.1 200")
