"""The server of the page: files and one stream of server-sent events, for this computer alone.

Data requires the **token**, new at each start. It is in the fragment of the address, which browsers put in no
request and no Referer. A cookie would not be safe: browsers send cookies of 127.0.0.1 to all of its ports.
"""

from __future__ import annotations

import contextlib
import hmac
import json
import queue
import secrets
import threading
from collections.abc import Callable, Iterator
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from importlib.resources import files
from socketserver import ThreadingTCPServer
from typing import Any, Self
from urllib.parse import urlsplit

from canfb.errors import CanfbError, saying
from canfb.monitoring import lines
from canfb.monitoring.layout import ModuleReading
from canfb.monitoring.snapshot import BusSnapshot, ModuleSnapshot, NodeSnapshot
from canfb.scope.traces import Curve, ModuleTraces

LOOPBACK = "127.0.0.1"
HTTP_PORT = 80  # browsers omit it in Host and Origin
TOKEN_BYTES = 32
STREAM = "/events"
MOST_CONNECTIONS = 32
MOST_WAITING = 64  # waiting events of a page; with more it is disconnected, and connects again
IDLE_S = 10.0  # time-out for a request, and for a peer to receive data
OPEN_ADDRESS = "open the address printed at the last start of canfb, with all after the #"

# Files served without token: they contain nothing secret.
FILES = {
    "/": ("page.html", "text/html"),
    "/page.js": ("page.js", "text/javascript"),
    "/page.css": ("page.css", "text/css"),
    "/uPlot.js": ("uPlot.iife.min.js", "text/javascript"),
    "/uPlot.css": ("uPlot.min.css", "text/css"),
}

# Headers of every response.
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}

Event = bytes
Events = queue.Queue[Event | None]


def event(name: str, data: str) -> Event:
    """An event of the stream (server-sent events); ``data`` is one line."""
    return f"event: {name}\ndata: {data}\n\n".encode()


