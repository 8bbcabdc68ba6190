"""Reports that a program is on its bus: by a file, to systemd."""

from __future__ import annotations

import logging
import math
import os
import re
import socket
from collections.abc import Callable, Mapping
from pathlib import Path

from canfb.errors import CanfbError, ConfigError, saying
from canfb.files import replacing

log = logging.getLogger(__name__)

OURS = re.compile(rb"[0-9]{1,10}\n")
READY, STOPPING, WATCHDOG = b"READY=1", b"STOPPING=1", b"WATCHDOG=1"
WATCHDOG_PART = 0.25  # interval of notifications, part of the time-out of systemd's watchdog


class Readiness:
    """Context of a run: ``path`` contains the process id after :meth:`ready`; ConfigError if unusable.

    Under systemd (sd_notify(3)) it sends READY=1, STOPPING=1 and, with ``WATCHDOG_USEC``, WATCHDOG=1.
    """

    def __init__(
        self,
        path: str | Path | None = None,
        report: Callable[[str], None] = log.warning,
        environment: Mapping[str, str] = os.environ,
    ) -> None:
        self._path = None if path is None else Path(path)
        self._report = report
        self._socket = environment.get("NOTIFY_SOCKET", "")
        self._watched_s = _watchdog_s(environment) if self._socket else 0.0
        self._alive_s = -math.inf  # next time to notify the watchdog

    def __enter__(self) -> Readiness:
        if self._path is not None:
            _clear(self._path)
        return self

    def __exit__(self, *raised: object) -> None:
        self._notify(STOPPING)
        if self._path is not None and _process_of(self._path) == os.getpid():
            self._path.unlink(missing_ok=True)

    def ready(self) -> None:
        """Report that the program is on the bus. CanfbError if the file cannot be written."""
        if self._path is not None:
            with (
                saying(CanfbError, f"--ready-file {self._path}", OSError),
                replacing(self._path) as unfinished,  # so a reader never finds a partial file
            ):
                unfinished.write_text(f"{os.getpid()}\n")
        self._notify(READY)

    def alive(self, now: float) -> None:
        if self._watched_s and now >= self._alive_s:
            self._alive_s = now + WATCHDOG_PART * self._watched_s
            self._notify(WATCHDOG)

    def _notify(self, state: bytes) -> None:
        if not self._socket:
            return
        # A leading @ means an abstract socket.
        address = "\0" + self._socket[1:] if self._socket.startswith("@") else self._socket
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notifying:
                notifying.connect(address)
                notifying.send(state)
        except OSError as error:
            self._report(f"NOTIFY_SOCKET {self._socket}: {error.strerror or error}")


def _watchdog_s(environment: Mapping[str, str]) -> float:
    try:
        watched = int(environment.get("WATCHDOG_PID", os.getpid())) == os.getpid()
        return 1e-6 * int(environment.get("WATCHDOG_USEC", 0)) if watched else 0.0
    except ValueError:
        return 0.0


def _clear(path: Path) -> None:
    """Remove the file of a killed program; that of a running one stays until this program is ready."""
    with saying(ConfigError, f"--ready-file {path}", OSError):
        if path.exists() or path.is_symlink():
            process = _process_of(path)
            if process is None:
                raise ConfigError(
                    f"--ready-file {path}: exists, and is not a ready file; choose another name"
                )
            if process == os.getpid() or not Path("/proc", str(process)).exists():
                path.unlink()
        elif not os.access(path.parent, os.W_OK):
            os.stat(path.parent)  # raises if the folder does not exist
            raise ConfigError(f"--ready-file {path}: Permission denied")


def _process_of(path: Path) -> int | None:
    content = path.read_bytes()[:16] if path.is_file() else b""
    return int(content) if OURS.fullmatch(content) else None
