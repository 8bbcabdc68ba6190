"""More programs than there are pages want one at once: those that get it leave no memory behind."""

from __future__ import annotations

import asyncio
import gc
import os
import weakref
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from bokeh.document import Document
from test_scope_load import page
from test_scope_strangers import Intruder, Session, done
from tornado.websocket import WebSocketClientConnection

from scope_running import Running

MOST_PAGES, CLIENTS, PULLED, ROUNDS = 4, 12, 1, 2  # a page costs half a second, whatever their number


@pytest.fixture
def documents(monkeypatch: pytest.MonkeyPatch) -> list[weakref.ref[Document]]:
    """Of pages, in this process; each has most of the memory that a page costs.

    They are noted as they are made: gc.get_objects() would hold tuples that other threads are still
    building, and these fail then.
    """
    made: list[weakref.ref[Document]] = []
    initialise = Document.__init__

    def noted(self: Document, *arguments: Any, **named: Any) -> None:
        initialise(self, *arguments, **named)
        made.append(weakref.ref(self))

    monkeypatch.setattr(Document, "__init__", noted)
    return made


async def wanted(host: str, token: str) -> WebSocketClientConnection | None:
    """A websocket, None where it is refused."""
    intruder = Intruder(host)
    ticket = await intruder.ticket({"Authorization": f"Bearer {token}"})
    return await intruder.opened(ticket) if ticket else None


def test_pages_again_and_again_leave_no_memory_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, documents: list[weakref.ref[Document]]
) -> None:
    """Server and clients are in this process: what either keeps is seen."""
    monkeypatch.setattr("canfb.scope.scope_server.GONE_S", 2.0)
    monkeypatch.setattr("canfb.scope.scope_server.MOST_PAGES", MOST_PAGES)
    running = Running(tmp_path, "--write")
    with running.started(monkeypatch) as address:
        where = urlsplit(address)

        async def storm() -> None:
            left, descriptors = [], []
            for _ in range(ROUNDS):
                asked = await asyncio.gather(*(wanted(where.netloc, where.fragment) for _ in range(CLIENTS)))
                opened = [one for one in asked if one is not None]
                assert 1 <= len(opened) <= MOST_PAGES
                for one in opened[:PULLED]:
                    await Session(one).pull()
                for one in opened:
                    one.close()
                (context,) = running.servers[0]._server._tornado._applications.values()
                while context._sessions:  # a session outlasts its websocket for a while
                    await asyncio.sleep(0.1)
                gc.collect()
                left.append(sum(one() is not None for one in documents))
                descriptors.append(len(os.listdir("/proc/self/fd")))
            assert left[-1] <= MOST_PAGES < len(documents), (
                left
            )  # of the last ones at most: none of the round before
            assert descriptors[-1] <= descriptors[0] + 2, descriptors
            last = await page(where)
            await Session(last).pull()
            last.close()

        done(storm())
