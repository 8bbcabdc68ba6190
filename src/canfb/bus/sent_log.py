"""What replayed modules send, as a bus log."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Self

import can

from canfb.bus.bus_log import BusLog
from canfb.cia301.frame import Frame

CHANNEL = 0


class SentLog:
    """A context manager: give it frames with stamps by :meth:`take`. Errors as those of BusLog."""

    def __init__(self, path: Path) -> None:
        self._log = BusLog(path, overwrite=True)

    def __enter__(self) -> Self:
        self._log.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._log.__exit__(kind, error, trace)

    def take(self, frame: Frame) -> None:
        """One more frame."""
        self._log.write(
            can.Message(
                timestamp=frame.timestamp or 0.0,
                arbitration_id=frame.can_id,
                data=frame.data,
                is_remote_frame=frame.rtr,
                is_extended_id=False,
                channel=CHANNEL,
            )
        )
