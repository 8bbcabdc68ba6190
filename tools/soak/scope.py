"""`canfb scope --write` under load and attack: what it takes, refuses and costs; its bus meanwhile.

    python -m tools.soak.scope [--seconds N] [--rounds N] [--only TEXT]

Module, machine and scope are processes of their own on a udp_multicast bus, with --frames frames a second of
other nodes. One attack follows the other for --seconds each. A row says how many connections were tried and
let in, the largest message to a page, the largest memory (resident set) and number of file descriptors of the
scope, the most frames that waited in its socket of the bus, and how many the kernel dropped there
(/proc/net/udp). Behind each attack a new page is opened: how long that took. Exit status 1 if a page could
not be opened, descriptors were left over, a frame was dropped, memory grew by more than MOST_GROWTH_BYTES in
the rounds behind the first, or an attack wrote more than MOST_LINES of log.
"""

from __future__ import annotations

import argparse
import asyncio
import base64
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import SplitResult, urlsplit

import can
from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.iostream import StreamClosedError
from tornado.websocket import WebSocketClientConnection, WebSocketClosedError, websocket_connect

from canfb.bus.opening import open_bus
from canfb.scope.scope_page import BOKEH_SCRIPTS, LARGEST_MESSAGE
from canfb.scope.scope_server import GONE_S, MOST_CONNECTIONS, MOST_PAGES
from tools.running import canfb, running
from tools.site.markdown import table

GROUP, NODE, OTHERS_ID = "239.74.163.128", 0x20, 0x3A0
SKB_BYTES = 768  # that a waiting frame takes of the queue
LOOK_S = 0.005
PATIENCE_S = 120.0
MOST_GROWTH_BYTES = 20 << 20  # resident: what the allocator keeps
MOST_LINES = 100
SPARE = 2  # files: a thread that begins, a log that is written
LONGEST_REST_S = 90.0
HEAD = (
    "attack",
    "tried",
    "let in",
    "largest message",
    "memory MB",
    "files",
    "frames waiting",
    "dropped",
    "page after s",
)

CONFIG = f"""\
bus: {{interface: udp_multicast, channel: {GROUP}}}
modules:
  - {{node_id: {NODE}, autostart: true, sync_timeout_periods: 200}}
simulation:
  motion: {{standstill_s: 1, ramp_s: 5, rpm: 60}}
"""


@dataclass(frozen=True)
class Network:
    """Module, machine and scope: process, log and address of the scope, and the code of its writing tasks."""

    scope: subprocess.Popen[bytes]
    log: Path
    where: SplitResult
    code: str


@contextlib.contextmanager
def network_in(folder: Path) -> Iterator[Network]:
    """A network whose files are in this folder."""
    config, log = folder / "network.yaml", folder / "scope.log"
    config.write_text(CONFIG)
    with contextlib.ExitStack() as held:

        def start(command: str, *arguments: str) -> subprocess.Popen[bytes]:
            output = held.enter_context((folder / f"{command}.log").open("wb"))
            return held.enter_context(running(canfb(command, *arguments), output))

        start("run", str(config))
        start("simulate", str(config), "--rate", "100", "--autostart")
        scope = start("scope", "--config", str(config), "--write")
        give_up_s = time.monotonic() + PATIENCE_S
        while "http://" not in (said := log.read_text()):
            if time.monotonic() > give_up_s or scope.poll() is not None:
                sys.exit(f"canfb scope did not start: {said}")
            time.sleep(0.1)
        words = said.split()
        where = urlsplit(next(word for word in words if word.startswith("http://")))
        yield Network(scope, log, where, words[-1])


