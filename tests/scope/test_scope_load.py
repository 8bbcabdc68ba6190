"""``canfb scope`` under load and attack: many pages, large and broken messages, silent peers, a long day."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path
from urllib.parse import SplitResult, urlsplit

import pytest
from bokeh.document import Document
from test_scope_strangers import Intruder, Session, done
from tornado.websocket import WebSocketClientConnection, WebSocketClosedError

from canfb.monitoring.lines import MachineUnits
from canfb.scope.desk import Desk, allowed_tasks
from canfb.scope.gate import SESSION
from canfb.scope.scope_page import LARGEST_MESSAGE, ScopePage
from canfb.scope.scope_server import LONGEST_LINE, NOISY, _OneCollection
from canfb.scope.traces import MOST_POINTS, BusTraces
from monitored_network import NODE, MonitoredNetwork
from scope_running import LINES_S, Running

ALIKE, MOST_WAITING = 20, 1_000_000  # looks; bytes, of one update


def attacked(
    folder: Path, monkeypatch: pytest.MonkeyPatch, act: Callable[[SplitResult], Awaitable[None]]
) -> None:
    """Do it to a running scope; then a new page lives."""
    with Running(folder, "--write").started(monkeypatch) as address:
        where = urlsplit(address)

        async def attack() -> None:
            await act(where)
            connection = await page(where)
            await Session(connection).pull()
            connection.close()

        done(attack())


async def page(where: SplitResult) -> WebSocketClientConnection:
    """A page that is opened; the websocket of a program in place of a browser."""
    intruder = Intruder(where.netloc)
    for _ in range(200):
        ticket = await intruder.ticket({"Authorization": f"Bearer {where.fragment}"})
        connection = await intruder.opened(ticket) if ticket else None
        if connection is not None:
            return connection
        await asyncio.sleep(0.1)  # until those that were closed are gone
    raise AssertionError("no page can be opened")


async def judged(connection: WebSocketClientConnection) -> None:
    """Wait until the server has closed it, or goes on with it."""
    with contextlib.suppress(WebSocketClosedError):
        for part in ({"msgid": "2", "msgtype": "PULL-DOC-REQ"}, {}, {}):
            await connection.write_message(json.dumps(part))
    while (heard := await connection.read_message()) is not None and "PULL-DOC-REPLY" not in str(heard):
        pass
    connection.close()


def test_pages_are_bounded_and_the_next_one_is_told_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bound = 3  # in place of MOST_PAGES: each page costs half a second
    monkeypatch.setattr("canfb.scope.scope_server.MOST_PAGES", bound)

    async def many(where: SplitResult) -> None:
        spare = Intruder(where.netloc)
        tickets = [await spare.ticket({"Authorization": f"Bearer {where.fragment}"}) for _ in range(3)]
        pages = [await page(where) for _ in range(bound)]
        for one in pages:
            await Session(one).pull()
        text = (
            f"POST {SESSION} HTTP/1.1\r\nHost: {where.netloc}\r\nOrigin: http://{where.netloc}\r\n"
            f"Authorization: Bearer {where.fragment}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
        )
        reader, writer = await asyncio.open_connection(where.hostname, where.port)
        writer.write(text.encode())
        answer = await reader.read()
        assert b"403" in answer
        assert f"{bound} pages are open: close one".encode() in answer
        writer.close()
        assert await spare.opened(tickets[0]) is None  # nor with a ticket of before
        for one in pages:
            one.close()

    attacked(tmp_path, monkeypatch, many)


def test_what_is_too_large_or_broken_ends_its_own_connection(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Other pages live on, and no message fills the terminal."""
    nested = "[" * 100_000 + "]" * 100_000
    header = json.dumps({"msgid": "1", "msgtype": "PATCH-DOC"})
    broken: list[list[str | bytes]] = [
        ["x" * (LARGEST_MESSAGE + 1)],
        [b"\0" * (LARGEST_MESSAGE + 1)],
        ["no JSON", "{}", "{}"],
        [header, "{}", nested],
        [header, "{}", json.dumps({"events": [{"kind": "Nonsense"}]})],
        [header, "{}", json.dumps({"events": 7})],
        [b"\xff\xfe", "{}", "{}"],
        [json.dumps({"msgid": "1", "msgtype": "PULL-DOC-REPLY"}), "{}", "{}"],
        [json.dumps({"msgid": "1", "msgtype": "PUSH-DOC"}), "{}", json.dumps({"doc": {"roots": 1}})],
    ]

    async def attack(where: SplitResult) -> None:
        other = Session(await page(where))
        await other.pull()
        for parts in broken:
            connection = await page(where)
            with contextlib.suppress(WebSocketClosedError):
                for part in parts:
                    await connection.write_message(part, binary=isinstance(part, bytes))
            await judged(connection)
        await other.click("Save")

    attacked(tmp_path, monkeypatch, attack)
    said = [record for record in caplog.records if record.name in NOISY]
    assert said
    assert all(len(one.getMessage()) < 2 * LONGEST_LINE and not one.exc_info for one in said)


