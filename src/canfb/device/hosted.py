"""What a host asks of a device: the runner on a real bus, and the embedded bus."""

from __future__ import annotations

from typing import Protocol

from canfb.cia301.frame import Frame


class Device(Protocol):
    """A sans-I/O device, as FeedbackModule and EncoderInterface are. Times in seconds, monotonic."""

    def start(self, now: float) -> list[Frame]:
        """Power-on at ``now``."""

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Take a frame of another device."""

    def tick(self, now: float) -> list[Frame]:
        """Do what is due."""

    def deadline(self) -> float | None:
        """When tick is due."""