class Watch:
    """Looks at a process again and again: memory, files, and the queue of its socket of the bus."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._sockets = {
            link[8:-1] for link in self._links() if link.startswith("socket:[")
        }  # before there is any page
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._look)
        self.begin()
        self._thread.start()

    def begin(self) -> None:
        """From here on."""
        self.memory_bytes = self.files = self.waiting = 0
        self._dropped = self._drops()[1]

    @property
    def dropped(self) -> int:
        """Frames since then."""
        return self._drops()[1] - self._dropped

    def now(self) -> tuple[int, int]:
        """Memory in bytes, and files."""
        pages = int(Path(f"/proc/{self._pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE"), len(os.listdir(f"/proc/{self._pid}/fd"))

    def _links(self) -> Iterator[str]:
        for one in Path(f"/proc/{self._pid}/fd").iterdir():
            with contextlib.suppress(OSError):
                yield os.readlink(one)

    def _drops(self) -> tuple[int, int]:
        """Bytes that wait, and frames that were dropped."""
        waiting = dropped = 0
        for line in Path("/proc/net/udp").read_text().splitlines()[1:]:
            words = line.split()
            if words[9] in self._sockets:
                waiting += int(words[4].partition(":")[2], 16)
                dropped += int(words[12])
        return waiting, dropped

    def _look(self) -> None:
        while not self._over.wait(LOOK_S):
            with contextlib.suppress(OSError):
                self.waiting = max(self.waiting, self._drops()[0] // SKB_BYTES)
                memory, files = self.now()
                self.memory_bytes, self.files = max(self.memory_bytes, memory), max(self.files, files)

    def end(self) -> None:
        self._over.set()
        self._thread.join()


class Flood:
    """Frames of other nodes, ``rate_hz``, in a thread."""

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz, self._over = rate_hz, threading.Event()
        self._bus = open_bus({"interface": "udp_multicast", "channel": GROUP})
        self._thread = threading.Thread(target=self._send)
        self._thread.start()

    def _send(self) -> None:
        message = can.Message(arbitration_id=OTHERS_ID, data=bytes(8), is_extended_id=False)
        next_s = time.monotonic()
        while not self._over.wait(0.01):
            while next_s < time.monotonic():
                next_s += 1.0 / self._rate_hz
                self._bus.send(message)

    def end(self) -> None:
        self._over.set()
        self._thread.join()
        self._bus.shutdown()


class Page:
    """A websocket of Bokeh, as a page has it."""

    def __init__(self, connection: WebSocketClientConnection) -> None:
        self.connection = connection
        self.largest = 0
        self.names: dict[str, str] = {}

    async def pull(self) -> None:
        """Get the document."""
        await self.send("PULL-DOC-REQ", {})
        while True:
            part = await self.read()
            if part is None:
                raise WebSocketClosedError
            if isinstance(part, str) and '"PULL-DOC-REPLY"' in part:
                await self.read()
                self._find(json.loads(await self.read() or "null"))
                return

    async def read(self) -> str | bytes | None:
        part: str | bytes | None = await self.connection.read_message()
        self.largest = max(self.largest, len(part or ""))
        return part

    async def send(self, kind: str, content: Any) -> None:
        for part in ({"msgid": "1", "msgtype": kind}, {}, content):
            await self.connection.write_message(json.dumps(part))

    async def change(self, model: str, attribute: str, value: object) -> None:
        event = {"kind": "ModelChanged", "model": {"id": model}, "attr": attribute, "new": value}
        await self.send("PATCH-DOC", {"events": [event]})

    async def click(self, name: str) -> None:
        values = {"type": "map", "entries": [["model", {"id": self.names[name]}]]}
        data = {"type": "event", "name": "button_click", "values": values}
        event = {"kind": "MessageSent", "msg_type": "bokeh_event", "msg_data": data}
        await self.send("PATCH-DOC", {"events": [event]})

    async def read_for(self, seconds: float) -> None:
        """Take what comes, as a browser does."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                while await self.read() is not None:
                    pass

    def _find(self, part: Any) -> None:
        if isinstance(part, dict):
            attributes = part.get("attributes")
            if "id" in part and isinstance(attributes, dict):
                name = attributes.get("name") or part.get("name")
                if isinstance(name, str):
                    self.names[name] = part["id"]
            part = list(part.values())
        if isinstance(part, list):
            for one in part:
                self._find(one)


