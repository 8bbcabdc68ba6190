"""A diagnosis of the running process, on SIGUSR1, and facts of computer, program and bus.

Objects are read in the loop of the bus, a few at a time; a thread writes the file.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import logging
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from canfb.bus.clocks import date_and_time
from canfb.bus.runner import Runner, on_signals
from canfb.cia301.codes import SdoAbort
from canfb.cia301.datatypes import DataType
from canfb.configuration import Config
from canfb.device.node import NodeDevice
from canfb.errors import reason
from canfb.files import as_utf8, replacing
from canfb.hosting.event_log import title_of
from canfb.hosting.state_files import SWITCH_S, small_stack
from canfb.rows import finite

PACKAGES = ("canfb", "python-can", "canopen", "numpy", "PyYAML", "rich", "pylibiio", "uvloop")
MOST_LINES = 500
COMMAND_S = 5.0
UNITS = ("canfb", "canfb-interface")  # tools/systemd
SECRET = re.compile(r"pass|secret|token|credential|^key$|_key$", re.IGNORECASE)
IN_ADDRESS = re.compile(r"//[^/@\s]*@")
HIDDEN = "(left out)"


def versions() -> dict[str, Any]:
    """Versions of canfb, its packages, Python, and the system."""
    packages = {}
    for name in PACKAGES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            packages[name] = metadata.version(name)
    return {
        "packages": packages,
        "python": sys.version.split()[0],
        "system": f"{platform.system()} {platform.release()}",
        "machine": platform.machine(),
    }


def plain(value: Any) -> Any:
    """``value`` for JSON: bytes in hexadecimal, NaN as null; passwords, keys and users in URLs hidden."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = dataclasses.asdict(value)
    if isinstance(value, Mapping):
        secret = {name for name, one in value.items() if one is not None and SECRET.search(str(name))}
        return {str(name): HIDDEN if name in secret else plain(one) for name, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(one) for one in value]
    if isinstance(value, (bytes, bytearray)):
        return value.hex()
    if value is None or isinstance(value, (int, float)):
        return finite(value) if isinstance(value, float) else value
    return IN_ADDRESS.sub(f"//{HIDDEN}@", str(value))


def interface_facts(words: Mapping[str, Any]) -> dict[str, Any]:
    """The options of the bus, and the output of ``ip``."""
    channel = words.get("channel")
    facts: dict[str, Any] = {"words": plain(words)}
    if words.get("interface") == "socketcan" and isinstance(channel, str):
        facts["interface"] = _said(["ip", "-details", "-statistics", "link", "show", "dev", channel])
    return facts


def journal(name: str) -> list[str]:
    """The last lines of canfb@NAME and canfb-interface@NAME."""
    units = [word for unit in UNITS for word in ("-u", f"{unit}@{name}")]
    lines = ["-n", str(MOST_LINES), "-o", "short-iso", "--no-hostname", "--no-pager", "-q"]
    return _said(["journalctl", *units, *lines])


def _said(command: list[str]) -> list[str]:
    program = shutil.which(command[0])
    if program is None:
        return [f"{command[0]} is not installed"]
    try:
        done = subprocess.run(
            [program, *command[1:]], capture_output=True, errors="replace", timeout=COMMAND_S, check=False
        )
    except (OSError, subprocess.SubprocessError) as error:
        return [f"{command[0]}: {error}"]
    return (done.stdout + done.stderr).splitlines()


class KeptLines(logging.Handler):
    """Keeps the last lines of a log."""

    def __init__(self) -> None:
        super().__init__()
        self._lines: deque[tuple[float, str, str]] = deque(maxlen=MOST_LINES)

    def emit(self, record: logging.LogRecord) -> None:
        self._lines.append((record.created, record.levelname, record.getMessage()))

    def lines(self) -> list[str]:
        return [
            f"{datetime.fromtimestamp(at).astimezone().isoformat(' ', 'milliseconds')} {level} {text}"
            for at, level, text in list(self._lines)
        ]


