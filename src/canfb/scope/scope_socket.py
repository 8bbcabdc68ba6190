"""The websocket of a page of ``canfb scope``: Bokeh's, with limits on all that a browser may send.

Bokeh applies whatever comes to its document: a page could add models without end, or announce buffers that it
sends for ever. The page of the scope changes values and presses buttons; nothing else is taken.
"""

from __future__ import annotations

import logging
from typing import Any

from bokeh.protocol.message import Message
from bokeh.server.views.ws import WSHandler

from canfb.scope.scope_page import LARGEST_MESSAGE

log = logging.getLogger(__name__)

MOST_RECEIVED = 40 * LARGEST_MESSAGE  # bytes, of a page while it is open: some tens of table files
OVERHEAD = 16  # bytes, of each message and ping: empty ones count, too
MOST_EVENTS = 100  # in one message: a page that is made larger changes the size of each picture
MOST_MODELS = 2000  # of a document: the page has some hundred
PATCH = "PATCH-DOC"
TAKEN = frozenset({"PULL-DOC-REQ", "SERVER-INFO-REQ", PATCH})
EVENTS = frozenset({"ModelChanged", "MessageSent"})
TOO_BIG = 1009  # close code of RFC 6455, 7.4.1


class PageSocket(WSHandler):  # type: ignore[misc]  # Bokeh has no types there
    """Closes itself when the browser sends what the page never sends."""

    _received = 0
    _refused = False

    async def on_message(self, fragment: str | bytes) -> None:
        """A part of a message."""
        if self._takes(len(fragment)):
            await super().on_message(fragment)

    def on_ping(self, data: bytes) -> None:
        """It is answered: the answers wait in memory where nobody reads them."""
        self._takes(len(data))

    async def _handle(self, message: Message[Any]) -> Any | None:
        if why := refusal(message):
            self._refuse(why)
            return None
        work = await super()._handle(message)
        connection = self.connection
        if connection is not None and len(connection.session.document.models) > MOST_MODELS:
            self._refuse(f"more than {MOST_MODELS} models")
        return work

    async def _schedule(self, work: Any) -> None:
        if work is not None:  # else it was refused
            await super()._schedule(work)

    def _takes(self, count: int) -> bool:
        self._received += count + OVERHEAD
        if self._received > MOST_RECEIVED:
            self._refuse(f"more than {MOST_RECEIVED} bytes")
        return not self._refused

    def _refuse(self, why: str) -> None:
        if not self._refused:
            self._refused = True
            log.debug("a page is closed: %s", why)
            self.close(TOO_BIG, why)


def refusal(message: Message[Any]) -> str:
    """Why a message of the browser is not taken; empty: it is."""
    if message.msgtype not in TAKEN:
        return f"{message.msgtype} of a page"[:100]
    if message.msgtype != PATCH:
        return ""
    content = message.content
    events = content.get("events") if isinstance(content, dict) else None
    if not isinstance(events, list) or len(events) > MOST_EVENTS:
        return "no list of events, or too long"
    kinds = {one.get("kind") if isinstance(one, dict) else None for one in events}
    return "" if kinds <= EVENTS else "events that a page does not send"