class Attacker:
    """Does one thing for ``seconds``; counts what was tried and let in."""

    def __init__(self, where: SplitResult, code: str, seconds: float) -> None:
        self.where, self.code, self.seconds = where, code, seconds
        self.origin = {"Origin": f"http://{where.netloc}"}
        self.count: Counter[str] = Counter()
        self.largest = 0

    @property
    def left(self) -> Iterator[None]:
        """While there is time."""
        end_s = time.monotonic() + self.seconds
        while time.monotonic() < end_s:
            yield None

    async def ticket(self) -> str:
        """Empty if it is refused."""
        headers = {**self.origin, "Authorization": f"Bearer {self.where.fragment}"}
        request = HTTPRequest(
            f"http://{self.where.netloc}/session",
            "POST",
            body="",
            headers=headers,
            connect_timeout=PATIENCE_S,
            request_timeout=PATIENCE_S,
        )
        try:
            return str((await AsyncHTTPClient(force_instance=True).fetch(request)).body.decode())
        except (HTTPClientError, OSError, StreamClosedError):
            return ""

    async def page(self) -> Page | None:
        """None if it is refused."""
        self.count["tried"] += 1
        ticket = await self.ticket()
        if not ticket:
            return None
        request = HTTPRequest(
            f"ws://{self.where.netloc}/live/ws", headers=self.origin, connect_timeout=PATIENCE_S
        )
        try:
            connection = await websocket_connect(request, subprotocols=["bokeh", ticket])
        except (HTTPClientError, OSError, StreamClosedError):
            return None
        self.count["let in"] += 1
        return Page(connection)

    async def pulled(self) -> Page | None:
        """The same with its document."""
        page = await self.page()
        if page is not None:
            try:
                await page.pull()
            except WebSocketClosedError:
                return None
        return page

    async def connected(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter] | None:
        """A connection of its own."""
        self.count["tried"] += 1
        try:
            return await asyncio.open_connection(self.where.hostname, self.where.port)
        except OSError:
            return None

    async def one_page(self) -> None:
        """What a user does."""
        page = await self.pulled()
        if page is not None:
            await page.read_for(self.seconds)
            self.largest = page.largest
            page.connection.close()

    async def many_pages(self) -> None:
        """Three times as many as there may be, at once; those that are let in are read."""

        async def one() -> None:
            page = await self.pulled()
            if page is not None:
                await page.read_for(self.seconds)
                self.largest = max(self.largest, page.largest)
                page.connection.close()

        await asyncio.gather(*(one() for _ in range(3 * MOST_PAGES)))

    async def pages_storm(self) -> None:
        """Opened and closed at once, again and again, with and without the document."""
        for _ in self.left:
            pages = await asyncio.gather(*((self.page, self.pulled)[n % 2]() for n in range(4)))
            for page in pages:
                if page is not None:
                    page.connection.close()

    async def uploads(self) -> None:
        """Table files as large as a message may be, and larger ones, again and again, with their tasks."""
        file = base64.b64encode(os.urandom(LARGEST_MESSAGE * 3 // 5)).decode()
        for number, _ in enumerate(self.left):
            page = await self.pulled()
            if page is None:
                await asyncio.sleep(0.2)
                continue
            chooser = page.names["FileInput"]
            try:
                for _ in range(20):
                    await page.change(chooser, "filename", "table.yaml")
                    await page.change(chooser, "value", file)
                    await page.change(page.names["code"], "value", self.code)
                    for button in ("Upload table", "yes", "Save", "yes"):
                        await page.click(button)
                if number % 3 == 2:
                    await page.change(chooser, "value", file * 3)
                await page.read_for(0.5)
            except (WebSocketClosedError, StreamClosedError):
                self.count["closed"] += 1
            page.connection.close()

    async def silent_pages(self) -> None:
        """Open, ask for the document many times and read nothing: all pages that there may be."""

        async def one() -> None:
            page = await self.page()  # whose client takes no more than a message that nobody reads
            if page is not None:
                with contextlib.suppress(WebSocketClosedError, TimeoutError):
                    async with asyncio.timeout(self.seconds):
                        for _ in range(50):
                            await page.send("PULL-DOC-REQ", {})
                await asyncio.sleep(self.seconds)
                page.connection.close()

        await asyncio.gather(*(one() for _ in range(MOST_PAGES)))

    async def slow_readers(self) -> None:
        """More connections than there may be, each asks for the largest file and does not read it."""
        head = f"GET /{BOKEH_SCRIPTS[0]} HTTP/1.1\r\nHost: {self.where.netloc}\r\n\r\n".encode()

        async def one() -> None:
            stream = await self.connected()
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream[1].write(head * 20)
                    await stream[0].readexactly(1)
                    self.count["let in"] += 1
                    await asyncio.sleep(self.seconds)
                stream[1].close()

        async def bounded() -> None:
            with contextlib.suppress(asyncio.IncompleteReadError, TimeoutError):
                async with asyncio.timeout(2 * self.seconds):
                    await one()

        await asyncio.gather(*(bounded() for _ in range(2 * MOST_CONNECTIONS)))

    async def connections_storm(self) -> None:
        """Opened and closed: at once, within a head, and with a reset."""
        for number, _ in enumerate(self.left):
            stream = await self.connected()
            if stream is None:
                continue
            if number % 3:
                stream[1].write(b"GET / HTTP/1.1\r\nHost: ")
            if number % 3 == 2:
                stream[1].transport.abort()
            stream[1].close()
            if number % 50 == 0:
                await asyncio.sleep(0)


ATTACKS: dict[str, Callable[[Attacker], Awaitable[None]]] = {
    "one page": Attacker.one_page,
    "many pages": Attacker.many_pages,
    "pages opened and closed": Attacker.pages_storm,
    "uploads": Attacker.uploads,
    "pages that do not read": Attacker.silent_pages,
    "downloads that are not read": Attacker.slow_readers,
    "connections opened and closed": Attacker.connections_storm,
}


async def page_after(attacker: Attacker) -> float:
    """Seconds until a new page has its document; infinite if it never has."""
    began_s = time.monotonic()
    while time.monotonic() - began_s < PATIENCE_S:
        page = await attacker.pulled()
        if page is not None:
            page.connection.close()
            return time.monotonic() - began_s
        await asyncio.sleep(0.1)
    return float("inf")


async def settled(watch: Watch, files: int) -> int:
    """The number of files once the pages and connections of an attack are gone."""
    give_up_s = time.monotonic() + LONGEST_REST_S
    while watch.now()[1] > files + SPARE and time.monotonic() < give_up_s:
        await asyncio.sleep(1.0)
    return watch.now()[1]


async def run(network: Network, options: argparse.Namespace) -> tuple[list[list[str]], list[str]]:
    """All rounds: the rows, and what is not good."""
    watch, flood = Watch(network.scope.pid), Flood(options.frames)
    rows, bad = list[list[str]](), list[str]()
    memory: list[int] = []
    try:
        await page_after(Attacker(network.where, network.code, 1.0))
        await asyncio.sleep(GONE_S)
        files = watch.now()[1]
        for _ in range(options.rounds):
            for name, attack in ATTACKS.items():
                if options.only in name:
                    attacker = Attacker(network.where, network.code, options.seconds)
                    watch.begin()
                    lines = network.log.read_text().count("\n")
                    await attack(attacker)
                    counts = attacker.count["tried"], attacker.count["let in"]
                    after_s = await page_after(Attacker(network.where, network.code, 1.0))
                    lines = network.log.read_text().count("\n") - lines
                    figures = f"{watch.memory_bytes / 1e6:.0f}", watch.files, watch.waiting, watch.dropped
                    rows.append(
                        [name, *map(str, (*counts, attacker.largest or "", *figures)), f"{after_s:.1f}"]
                    )
                    print(" | ".join(rows[-1]), file=sys.stderr, flush=True)
                    bad += [f"{name}: {lines} lines of log"] * (lines > MOST_LINES)
                    bad += [f"{name}: no page after it"] * (after_s == float("inf"))
                    bad += [f"{name}: {watch.dropped} frames dropped"] * (watch.dropped > 0)
                    left = await settled(watch, files)
                    bad += [f"{name}: {left} files, {files} before"] * (left > files + SPARE)
            memory.append(watch.now()[0])
        if memory[-1] - memory[0] > MOST_GROWTH_BYTES:
            bad.append(f"memory in MB after the rounds: {', '.join(f'{one / 1e6:.0f}' for one in memory)}")
        rows.append(["at the end", "", "", "", f"{memory[-1] / 1e6:.0f}", str(watch.now()[1]), "", "", ""])
    finally:
        watch.end()
        flood.end()
    return rows, bad


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.soak.scope",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--seconds", type=float, default=10.0, help="of each attack (10)")
    parser.add_argument("--rounds", type=int, default=2, help="of all attacks (2)")
    parser.add_argument("--frames", type=float, default=500.0, help="of other nodes, in a second (500)")
    parser.add_argument("--only", default="", metavar="TEXT", help="attacks with TEXT in their name")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder, network_in(Path(folder)) as network:
        rows, bad = asyncio.run(run(network, options))
        end = network.scope.poll()
    bad += [f"canfb scope ended with {end}"] * (end is not None)
    print("\n".join([*table(HEAD, rows), *bad]))
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