def diagnosis_text(made_by: str, parts: Mapping[str, Any]) -> str:
    whole = {"canfb_diagnosis": 1, "made": date_and_time(), "made_by": made_by, **parts}
    return as_utf8(json.dumps(plain(whole), indent=1, ensure_ascii=False) + "\n")


log = logging.getLogger(__name__)

ENTRIES_AT_ONCE = 10


class SelfDiagnosis:
    """Writes ``canfb-diagnose-PID.json`` into ``folder``: :meth:`request` (also from a signal handler), then
    :meth:`step` repeatedly.
    """

    def __init__(
        self, config: Config, words: Mapping[str, Any], runner: Callable[[], Runner], folder: Path
    ) -> None:
        self._config, self._words, self._runner, self._folder = config, words, runner, folder
        self._kept = KeptLines()
        self._requested = False
        self._working: Iterator[threading.Thread | None] = iter(())

    @contextlib.contextmanager
    def keeping_the_log(self) -> Iterator[None]:
        """Keep the log lines of ``canfb.*`` during the context."""
        logger = logging.getLogger("canfb")
        logger.addHandler(self._kept)
        try:
            yield
        finally:
            logger.removeHandler(self._kept)

    def request(self) -> None:
        self._requested = True

    def step(self, nodes: Sequence[NodeDevice]) -> None:
        """Continue for at most half a millisecond."""
        ended = next(self._working, True) is True
        if ended and self._requested:
            self._working = self._work(nodes)

    def finish(self, nodes: Sequence[NodeDevice]) -> None:
        """Write what was requested."""
        self.step(nodes)
        for thread in self._working:
            if thread is not None:
                thread.join()

    def _work(self, nodes: Sequence[NodeDevice]) -> Iterator[threading.Thread | None]:
        # Gives the thread that writes, while it does. A request meanwhile begins again.
        while self._requested:
            self._requested = False
            yield from self._collect(nodes)
            thread = threading.Thread(
                target=self._write, args=(self._runner().counters,), name="canfb-diagnose", daemon=True
            )
            with small_stack():
                thread.start()
            while thread.is_alive():
                yield thread
            log.info(self._outcome)

    def _collect(self, nodes: Sequence[NodeDevice]) -> Iterator[None]:
        self._nodes: list[dict[str, Any]] = []
        for node in nodes:
            objects: dict[str, Any] = {}
            self._nodes.append(
                {
                    "node_id": node.node_id,
                    "title": title_of(node),
                    "state": node.state.name,
                    "counters": node.counters,
                    "objects": objects,
                }
            )
            entries = [
                one for one in node.dictionary if one.access != "wo" and one.data_type != DataType.DOMAIN
            ]
            for number, entry in enumerate(entries):
                if not number % ENTRIES_AT_ONCE:
                    yield
                try:
                    value = entry.current()
                except SdoAbort as abort:
                    value = f"refused: {abort}"
                objects[f"{entry.index:04X}:{entry.subindex:02X}"] = value

    def _write(self, counters: Any) -> None:
        switch_s = sys.getswitchinterval()
        sys.setswitchinterval(min(SWITCH_S, switch_s))
        try:
            parts = {
                "versions": versions(),
                "configuration": self._config,
                "bus": {**interface_facts(self._words), "counters": counters},
                "nodes": self._nodes,
                "log": self._kept.lines(),
            }
            path = self._folder / f"canfb-diagnose-{os.getpid()}.json"
            with replacing(path, private=True) as part:
                part.write_text(diagnosis_text(f"process {os.getpid()}", parts), encoding="utf-8")
            self._outcome = f"diagnosis written: {path}"
        except Exception as error:  # without this the thread would end unnoticed
            self._outcome = f"no diagnosis in {self._folder}: {reason(error)}"
        finally:
            sys.setswitchinterval(switch_s)


def diagnosing_on_signal(request: Callable[[], None]) -> contextlib.AbstractContextManager[None]:
    """Call ``request`` on SIGUSR1, if the system has that signal."""
    number = getattr(signal, "SIGUSR1", None)
    return on_signals(request, [] if number is None else [number])
