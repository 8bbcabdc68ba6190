"""What a browser may send over the websocket of a page: values and buttons, and not without end."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import SplitResult

import pytest
from test_scope_load import attacked, page
from test_scope_strangers import Session
from tornado.websocket import WebSocketClosedError

from canfb.scope.scope_server import MOST_EVENTS, refusal
from scope_running import LINES_S

CHANGED = {"kind": "ModelChanged"}


@pytest.mark.parametrize(
    ("kind", "content", "taken"),
    [
        ("PULL-DOC-REQ", {}, True),
        ("PATCH-DOC", {"events": [CHANGED, {"kind": "MessageSent"}]}, True),
        ("PATCH-DOC", {"events": [CHANGED] * (MOST_EVENTS + 1)}, False),
        ("PATCH-DOC", {"events": [CHANGED, {"kind": "RootAdded"}]}, False),
        ("PATCH-DOC", {"events": [7]}, False),
        ("PATCH-DOC", {"events": 7}, False),
        ("PATCH-DOC", [], False),
        ("PUSH-DOC", {"doc": {}}, False),
    ],
)
def test_a_page_changes_values_and_presses_buttons(kind: str, content: Any, taken: bool) -> None:
    message: Any = SimpleNamespace(msgtype=kind, content=content)
    assert (refusal(message) == "") is taken


def test_buffers_without_end_end_their_connection(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("canfb.scope.scope_server.MOST_RECEIVED", 100_000)

    async def attack(where: SplitResult) -> None:
        connection = await page(where)
        await Session(connection).pull()
        head = {"msgid": "1", "msgtype": "PATCH-DOC", "num_buffers": 10**9}
        with contextlib.suppress(WebSocketClosedError):
            for part in (json.dumps(head), "{}", json.dumps({"events": []})):
                await connection.write_message(part)
            for number in range(100):
                await connection.write_message(json.dumps({"id": str(number)}))
                await connection.write_message(bytes(10_000), binary=True)
        while await connection.read_message() is not None:
            pass
        connection.close()

    attacked(tmp_path, monkeypatch, attack)


def test_connections_of_strangers_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a secret: more of them would take all file descriptors."""
    monkeypatch.setattr("canfb.scope.scope_server.MOST_CONNECTIONS", 8)

    async def attack(where: SplitResult) -> None:
        with contextlib.ExitStack() as opened:
            idle = [
                opened.enter_context(socket.create_connection((where.hostname, where.port), LINES_S))
                for _ in range(9)
            ]
            assert idle[-1].recv(1) == b""
        for _ in range(200):  # until those that were closed are gone
            with contextlib.suppress(ConnectionError):
                (await page(where)).close()
                return
            await asyncio.sleep(0.1)

    attacked(tmp_path, monkeypatch, attack)
