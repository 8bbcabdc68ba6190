"""The web server of ``canfb scope``: Bokeh's, behind a gate that sees every request first."""

from __future__ import annotations

import asyncio
import logging
import secrets
import socket
from collections.abc import Callable
from typing import Any

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.document import Document
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPHeaders, HTTPServerRequest, parse_cookie
from tornado.ioloop import IOLoop
from tornado.web import OutputTransform, RequestHandler

from canfb.bus.scope_loop import ScopeLoop
from canfb.errors import CanfbError
from canfb.scope.gate import HEADERS, LOOPBACK, Gate, GateVerdict, Request
from canfb.scope.scope_page import SCRIPT, STYLE, page_file

log = logging.getLogger(__name__)

COOKIE = "{name}={token}; HttpOnly; SameSite=Strict; Path=/"
FILES = {SCRIPT: "text/javascript", STYLE: "text/css"}
LARGEST_MESSAGE = 20_000_000  # bytes: a table file has a hundredth of it; a larger one ends the connection
GONE_S = 15.0
UPDATE_MS = 500
Fill = Callable[[Document], Callable[[], None]]
"""Fills the document of a page; gives what brings it up to date."""


class ScopeServer:
    """Serves pages on loopback, at a port (0: any that is free), until :meth:`stop`.

    CanfbError, on entering, where it cannot be bound. ``fill`` is called for each page that is opened; it,
    and what updates it, run in the thread of :meth:`run`.
    """

    def __init__(self, fill: Fill, port: int) -> None:
        self._fill, self._port = fill, port

    def __enter__(self) -> ScopeServer:
        try:
            bound = socket.create_server((LOOPBACK, self._port))
        except OSError as error:
            raise CanfbError(f"cannot listen at {LOOPBACK}, port {self._port}: {error.strerror}") from None
        bound.setblocking(False)
        self.gate = Gate(bound.getsockname()[1])
        self._asyncio = asyncio.new_event_loop()
        asyncio.set_event_loop(self._asyncio)
        self.loop = ScopeLoop(self._asyncio)
        application = Application(FunctionHandler(self._open))
        web = _GatedTornado(
            self.gate,
            {"/": application},
            extra_patterns=[(f"/({name})", _File, {"kind": kind}) for name, kind in FILES.items()],
            extra_websocket_origins=self.gate.hosts,
            secret_key=secrets.token_bytes(),
            sign_sessions=True,
            use_index=False,
            include_headers=[],
            include_cookies=[],
            ico_path="none",
            check_unused_sessions_milliseconds=5000,
            unused_session_lifetime_milliseconds=round(1000 * GONE_S),
            websocket_max_message_size_bytes=LARGEST_MESSAGE,
        )
        web.add_transform(_Headers)
        web.settings["log_function"] = _note
        http = HTTPServer(web, max_body_size=0, max_header_size=1 << 16)
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
        self._asyncio.run_forever()

    def stop(self) -> None:
        """End it; from any thread, or a signal handler."""
        self.loop.soon(self._asyncio.stop)

    def _open(self, document: Document) -> None:
        document.add_periodic_callback(self._fill(document), UPDATE_MS)


class _GatedTornado(BokehTornado):
    """Bokeh's application, which only sees what the gate lets through."""

    def __init__(self, gate: Gate, applications: Any, **options: Any) -> None:
        super().__init__(applications, **options)
        self._gate = gate

    def find_handler(self, request: HTTPServerRequest, **kwargs: Any) -> Any:
        """Of each request, that of a websocket too."""
        verdict, why = self._gate.judge(_seen(request))
        if verdict is GateVerdict.SERVED:
            return super().find_handler(request, **kwargs)
        if verdict is GateVerdict.LET_IN:
            cookie = COOKIE.format(name=self._gate.cookie, token=self._gate.token)
            return self.get_handler_delegate(request, _LetIn, {"cookie": cookie})
        log.debug("refused %s: %s", request.remote_ip, why)
        return self.get_handler_delegate(request, _Refused, {"why": why})


def _note(handler: RequestHandler) -> None:
    """Tornado would print a line for each request that is refused: another site could fill a terminal."""
    log.debug("%s %s: %s", handler.request.method, handler.request.path, handler.get_status())


def _seen(request: HTTPServerRequest) -> Request:
    headers = {name.lower(): value for name, value in request.headers.get_all()}
    cookies = parse_cookie(
        headers.get("cookie", "")
    )  # not http.cookies, which gives up at odd ones of others
    token = request.query_arguments.get("token")
    found = None if token is None else token[-1].decode("utf-8", "replace")
    return Request(request.method or "", headers, cookies, found)


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


class _LetIn(_Answer):
    def initialize(self, cookie: str) -> None:
        self._cookie = cookie

    def answer(self) -> None:
        """The cookie, and the address without the token."""
        self.set_header("Set-Cookie", self._cookie)
        self.redirect("/", status=303)

    def prepare(self) -> None:
        self.answer()


class _Refused(_Answer):
    def initialize(self, why: str) -> None:
        self._why = why

    def answer(self) -> None:
        """One line."""
        self.set_status(403)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.write(f"403: {self._why}\n")


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
        for name, value in HEADERS.items():
            headers[name] = value
        headers["Cache-Control"] = "no-store"
        del headers["Server"]
        return status_code, headers, chunk