def test_bodies_and_heads_that_are_too_large_are_not_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of anybody, before a secret is asked for: nothing of them is kept."""

    async def attack(where: SplitResult) -> None:
        head = f"POST {SESSION} HTTP/1.1\r\nHost: {where.netloc}\r\n"
        for text in (
            f"{head}Content-Length: 100000000\r\n\r\n",
            f"{head}Transfer-Encoding: chunked\r\n\r\nffffff\r\n",
            f"GET / HTTP/1.1\r\nHost: {where.netloc}\r\nX: {'x' * 1_000_000}\r\n\r\n",
            "\x16\x03\x01\x02\x00\x01",
        ):
            reader, writer = await asyncio.open_connection(where.hostname, where.port)
            try:
                writer.write(text.encode() + bytes(100_000))
                await writer.drain()
                answer = await reader.read()
            except OSError:
                answer = b""
            assert answer[:12] in (b"", b"HTTP/1.1 400", b"HTTP/1.1 403")
            writer.close()

    attacked(tmp_path, monkeypatch, attack)


def test_a_peer_that_does_not_read_costs_no_memory_and_does_not_hold_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bokeh waits for the peer before it makes the next update: what is written and not read is bounded."""
    monkeypatch.setattr("canfb.scope.scope_server.UPDATE_MS", 1)
    running = Running(tmp_path, "--write")
    with running.started(monkeypatch) as address:
        where = urlsplit(address)

        async def attack() -> None:
            ticket = await Intruder(where.netloc).ticket({"Authorization": f"Bearer {where.fragment}"})
            key = "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="
            with socket.create_connection((where.hostname, where.port), LINES_S) as silent:
                silent.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                silent.sendall(
                    f"GET /live/ws HTTP/1.1\r\nHost: {where.netloc}\r\nOrigin: http://{where.netloc}\r\n"
                    f"Upgrade: websocket\r\nConnection: Upgrade\r\n{key}\r\n"
                    f"Sec-WebSocket-Protocol: bokeh, {ticket}\r\n\r\n".encode()
                )
                clients = running.servers[0]._server._tornado._clients
                while not clients:
                    await asyncio.sleep(0.01)
                (client,) = clients
                stream = client._socket.ws_connection.stream
                waiting: list[int] = []
                while not (len(waiting) > ALIKE and waiting[-1] and len({*waiting[-ALIKE:]}) == 1):
                    waiting.append(len(stream._write_buffer))  # behind the full buffers of the kernel
                    await asyncio.sleep(0.05)
                assert max(waiting) < MOST_WAITING

        done(attack())


def test_a_day_on_one_page_leaves_nothing_behind() -> None:
    """Many updates, in simulated time, after the histories are full: models and what is kept stay as many."""
    network, document, traces = MonitoredNetwork(), Document(), BusTraces()
    desk = Desk(lambda *what: None, allowed_tasks(asks=True, writes=True))
    shown = ScopePage(document, traces, desk, MachineUnits(), NODE)
    network.run(0.5)
    snapshot, sizes = network.model.snapshot(network.bus.now), []
    for turn in range(3):
        for step in range(MOST_POINTS):
            traces.take(replace(snapshot, time_s=(turn * MOST_POINTS + step) * 0.2))
            if step % 40 == 0:
                shown.update()
        sizes.append((len(list(document.models)), len(traces.modules[NODE].points)))
    assert sizes[0] == sizes[1] == sizes[2]


def test_pages_that_are_closed_together_are_one_collection(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bokeh asks for one at the end of each; no other thread runs meanwhile, that of the bus included."""
    monkeypatch.setattr("canfb.scope.scope_server.COLLECT_S", 0.01)
    collections: list[str] = []
    monkeypatch.setattr("canfb.scope.scope_server.gc.collect", lambda: collections.append("one"))
    loop = asyncio.new_event_loop()
    with contextlib.closing(loop), _OneCollection(loop):
        for turn in (1, 2):
            for _ in range(5):
                page_document = Document()
                session = object()
                page_document.on_change_dispatch_to(session)
                page_document.destroy(session)
            assert len(collections) == turn - 1
            loop.run_until_complete(asyncio.sleep(0.05))
            assert len(collections) == turn
