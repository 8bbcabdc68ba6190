"""Fifty programs want the page at once: those that get it cost bounded memory, and none holds up another."""

from __future__ import annotations

import asyncio
import gc
import os
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from bokeh.document import Document
from test_scope_load import page
from test_scope_strangers import Intruder, Session, done
from tornado.websocket import WebSocketClientConnection

from canfb.bus.scope_server import MOST_PAGES
from scope_running import Running

CLIENTS, PULLED, ROUNDS = 50, 1, 2


def documents() -> int:
    """Of pages, in this process; each has most of the memory that a page costs."""
    gc.collect()
    return sum(type(one) is Document for one in gc.get_objects())


async def wanted(host: str, token: str) -> WebSocketClientConnection | None:
    """A websocket, None where it is refused."""
    intruder = Intruder(host)
    ticket = await intruder.ticket({"Authorization": f"Bearer {token}"})
    return await intruder.opened(ticket) if ticket else None


def test_fifty_pages_again_and_again_leave_no_memory_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Server and clients are in this process: what either keeps is seen."""
    monkeypatch.setattr("canfb.bus.scope_server.GONE_S", 2.0)
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
                left.append(documents())
                descriptors.append(len(os.listdir("/proc/self/fd")))
            assert left[-1] <= MOST_PAGES, left  # of the last ones at most: none of the round before
            assert descriptors[-1] <= descriptors[0] + 2, descriptors
            last = await page(where)
            await Session(last).pull()
            last.close()

        done(storm())
