"""The web server of ``canfb scope``: Bokeh's, behind a gate that sees every request first.

Bokeh's own page would carry the token of a session to whoever gets the page; so it is not served. The page is
the same for everybody, and its script asks for a ticket (gate), with which Bokeh makes the session.

Any program of this computer can connect to a port on loopback, so all that it can use up has a limit:
connections, the head of a request, pages that are open or being opened, the time until a websocket is open,
and pings that are not answered. On a websocket Bokeh applies whatever comes to its document: a page could add
models without end, or announce buffers that it sends for ever. The page of the scope changes values and
presses buttons; another kind of message, too many bytes or too many models end the connection
(:class:`PageSocket`).

Pages, their updates and all of Bokeh run in the one thread of :meth:`ScopeServer.run`. Frames are received by
a thread of their own and a task is done by another; what they find is brought here by :class:`.ScopeLoop`.
Threads do not run in a garbage collection, the receiving one included: what exists at the start is left out
of it, and pages that are closed together are collected once.
"""

from __future__ import annotations

import asyncio
import gc
import logging
import secrets
import socket
import time
import warnings
from collections import deque
from collections.abc import Callable
from typing import Any

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.document import Document, document
from bokeh.protocol.message import Message
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.server.views.ws import WSHandler
from bokeh.util.token import generate_jwt_token, generate_session_id
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPHeaders, HTTPServerRequest
from tornado.ioloop import IOLoop
from tornado.iostream import IOStream
from tornado.web import OutputTransform, RequestHandler

from canfb.bus.runner import outside_collections
from canfb.errors import CanfbError
from canfb.scope.gate import LOOPBACK, SOCKET, Gate, GateVerdict, Request, headers_of
from canfb.scope.scope_page import BOKEH_SCRIPTS, LARGEST_MESSAGE, SCRIPT, STYLE, page_file
from canfb.scope.scoping import ScopeLoop

log = logging.getLogger(__name__)

MOST_RECEIVED = 40 * LARGEST_MESSAGE  # bytes, of a page while it is open: some tens of table files
OVERHEAD = 16  # bytes, of each message and ping: empty ones count, too
MOST_EVENTS = 100  # in one message: a page that is made larger changes the size of each picture
MOST_MODELS = 2000  # of a document: the page has some hundred
PATCH = "PATCH-DOC"
TAKEN = frozenset({"PULL-DOC-REQ", "SERVER-INFO-REQ", PATCH})
EVENTS = frozenset({"ModelChanged", "MessageSent"})
TOO_BIG = 1009  # close code of RFC 6455, 7.4.1


class PageSocket(WSHandler):
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


FILES = {SCRIPT: "text/javascript", STYLE: "text/css"}
LARGEST_HEAD = 1 << 14  # bytes, of a request
MOST_PAGES = 16  # that are open
MOST_CONNECTIONS = 128  # that are no websocket; a process may have 1024 files by default
TICKET_S = 60  # in which it must be used
PING_S = 20.0  # a browser that does not answer is gone
IDLE_S = 60.0  # of a connection that is no websocket
GONE_S = 15.0
OPENING_S = 30.0  # of a websocket, at most
COLLECT_S = 5.0  # from the end of a page to that of what it has used
LONGEST_LINE = 300
UNSENT = "coroutine 'WSHandler.send_message' was never awaited"  # Bokeh's, to a page that has gone
NOISY = ("bokeh.server.views.ws", "bokeh.server.protocol_handler")
UPDATE_MS = 500
Fill = Callable[[Document], Callable[[], None]]
"""Fills the document of a page; gives what brings it up to date."""


class _OneLine(logging.Filter):
    """Bokeh logs a message that it cannot read as a whole, with a traceback: a peer could fill a terminal."""

    def filter(self, record: logging.LogRecord) -> bool:
        """The beginning and the end of it."""
        text = " ".join(record.getMessage().split())
        record.msg = text if len(text) <= LONGEST_LINE else f"{text[:100]} ... {text[100 - LONGEST_LINE :]}"
        record.args, record.exc_info = (), None
        return True


SHORT = _OneLine()


