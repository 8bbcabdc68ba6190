"""Who may see the page: the token of this start, the right host name, and no other site."""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, auto

METHODS = ("GET", "HEAD")
LOOPBACK = "127.0.0.1"
NAMES = (LOOPBACK, "localhost")
TOKEN_BYTES = 32
HTTP_PORT = 80  # browsers leave it out

HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
"""Of every response. Bokeh styles its parts with style elements; it needs no inline script, and no eval."""


class GateVerdict(Enum):
    """What becomes of a request."""

    SERVED = auto()
    LET_IN = auto()  # the token is right: set the cookie, and go on without the token in the address
    REFUSED = auto()


@dataclass(frozen=True)
class Request:
    """What a request says of itself; header names in lower case, ``token`` of its address."""

    method: str
    headers: Mapping[str, str]
    cookies: Mapping[str, str]
    token: str | None = None


class Gate:
    """Judges each request, that of the websocket too, before anything else sees it.

    ``port`` is that of the server, which is bound to 127.0.0.1: only the names of loopback are let through as
    Host, so that no other name that is made to point here (DNS rebinding) gets an answer. An Origin must be
    this server; a websocket must have one. The token is random for each start, and compared in constant time.
    """

    def __init__(self, port: int, token: str | None = None) -> None:
        self.token = token or secrets.token_urlsafe(TOKEN_BYTES)
        self.cookie = f"canfb-scope-{port}"  # cookies are shared by all ports of a host
        self._hosts = {f"{name}:{port}" for name in NAMES}
        if port == HTTP_PORT:
            self._hosts |= set(NAMES)
        self.address = f"http://{LOOPBACK}:{port}/?token={self.token}"

    @property
    def hosts(self) -> list[str]:
        """Names of this server, with the port, as Host and Origin have them."""
        return sorted(self._hosts)

    def judge(self, request: Request) -> tuple[GateVerdict, str]:
        """The verdict, and the reason of a refusal."""
        if request.method not in METHODS:
            return GateVerdict.REFUSED, "this page only answers GET"
        if request.headers.get("host", "").lower() not in self._hosts:
            return GateVerdict.REFUSED, "another host name than that of this page"
        origin = request.headers.get("origin")
        is_websocket = request.headers.get("upgrade", "").lower() == "websocket"
        if origin is None and is_websocket:
            return GateVerdict.REFUSED, "a websocket without an origin"
        if origin is not None and origin.lower() not in {f"http://{host}" for host in self._hosts}:
            return GateVerdict.REFUSED, "a request of another site"
        if request.token is not None:
            return self._judge_token(request.token, GateVerdict.LET_IN)
        return self._judge_token(request.cookies.get(self.cookie, ""), GateVerdict.SERVED)

    def _judge_token(self, token: str, granted: GateVerdict) -> tuple[GateVerdict, str]:
        if hmac.compare_digest(token.encode(errors="replace"), self.token.encode()):
            return granted, ""
        return GateVerdict.REFUSED, "open the address that canfb scope has printed, with its token"
