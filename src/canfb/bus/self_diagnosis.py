"""A diagnosis of the running process, on SIGUSR1: no SYNC waits for it.

The objects of some hundred entries are read in the loop that serves the bus, some of them at a time, between
frames. What takes longer (versions, the state of the interface, the file) is done by a thread.
"""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import os
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

from canfb.bus.diagnosis_facts import (
    KeptLines,
    configuration_facts,
    diagnosis_text,
    interface_facts,
    versions,
)
from canfb.bus.module_lines import Served, title_of
from canfb.cia301.codes import SdoAbort
from canfb.cia301.datatypes import DataType
from canfb.configuration import Config
from canfb.errors import reason

log = logging.getLogger(__name__)

ENTRIES_AT_ONCE = 10
SWITCH_S = 2e-4  # how long the thread may keep the interpreter from the loop
STACK_BYTES = 1 << 18


class SelfDiagnosis:
    """Writes ``canfb-diagnose-PID.json`` into ``folder`` when asked; a later one replaces it.

    ``counters`` gives those of the bus. :meth:`request` may be called by a signal handler; :meth:`step` is
    called from the loop, some hundred times a second.
    """

    def __init__(
        self, config: Config, words: Mapping[str, Any], counters: Callable[[], Any], folder: Path
    ) -> None:
        self._config, self._words, self._counters, self._folder = config, words, counters, folder
        self._kept = KeptLines()
        self._requested = False
        self._collecting: Iterator[None] | None = None
        self._writing: threading.Thread | None = None
        self._nodes: list[dict[str, Any]] = []
        self._outcome = ""

    @contextlib.contextmanager
    def keeping_the_log(self) -> Iterator[None]:
        """Within this the lines of the loggers ``canfb.*`` are kept."""
        logger = logging.getLogger("canfb")
        logger.addHandler(self._kept)
        try:
            yield
        finally:
            logger.removeHandler(self._kept)
            if self._writing is not None:
                self._writing.join()

    def request(self) -> None:
        """Write a diagnosis soon."""
        self._requested = True

    def step(self, nodes: Sequence[Served]) -> None:
        """Go on with what was requested: ten microseconds as a rule, half a millisecond at most."""
        if self._writing is not None:
            if self._writing.is_alive():
                return
            self._writing = None
            log.info(self._outcome)
        if self._collecting is None:
            if not self._requested:
                return
            self._requested = False
            self._collecting = self._collect(nodes)
        with contextlib.suppress(StopIteration):
            next(self._collecting)
            return
        self._collecting = None
        self._begin_writing()

    def _collect(self, nodes: Sequence[Served]) -> Iterator[None]:
        self._nodes = []
        for one in nodes:
            objects: dict[str, Any] = {}
            node = one.node
            self._nodes.append(
                {
                    "node_id": node.node_id,
                    "title": title_of(one),
                    "state": node.state.name,
                    "counters": dataclasses.asdict(node.counters),
                    "objects": objects,
                }
            )
            for number, entry in enumerate(list(node.dictionary)):
                if entry.access == "wo" or entry.data_type == DataType.DOMAIN:
                    continue
                if not number % ENTRIES_AT_ONCE:
                    yield
                try:
                    objects[f"{entry.index:04X}:{entry.subindex:02X}"] = entry.current()
                except SdoAbort as abort:
                    objects[f"{entry.index:04X}:{entry.subindex:02X}"] = f"refused: {abort}"

    def _begin_writing(self) -> None:
        counters = dataclasses.asdict(self._counters())
        before = threading.stack_size(STACK_BYTES)
        try:
            self._writing = threading.Thread(
                target=self._write, args=(counters,), name="canfb-diagnose", daemon=True
            )
            self._writing.start()
        finally:
            threading.stack_size(before)

    def _write(self, counters: dict[str, int]) -> None:
        switch_s = sys.getswitchinterval()
        sys.setswitchinterval(min(SWITCH_S, switch_s))
        try:
            parts = {
                "versions": versions(),
                "configuration": configuration_facts(self._config),
                "bus": {**interface_facts(self._words), "counters": counters},
                "nodes": self._nodes,
                "log": self._kept.lines(),
            }
            path = self._folder / f"canfb-diagnose-{os.getpid()}.json"
            _replace(path, diagnosis_text(f"process {os.getpid()}", parts))
            self._outcome = f"diagnosis written: {path}"
        except Exception as error:  # a thread that dies would leave no trace
            self._outcome = f"no diagnosis: {reason(error)}"
        finally:
            sys.setswitchinterval(switch_s)


def _replace(path: Path, text: str) -> None:
    """Write it whole, readable by its owner alone; a link of this name is not followed."""
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            file.write(text)
        os.replace(name, path)
    except OSError:
        os.unlink(name)
        raise


@contextlib.contextmanager
def diagnosing_on_signal(request: Callable[[], None]) -> Iterator[None]:
    """Call ``request`` on SIGUSR1, where the system has it; the handler before is put back at the end."""

    def handle(number: int, frame: FrameType | None) -> None:
        request()

    number = getattr(signal, "SIGUSR1", None)
    if number is None:
        yield
        return
    before = signal.signal(number, handle)
    try:
        yield
    finally:
        signal.signal(number, before)