class _OneCollection:
    """Stands in for ``gc`` in Bokeh's documents, in a ``with``: each page, at its end, collects all garbage.

    No thread runs in a collection, that which reads the bus included: 20 ms with a few pages, several times
    that with many, and for each page that is closed. One behind all that are closed together does the same.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._planned = False

    def __enter__(self) -> None:
        setattr(document, "gc", self)  # noqa: B010

    def __exit__(self, *_: object) -> None:
        setattr(document, "gc", gc)  # noqa: B010

    def collect(self) -> None:
        """Soon."""
        if not self._planned:
            self._planned = True
            self._loop.call_later(COLLECT_S, self._collect)

    def _collect(self) -> None:
        self._planned = False
        gc.collect()


class ScopeServer:
    """Serves pages on loopback, at a port (0: any that is free), until :meth:`stop`.

    CanfbError, on entering, where it cannot be bound. ``fill`` is called for each page that is opened; it,
    and what updates it, run in the thread of :meth:`run`. ``page`` is the HTML that everybody gets, with
    ``{nonce}`` where that of its styles belongs.
    """

    def __init__(self, fill: Fill, port: int, page: str) -> None:
        self._fill, self._port, self._page = fill, port, page

    def __enter__(self) -> ScopeServer:
        try:
            bound = socket.create_server((LOOPBACK, self._port))
        except OSError as error:
            raise CanfbError(f"cannot listen at {LOOPBACK}, port {self._port}: {error.strerror}") from None
        bound.setblocking(False)
        files = ("/", *(f"/{name}" for name in (*FILES, *BOKEH_SCRIPTS)))
        self.gate = Gate(bound.getsockname()[1], files)
        self._asyncio = asyncio.new_event_loop()
        asyncio.set_event_loop(self._asyncio)
        self.loop = ScopeLoop(self._asyncio)
        for name in NOISY:
            logging.getLogger(name).addFilter(SHORT)
        warnings.filterwarnings("ignore", UNSENT, RuntimeWarning)
        application = Application(FunctionHandler(self._open))
        web = _GatedTornado(
            self.gate,
            {SOCKET.rpartition("/")[0]: application},
            extra_patterns=[
                ("/", _Page, {"page": self._page}),
                *((f"/({name})", _File, {"kind": kind}) for name, kind in FILES.items()),
            ],
            extra_websocket_origins=self.gate.hosts,
            secret_key=secrets.token_bytes(),
            sign_sessions=True,
            session_token_expiration=TICKET_S,
            use_index=False,
            include_headers=[],
            include_cookies=[],
            ico_path="none",
            check_unused_sessions_milliseconds=5000,
            unused_session_lifetime_milliseconds=round(1000 * GONE_S),
            websocket_max_message_size_bytes=LARGEST_MESSAGE,
            websocket_ping_interval=PING_S,
            websocket_ping_timeout=PING_S,
        )
        web.add_transform(_Headers)
        web.settings["log_function"] = _note
        http = _BoundedHttp(
            web, max_body_size=0, max_header_size=LARGEST_HEAD, idle_connection_timeout=IDLE_S
        )
        http.add_sockets([bound])
        self._server = BaseServer(IOLoop.current(), web, http)
        return self

    def __exit__(self, *_: object) -> None:
        self._asyncio.run_until_complete(self._close())
        asyncio.set_event_loop(None)
        self._asyncio.close()

    async def _close(self) -> None:
        self._server.stop(wait=False)
        await self._server._http.close_all_connections()
        waiting = asyncio.all_tasks() - {asyncio.current_task()}
        for one in waiting:
            one.cancel()
        await asyncio.gather(*waiting, return_exceptions=True)

    def run(self) -> None:
        """Serve until :meth:`stop`."""
        self._server.start()
        with outside_collections(), _OneCollection(self._asyncio):
            self._asyncio.run_forever()

    def stop(self) -> None:
        """End it; from any thread, or a signal handler."""
        self.loop.soon(self._asyncio.stop)

    def _open(self, page: Document) -> None:
        page.config.reconnect_session = False  # a ticket opens one websocket; the page asks for a reload
        page.config.notify_connection_status = False  # the page says it in words of its own
        page.add_periodic_callback(self._fill(page), UPDATE_MS)


class _BoundedHttp(HTTPServer):
    """Closes connections beyond MOST_CONNECTIONS: each is a file descriptor, and anybody may open one."""

    def handle_stream(self, stream: IOStream, address: Any) -> None:
        """One that was accepted."""
        if len(self._connections) < MOST_CONNECTIONS:
            super().handle_stream(stream, address)
        else:
            stream.close()


class _GatedTornado(BokehTornado):
    """Bokeh's application, which only gets what the gate lets through."""

    def __init__(self, gate: Gate, applications: Any, **options: Any) -> None:
        super().__init__(applications, **options)
        self._gate = gate
        self._opening_s: deque[float] = deque()  # when websockets were let through that are not open yet

    @property
    def _pages(self) -> int:
        """Those that are open, or are being opened: a browser that gives up on the way does not say so."""
        opening_s, now = self._opening_s, time.monotonic()
        while opening_s and now - opening_s[0] > OPENING_S:
            opening_s.popleft()
        return len(self._clients) + len(opening_s)

    def new_connection(self, *arguments: Any) -> Any:
        """A websocket is open."""
        if self._opening_s:
            self._opening_s.popleft()
        return super().new_connection(*arguments)

    def find_handler(self, request: HTTPServerRequest, **kwargs: Any) -> Any:
        """Of each request, that of a websocket too."""
        headers = {name.lower(): value for name, value in request.headers.get_all()}
        verdict, why = self._gate.judge(Request(request.method or "", request.path, headers))
        if verdict in (GateVerdict.TICKET, GateVerdict.CONNECTED) and self._pages >= MOST_PAGES:
            verdict, why = GateVerdict.REFUSED, f"{MOST_PAGES} pages are open: close one, and reload this one"
        if verdict is GateVerdict.CONNECTED:
            self._opening_s.append(time.monotonic())
        if verdict is GateVerdict.TICKET:
            return self.get_handler_delegate(request, _Ticket, {"ticket": self._ticket})
        if verdict is not GateVerdict.REFUSED:
            return super().find_handler(request, **kwargs)
        log.debug("refused %s: %s", request.remote_ip, why)
        return self.get_handler_delegate(request, _Refused, {"why": why})

    def get_handler_delegate(
        self, request: HTTPServerRequest, target_class: Any, *args: Any, **kwargs: Any
    ) -> Any:
        """The websocket is one with limits."""
        bounded = PageSocket if target_class is WSHandler else target_class
        return super().get_handler_delegate(request, bounded, *args, **kwargs)

    def _ticket(self) -> str:
        """For one session of Bokeh."""
        ticket: str = generate_jwt_token(
            generate_session_id(self.secret_key, signed=True),
            secret_key=self.secret_key,
            signed=True,
            expiration=TICKET_S,
        )
        return self._gate.issue(ticket)