class PageServer(ThreadingTCPServer):  # not HTTPServer, which looks up a host name
    """Serves at ``port`` of 127.0.0.1 (0: any free port); CanfbError if it is in use.

    A page gets the event ``first()``, then each event given to :meth:`publish`.
    """

    daemon_threads = True  # the program does not wait for them at its end

    def __init__(self, port: int, first: Callable[[], Event]) -> None:
        self.token = secrets.token_urlsafe(TOKEN_BYTES)
        self._first = first
        self._viewers: list[Events] = []
        self._lock = threading.Lock()
        self._places = threading.BoundedSemaphore(MOST_CONNECTIONS)
        with saying(CanfbError, f"cannot listen at {LOOPBACK}:{port}", OSError, OverflowError):
            super().__init__((LOOPBACK, port), _Handler)
        bound = self.server_address[1]
        self.host = LOOPBACK if bound == HTTP_PORT else f"{LOOPBACK}:{bound}"
        self.address = f"http://{self.host}/#{self.token}"
        self.files = {
            path: files("canfb.scope").joinpath(name).read_bytes() for path, (name, _) in FILES.items()
        }

    def __enter__(self) -> Self:
        self._thread = threading.Thread(target=self.serve_forever, name="canfb page")
        self._thread.start()
        return self

    def __exit__(self, *raised: object) -> None:
        with self._lock:
            for viewer in self._viewers:
                _end(viewer)
        self.shutdown()
        self._thread.join()
        self.server_close()

    def is_seen(self) -> bool:
        return bool(self._viewers)

    def publish(self, one: Event) -> None:
        """Send an event to each page."""
        with self._lock:
            for viewer in self._viewers:
                try:
                    viewer.put_nowait(one)
                except queue.Full:
                    _end(viewer)

    @contextlib.contextmanager
    def viewer(self) -> Iterator[Events]:
        """Queue of events for one page; None: the end."""
        events: Events = queue.Queue(MOST_WAITING)
        with self._lock:
            events.put_nowait(self._first())
            self._viewers.append(events)
        try:
            yield events
        finally:
            with self._lock:
                self._viewers.remove(events)

    def refusal(self, hosts: list[str], origin: str | None, path: str, token: str) -> str:
        """Why a request is refused, or "". Other host names (DNS rebinding) are refused."""
        known = path != STREAM or hmac.compare_digest(token.encode(), self.token.encode())
        refusals = (
            (hosts != [self.host], f"another host name than {self.host}"),
            (origin not in (None, f"http://{self.host}"), "a request of another site"),
            (not known, OPEN_ADDRESS),
        )
        return next((why for holds, why in refusals if holds), "")

    def process_request(self, request: Any, client_address: Any) -> None:
        if self._places.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._places.release()

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignore a peer that has disconnected."""


def _end(viewer: Events) -> None:
    with contextlib.suppress(queue.Empty):
        while True:
            viewer.get_nowait()
    viewer.put_nowait(None)


class _Handler(BaseHTTPRequestHandler):
    server: PageServer
    timeout = IDLE_S
    server_version, sys_version = "canfb", ""

    def do_GET(self) -> None:
        page, parts = self.server, urlsplit(self.path)
        hosts, origin = self.headers.get_all("Host") or [], self.headers.get("Origin")
        if refusal := page.refusal(hosts, origin, parts.path, parts.query):
            self._answer(HTTPStatus.FORBIDDEN, "text/plain", refusal.encode())
        elif parts.path == STREAM:
            self._stream(page)
        elif (content := page.files.get(parts.path)) is not None:
            self._answer(HTTPStatus.OK, FILES[parts.path][1], content)
        else:
            self._answer(HTTPStatus.NOT_FOUND, "text/plain", b"there is no such page")

    def _answer(self, status: HTTPStatus, kind: str, content: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def _stream(self, page: PageServer) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", "text/event-stream")
        self.end_headers()
        with page.viewer() as events:
            while (one := events.get()) is not None:
                self.wfile.write(one)

    def end_headers(self) -> None:
        for name, value in HEADERS.items():
            self.send_header(name, value)
        super().end_headers()

    def log_message(self, format: str, *arguments: object) -> None:
        """No log: it could contain the token."""


class LivePage:
    """Snapshots become events of a :class:`PageServer` at ``port``."""

    def __init__(self, port: int, units: lines.MachineUnits) -> None:
        self.server = PageServer(port, self.first)
        self._units = units
        self._traces: dict[int, ModuleTraces] = {}
        self._curves: dict[int, Curve] = {}
        self._last: BusSnapshot | None = None
        self._lock = threading.Lock()

    def know(self, reading: ModuleReading) -> None:
        if reading.correction is not None:
            with self._lock:
                self._of(reading.layout.node_id).read = reading.correction

    def show(self, snapshot: BusSnapshot) -> None:
        with self._lock:
            self._last = snapshot
            for node, module in snapshot.modules:
                self._of(node.node_id).take(snapshot.time_s, module)
            if not self.server.is_seen():
                return
            look = self._look(snapshot)
        self.server.publish(look)

    def first(self) -> Event:
        """Units, points and deviations so far, and the last snapshot."""
        with self._lock:
            past = {node: list(traces.points) for node, traces in self._traces.items()}
            units = {"position": self._units.name, "velocity": self._units.speed_name}
            begin = event("past", json.dumps({"units": units, "points": past, "deviations": self._curves}))
            return begin if self._last is None else begin + self._look(self._last)

    def _look(self, snapshot: BusSnapshot) -> Event:
        look = {
            "time_s": snapshot.time_s,
            "bus": [_plain(line) for line in lines.bus_lines(snapshot)],
            "others": lines.other_nodes(snapshot),
            "modules": [self._module(snapshot.time_s, *one) for one in snapshot.modules],
        }
        return event("look", json.dumps(look))

    def _of(self, node_id: int) -> ModuleTraces:
        return self._traces.setdefault(node_id, ModuleTraces(self._units))

    def _module(self, now: float, node: NodeSnapshot, module: ModuleSnapshot) -> dict[str, Any]:
        traces = self._of(node.node_id)
        if (curve := traces.deviation(now, module.full_scale_counts)) is not None:
            self._curves[node.node_id] = curve
        names = dict.fromkeys((*module.counters, *module.seen))
        return {
            "node": node.node_id,
            "name": lines.name_of(node),
            "state": lines.state_words(node),
            "mapping": lines.mapping_words(module),
            "tone": lines.tone_of(module),
            "lines": [_plain(line) for line in lines.module_lines(node, module, self._units)],
            "emergencies": [lines.emergency_part(one) for one in node.emergencies],
            "counters": [(name, module.counters.get(name), module.seen.get(name)) for name in names],
            "point": traces.points[-1],
            "tracks": module.tracks_counts,
            "limits": module.amplitude_limits_counts,
            "full_scale": module.full_scale_counts,
            "assumed": module.assumed,
            "deviation": curve,
        }


def _plain(line: lines.Line) -> tuple[str, lines.Parts]:
    return line.label, tuple(part for part in line.parts if part[0])
