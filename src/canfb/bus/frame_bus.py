"""What the runner asks of a bus; there are two: python-can's, and a SocketCAN of our own."""

from __future__ import annotations

from collections.abc import Iterable
from types import TracebackType
from typing import Protocol, Self

# Flags in the CAN-ID of a struct can_frame (linux/can.h).
EXTENDED = 0x8000_0000
REMOTE = 0x4000_0000
ERROR = 0x2000_0000

Received = tuple[int, bytes, float]
"""A frame: its CAN-ID with these flags, its data, and its receive time by the time of day, seconds.

0.0, or any time of another clock, where the bus has none."""


class FrameBus(Protocol):
    """A bus as frames. Use it as a context manager. What fails raises CanError or OSError."""

    def receive(self, wait_s: float) -> list[Received] | None:
        """Wait so long for frames; those that are there, in their order. None: none waits, or can be had."""

    def send(self, can_id: int, data: bytes, remote: bool) -> bool:
        """Send a data or a remote frame; False if the bus takes none now: try again after :meth:`receive`."""

    def hear(self, can_ids: Iterable[int] | None, remote_can_ids: Iterable[int]) -> None:
        """The CAN-IDs of the frames that are needed, None for all; others may be left out from now on."""

    def __enter__(self) -> Self:
        """The bus is open already."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