def _note(handler: RequestHandler) -> None:
    """Tornado would print a line for each request that is refused: another site could fill a terminal."""
    log.debug("%s %s: %s", handler.request.method, handler.request.path, handler.get_status())


class _Answer(RequestHandler):
    """For whatever method it was."""

    def prepare(self) -> None:
        self.answer()
        self.finish()

    def answer(self) -> None:
        """Status and text."""
        raise NotImplementedError

    def check_xsrf_cookie(self) -> None:
        """Nothing is done for anybody."""


class _Ticket(_Answer):
    def initialize(self, ticket: Callable[[], str]) -> None:
        self._ticket = ticket

    def answer(self) -> None:
        """As text."""
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.write(self._ticket())


class _Refused(_Answer):
    def initialize(self, why: str) -> None:
        self._why = why

    def answer(self) -> None:
        """One line."""
        self.set_status(403)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.write(f"403: {self._why}\n")


class _Page(RequestHandler):
    def initialize(self, page: str) -> None:
        self._page = page

    def get(self) -> None:
        """The page, with a nonce of its own for its styles."""
        nonce = secrets.token_urlsafe()
        self.set_header("Content-Type", "text/html; charset=utf-8")
        for name, value in headers_of(nonce).items():
            self.set_header(name, value)
        self.write(self._page.replace("{nonce}", nonce))


class _File(RequestHandler):
    def initialize(self, kind: str) -> None:
        self._kind = kind

    def get(self, name: str) -> None:
        """One of the files of the page."""
        self.set_header("Content-Type", f"{self._kind}; charset=utf-8")
        self.write(page_file(name))


class _Headers(OutputTransform):
    """The headers of the gate, on every response."""

    def transform_first_chunk(
        self, status_code: int, headers: HTTPHeaders, chunk: bytes, finishing: bool
    ) -> tuple[int, HTTPHeaders, bytes]:
        for name, value in headers_of().items():
            headers.setdefault(name, value)
        headers["Cache-Control"] = "no-store"
        headers.pop("Server", None)
        return status_code, headers, chunk
