"""Who may see the page, and who may write: a token, one-time tickets, and a code; none of them is a cookie.

Browsers send the cookies of 127.0.0.1 to every port of it, so whatever listens at another port of this
computer, for another user too, gets them. Bokeh's own hooks for users (``auth_provider``) cannot do without:
a browser adds no header to the handshake of a websocket. What it does send there is the subprotocol, and
Bokeh's client puts the token of its session into it. So there are three secrets, new with each start:

- the **token**, in the fragment of the address. A fragment is in no request, Referer or log. The script of
  the page takes it out of the address and keeps it in the sessionStorage, which is that of this host *and*
  port.
- a **ticket**, a signed token of one session of Bokeh. The script asks for it with the token in the header
  Authorization, and opens the websocket with it as a subprotocol. A ticket opens one websocket, once: two
  programs never share a session.
- the **code**, which is only in the terminal. It is typed on the page before the first task that writes, so
  that neither the token nor a ticket is enough to change a module.

The page itself and its scripts have no secret in them and are served to whoever asks: they show nothing
without a websocket.
"""

from __future__ import annotations

import hmac
import secrets
from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from enum import Enum, auto

LOOPBACK = "127.0.0.1"
TOKEN_BYTES = 32
HTTP_PORT = 80  # browsers leave it out
SESSION, SOCKET = "/session", "/live/ws"
SOCKET_PROTOCOL = "bokeh"
MOST_TICKETS = 32  # that were not used yet; the oldest is void
CODE_LETTERS, CODE_LENGTH = "23456789ABCDEFGHJKMNPQRSTUVWXYZ", 8  # without those that look alike
MOST_WRONG = 20
OPEN_ADDRESS = "open the address that canfb scope has printed at its last start, with all that follows the #"

HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'{nonce}; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
"""Of every response; ``{nonce}`` is that of the style elements of one page (:func:`headers_of`)."""


def headers_of(nonce: str = "") -> dict[str, str]:
    """Those of a response; ``nonce``, of a page, is for the style elements that Bokeh makes."""
    return {name: value.format(nonce=nonce and f" 'nonce-{nonce}'") for name, value in HEADERS.items()}


class GateVerdict(Enum):
    """What becomes of a request."""

    SERVED = auto()  # the page or a file of it: no secret is in it
    TICKET = auto()  # the token is right: a ticket is the answer
    CONNECTED = auto()  # the ticket is right, and void from now on
    REFUSED = auto()


@dataclass(frozen=True)
class Request:
    """A request: method, path, headers with names in lower case."""

    method: str
    path: str
    headers: Mapping[str, str]


class Gate:
    """Judges each request, that of the websocket too, before anything else sees it.

    ``port`` is that of the server, which is bound to 127.0.0.1: no other Host is let through, so that no name
    that is made to point here (DNS rebinding) gets an answer; nor is ``localhost``, which may be ``[::1]``
    and somebody else. An Origin must be this server; what needs a secret must have one. ``files`` are the
    paths that are served. Secrets are compared in constant time.
    """

    def __init__(self, port: int, files: Collection[str], token: str | None = None) -> None:
        self.token = token or secrets.token_urlsafe(TOKEN_BYTES)
        self._files = frozenset(files)
        self._hosts = {f"{LOOPBACK}:{port}"}
        if port == HTTP_PORT:
            self._hosts.add(LOOPBACK)
        self._tickets: deque[str] = deque(maxlen=MOST_TICKETS)
        self.address = f"http://{LOOPBACK}:{port}/#{self.token}"

    @property
    def hosts(self) -> list[str]:
        """Names of this server, with the port, as Host and Origin have them."""
        return sorted(self._hosts)

    def issue(self, ticket: str) -> str:
        """This ticket opens one websocket."""
        self._tickets.append(ticket)
        return ticket

    def judge(self, request: Request) -> tuple[GateVerdict, str]:
        """The verdict, and the reason of a refusal."""
        needs_secret = request.path in (SESSION, SOCKET)
        if request.headers.get("host", "").lower() not in self._hosts:
            return GateVerdict.REFUSED, f"another host name than {self.hosts[-1]}"
        origin = request.headers.get("origin")
        if origin is None and needs_secret:
            return GateVerdict.REFUSED, "a request without an origin"
        if origin is not None and origin.lower() not in {f"http://{host}" for host in self._hosts}:
            return GateVerdict.REFUSED, "a request of another site"
        if request.method != ("POST" if request.path == SESSION else "GET"):
            return GateVerdict.REFUSED, "this page only answers GET"
        if request.path == SESSION:
            return self._judge_token(request.headers.get("authorization", ""))
        if request.path == SOCKET:
            return self._judge_ticket(request.headers.get("sec-websocket-protocol", ""))
        if request.path not in self._files:
            return GateVerdict.REFUSED, "there is no such page"
        return GateVerdict.SERVED, ""

    def _judge_token(self, authorization: str) -> tuple[GateVerdict, str]:
        kind, _, token = authorization.partition(" ")
        if kind == "Bearer" and _same(token, self.token):
            return GateVerdict.TICKET, ""
        return GateVerdict.REFUSED, OPEN_ADDRESS

    def _judge_ticket(self, protocols: str) -> tuple[GateVerdict, str]:
        protocol, _, said = (part.strip() for part in protocols.partition(","))
        if protocol == SOCKET_PROTOCOL:
            for ticket in self._tickets:
                if _same(said, ticket):
                    self._tickets.remove(ticket)
                    return GateVerdict.CONNECTED, ""
        return GateVerdict.REFUSED, "a websocket without a ticket of this start"


class WriteCode:
    """Confirms tasks that write. After MOST_WRONG wrong codes none is right until the next start."""

    def __init__(self) -> None:
        self.code = "".join(secrets.choice(CODE_LETTERS) for _ in range(CODE_LENGTH))
        self._left = MOST_WRONG

    def __str__(self) -> str:
        """In groups of four, to be read."""
        return "-".join(self.code[n : n + 4] for n in range(0, CODE_LENGTH, 4))

    def refusal(self, said: str) -> str:
        """Why a task that writes may not begin; empty if this is the code. Case and dashes do not count."""
        if self._left > 0 and _same("".join(filter(str.isalnum, said)).upper(), self.code):
            return ""
        if not said.strip():
            return "type the code that canfb scope has printed in its terminal"
        self._left = max(0, self._left - 1)
        if not self._left:
            return f"{MOST_WRONG} wrong codes: nothing is written any more until canfb scope is started again"
        return "this is not the code that canfb scope has printed in its terminal"


def _same(said: str, secret: str) -> bool:
    return hmac.compare_digest(said.encode(errors="replace"), secret.encode())
