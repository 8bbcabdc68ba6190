"""Recording a bus into a log, in the formats of python-can; also what replayed modules send."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Self

import can
from can.io.generic import MessageWriter

from canfb.bus.frame_bus import Reception, brings_own_frames_back
from canfb.cia301.frame import Frame
from canfb.errors import CanfbError, ConfigError, reason
from canfb.logfile.log_files import NEEDS_PACKAGE, WRITABLE, check_suffix

log = logging.getLogger(__name__)

LONGEST_WAIT_S = 0.1  # how late a signal or the end may be noticed
UDP_MULTICAST = "udp_multicast"
ROTATED = frozenset({".asc", ".blf", ".log"})  # python-can's SizedRotatingLogger


class BusLog:
    """Writes what a bus receives into a file until :meth:`stop`. Use it as a context manager.

    A bus that fails is tried again, and an interface that was removed and made again is opened.

    With ``max_bytes`` a file that has become as large is renamed, and the next one begins. ConfigError for a
    suffix, size or place that cannot be, and for a file that is there unless ``overwrite``; CanfbError when
    the file fails.

    ``clock`` and ``sleep`` are those of the system, but for tests.
    """

    def __init__(
        self,
        path: Path,
        max_bytes: int = 0,
        overwrite: bool = False,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.path = path
        self.frames = self.error_frames = 0
        self._max_bytes = max_bytes
        self._clock, self._sleep = clock, sleep
        self._stopped = False
        self._writer: MessageWriter | None = None
        suffix = check_suffix(path, WRITABLE)
        if max_bytes and "".join(path.suffixes[-1:]).lower() not in ROTATED:
            raise ConfigError(f"--max-size: python-can divides {', '.join(sorted(ROTATED))}, not {suffix}")
        if not path.parent.is_dir():
            raise ConfigError(f"{path}: there is no folder {path.parent}")
        if path.exists() and (not overwrite or not path.is_file()):
            raise ConfigError(f"{path}: is there already; take another name, or --force")

    def __enter__(self) -> Self:
        options: dict[str, Any] = {"max_bytes": self._max_bytes} if self._max_bytes else {}
        writer: Callable[..., MessageWriter] = can.SizedRotatingLogger if self._max_bytes else can.Logger
        try:
            self._writer = writer(str(self.path), **options)
        except (NotImplementedError, ImportError) as error:
            raise CanfbError(f"{self.path}: {NEEDS_PACKAGE}") from error
        except (OSError, ValueError) as error:
            raise CanfbError(f"{self.path}: cannot be written: {reason(error)}") from error
        return self

    def __exit__(self, *raised: object) -> None:
        with self._writing(suppress=raised[0] is not None):
            writer, self._writer = self._writer, None
            if writer is not None:
                writer.stop()

    @contextlib.contextmanager
    def _writing(self, *, suppress: bool = False) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            # What is in its buffer cannot be written either.
            writer, self._writer = self._writer, None
            with contextlib.suppress(OSError):
                if writer is not None:
                    writer.stop()
            if not suppress:
                raise CanfbError(f"{self.path}: cannot be written: {reason(error)}") from error

    def stop(self) -> None:
        self._stopped = True

    def record(self, bus: can.BusABC, seconds: float | None = None) -> None:
        """Write what comes for ``seconds``; None: until :meth:`stop`.

        The frames of udp_multicast, in which each sender names the channel as it likes, get one name.
        """
        name = UDP_MULTICAST if brings_own_frames_back(bus) else None
        reception = Reception(bus, log.warning, self._clock, self._sleep, lasts=True)
        end = None if seconds is None else self._clock() + seconds
        while not self._stopped:
            left = LONGEST_WAIT_S if end is None else end - self._clock()
            if left <= 0.0:
                return
            message = reception.receive(min(left, LONGEST_WAIT_S))
            if message is not None:
                if name is not None:
                    message.channel = name
                self.write(message)

    def write(self, message: can.Message) -> None:
        assert self._writer is not None
        with self._writing():
            self._writer.on_message_received(message)
        self.frames += 1
        self.error_frames += message.is_error_frame

    def take(self, frame: Frame) -> None:
        """A frame with its stamp."""
        can_id, data, rtr, stamp = frame
        self.write(can.Message(stamp or 0.0, can_id, False, rtr, channel=0, data=data))
