"""What ``canfb scope`` is put together from; needs the libraries of the page."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from canfb.bus.bus_master import BusMaster
from canfb.bus.clocks import date_and_time
from canfb.bus.shared_bus import ListeningThread, SharedBus
from canfb.cli.watch_options import bit_rate_of
from canfb.configuration import Config
from canfb.monitoring.bus_model import BusModel
from canfb.monitoring.layout import NodeLayout, assumed_layout
from canfb.monitoring.snapshot import BusSnapshot
from canfb.monitoring.watching import Watching
from canfb.scope import desk as tasks
from canfb.scope.desk import Desk, ModuleTasks, ScopeTask, TaskResult, Upload, allowed_tasks, result_of
from canfb.scope.scope_page import ScopePage, page_html
from canfb.scope.scope_server import ScopeServer
from canfb.scope.scoping import PausedReading, TaskSteps, TaskThread
from canfb.scope.traces import BusTraces

RATE_HZ = 5.0


class ScopeParts:
    """All of it, before it runs: ``bus`` None for a log, ``layouts`` of the modules that are known."""

    def __init__(
        self,
        options: argparse.Namespace,
        config: Config,
        words: dict[str, Any],
        bus: SharedBus | None,
        layouts: Sequence[NodeLayout],
    ) -> None:
        asks = options.sdo or options.write
        readings = [PausedReading(layout.node_id) for layout in layouts] if asks else []
        self._options, self._bus, self._asks = options, bus, asks
        self._interfaces = {
            one.node_id: None if one.source else one.encoder_interface for one in config.modules
        }
        self._first = layouts[0].node_id if layouts else None
        self._traces = BusTraces()
        self._worker = TaskThread(bus, self._run, self._traces, readings)
        self._desk = Desk(self._worker.begin, allowed_tasks(asks=asks, writes=options.write))
        model = BusModel(layouts, assumed_layout, bit_rate_of(words), only_known=bool(options.nodes))
        self._watching = Watching(model, self._show, RATE_HZ, readings)
        self._soon: Callable[..., None] = lambda call, *arguments: None

    @property
    def page(self) -> str:
        """The HTML of the page, for everybody."""
        return page_html(self._desk)

    @property
    def code(self) -> str | None:
        """Of the tasks that write, for the terminal alone; None: the page changes nothing."""
        return str(self._desk.code) if self._desk.writes else None

    def fill(self, document: Any) -> Callable[[], None]:
        """A page is opened."""
        units = self._options.per_revolution
        return ScopePage(document, self._traces, self._desk, units, self._first).update

    @contextlib.contextmanager
    def running(self, server: ScopeServer) -> Iterator[None]:
        """The threads behind the page run in here; what ends the one that listens ends the server."""
        self._soon = server.loop.soon
        self._worker.loop, self._worker.desk = server.loop, self._desk
        listening = ListeningThread(self._listen, self._watching.stop)
        listening.begin(server.stop)
        if self._asks and self._first is not None:
            self._desk.begin(tasks.READ, self._first)
        try:
            yield
        finally:
            self._worker.end()
            listening.end()

    def _listen(self) -> None:
        if self._bus is None:
            self._watching.log(self._options.log, self._options.speed or 1.0)
        else:
            self._watching.opened(self._bus)

    def _show(self, snapshot: BusSnapshot) -> None:
        self._soon(self._traces.take, snapshot)

    def _run(
        self, task: ScopeTask, node: int, upload: Upload | None, master: BusMaster, steps: TaskSteps
    ) -> TaskResult:
        module = ModuleTasks(master, node, self._interfaces.get(node), date_and_time())
        acts: dict[ScopeTask, Callable[[], TaskResult]] = {
            tasks.READ: lambda: TaskResult(True, []),
            tasks.MEASURE: lambda: module.calibrate(steps, dry_run=True),
            tasks.CALIBRATE: lambda: module.calibrate(steps, dry_run=False),
            tasks.UPLOAD: lambda: module.upload(upload.name, upload.data) if upload else TaskResult(True, []),
            tasks.ACTIVATE: module.activate,
            tasks.SAVE: module.save,
        }
        return result_of(acts[task], module.module)
