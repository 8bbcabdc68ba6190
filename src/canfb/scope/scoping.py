"""What is behind the page of ``canfb scope``: a thread for the task that runs, and which frames it may send.

Their results come into the one thread in which the page is served.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from enum import Enum
from typing import Any

import can

from canfb.bus.bus_master import BusMaster
from canfb.bus.shared_bus import Refusal, SharedBus
from canfb.cia301 import cob
from canfb.cia301.frame import Frame
from canfb.errors import CanfbError
from canfb.monitoring.sdo_reading import ANSWER_S, SdoReading
from canfb.objects import Multiplexer
from canfb.scope.desk import Desk, ScopeTask, TaskResult, Upload
from canfb.scope.traces import BusTraces
from canfb.view.pdo_map import Number


class ScopeLoop:
    """Calls what other threads bring, in the thread of the server."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop

    def soon(self, call: Callable[..., object], *arguments: Any) -> None:
        """From any thread; nothing happens once the server has ended."""
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(call, *arguments)


READING = (2, 3, 4, 5)
"""Client command specifiers that do not download: upload, segments, abort, block (CiA 301, 7.2.4.3)."""
LOWEST_NODE, HIGHEST_NODE, SDO_BYTES = 1, 127, 8


class SendRule(Enum):
    """Asked for each frame before it goes to the bus."""

    NOTHING = "canfb scope only listens: start it with --sdo or --write"
    READS = "this only reads: canfb scope sends what writes with --write, for the tasks that say so"
    ALL = ""

    def permits(self, can_id: int, data: bytes) -> bool:
        """Whether a data frame may be sent."""
        if self is not SendRule.READS:
            return self is SendRule.ALL
        node = can_id - cob.SDO_REQUEST
        return LOWEST_NODE <= node <= HIGHEST_NODE and len(data) == SDO_BYTES and data[0] >> 5 in READING


def send_rule(*, asks: bool, writes: bool) -> SendRule:
    """By the options ``--sdo`` and ``--write``."""
    if writes:
        return SendRule.ALL
    return SendRule.READS if asks else SendRule.NOTHING


log = logging.getLogger(__name__)

TICK_S = 0.1
UNKNOWN = "the state of the module was not read back: read the table to see it"


class TaskSteps:
    """What a task reports of its progress; from its thread."""

    def __init__(self, loop: ScopeLoop, desk: Desk, stopped: threading.Event) -> None:
        self._loop, self._desk, self._stopped = loop, desk, stopped
        self._said_s = 0.0

    def step(self, text: str) -> None:
        """A new step begins."""
        self._loop.soon(self._desk.step, text)

    def part(self, part: float) -> None:
        """So much of the step is done, 0..1."""
        if self._stopped.is_set():
            raise CanfbError("canfb scope ends")
        if time.monotonic() - self._said_s >= TICK_S:
            self._said_s = time.monotonic()
            self._loop.soon(self._desk.part, part)

    def clear(self) -> None:
        """Nothing to take away."""


RunTask = Callable[[ScopeTask, int, Upload | None, BusMaster, TaskSteps], TaskResult]
"""Does a task on a node with a master. What it raises is a program error."""


def refusal_of(rule: SendRule) -> Refusal:
    """The rule for messages of python-can."""

    def refusal(message: can.Message) -> str:
        classic = not (message.is_extended_id or message.is_remote_frame or message.is_fd)
        if rule is SendRule.ALL or (classic and rule.permits(message.arbitration_id, bytes(message.data))):
            return ""
        return str(rule.value)

    return refusal


class TaskThread:
    """Runs one task at a time, on a branch of the shared bus; the readings of the monitor pause meanwhile."""

    def __init__(
        self, bus: SharedBus | None, run: RunTask, traces: BusTraces, readings: list[PausedReading]
    ) -> None:
        self._bus, self._run, self._traces, self._readings = bus, run, traces, readings
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None
        self.loop: ScopeLoop | None = None
        self.desk: Desk | None = None

    def begin(self, task: ScopeTask, node: int, upload: Upload | None) -> None:
        """In a thread of its own."""
        self._thread = threading.Thread(target=self._work, args=(task, node, upload), name="canfb scope task")
        self._thread.start()

    def end(self) -> None:
        """A task that runs is interrupted, and puts back what was before."""
        self._stopped.set()
        if self._thread is not None:
            self._thread.join()

    def _work(self, task: ScopeTask, node: int, upload: Upload | None) -> None:
        loop, desk, bus = self.loop, self.desk, self._bus
        assert loop is not None
        assert desk is not None
        assert bus is not None
        try:
            rule = SendRule.ALL if task.writes else SendRule.READS
            with self._paused(), BusMaster(bus.branch(refusal_of(rule))) as master:
                result = self._run(task, node, upload, master, TaskSteps(loop, desk, self._stopped))
        except CanfbError as error:
            result = TaskResult(False, [str(error), UNKNOWN])
        except Exception as error:
            log.warning("program error in %s: %r", task.label, error)
            result = TaskResult(False, [f"program error: {error!r}", UNKNOWN])
        if result.active is not None:
            loop.soon(self._traces.of(node).know, result.active)
        loop.soon(desk.end, result)

    @contextlib.contextmanager
    def _paused(self) -> Iterator[None]:
        """There is one SDO channel: the answer to what was asked last must not come in between."""
        for reading in self._readings:
            reading.paused = True
        try:
            if self._readings:
                time.sleep(ANSWER_S)
            yield
        finally:
            for reading in self._readings:
                reading.paused = False


class PausedReading(SdoReading):
    """Reads nothing while ``paused``."""

    paused = False

    def next(self, now: float) -> Frame | None:
        """As in SdoReading."""
        return None if self.paused else super().next(now)

    def receive(self, frame: Frame) -> Mapping[Multiplexer, Number]:
        """As in SdoReading."""
        return {} if self.paused else super().receive(frame)
