"""What is behind the page of ``canfb scope``: a thread that listens, and one for the task that runs."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping

import can

from canfb.bus.master import BusMaster
from canfb.bus.scope_loop import ScopeLoop
from canfb.bus.shared_bus import Refusal, SharedBus
from canfb.cia301.frame import Frame
from canfb.errors import CanfbError
from canfb.monitoring.sdo_reading import ANSWER_S, SdoReading
from canfb.objects import Multiplexer
from canfb.scope.desk import Desk, ScopeTask, TaskResult, Upload
from canfb.scope.send_rule import SendRule
from canfb.scope.traces import BusTraces
from canfb.view.pdo_map import Number

log = logging.getLogger(__name__)

END_S = 10.0
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


class ListeningThread:
    """Runs ``listen`` in a thread until it ends; ``ended`` is called then, from that thread."""

    def __init__(self, listen: Callable[[], None], stop: Callable[[], None]) -> None:
        self._listen, self._stop = listen, stop
        self._error: Exception | None = None
        self._ended: Callable[[], None] = lambda: None
        self._thread = threading.Thread(target=self._work, name="canfb scope listening")

    def begin(self, ended: Callable[[], None]) -> None:
        """Begin; ``ended`` is called where it fails."""
        self._ended = ended
        self._thread.start()

    def end(self) -> None:
        """Stop it; what it has raised is raised here."""
        self._stop()
        self._thread.join(END_S)
        if self._error is not None:
            raise self._error

    def _work(self) -> None:
        try:
            self._listen()
        except Exception as error:
            self._error = error
            self._ended()
