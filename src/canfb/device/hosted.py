"""What a host asks of a device: the runner on a real bus, and the embedded bus."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol, runtime_checkable

from canfb.cia301.frame import Frame
from canfb.device.routing import CanIds


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


@runtime_checkable
class Selective(Protocol):
    """A device that says what it listens to, as FeedbackModule does.

    A host need not give it other frames. Its deadline moves in calls of its own only, or is looked for
    late, some hundred times a second.
    """

    def can_ids(self) -> CanIds:
        """The CAN-IDs that it listens to."""

    def follow_can_ids(self, moved: Callable[[], None]) -> None:
        """``moved`` is called in each call after which :meth:`can_ids` may give others."""


@runtime_checkable
class Ending(Protocol):
    """A device that has something to do when the program ends, as FeedbackModule has."""

    def end(self, now: float) -> None:
        """The program ends."""


@runtime_checkable
class Inhibited(Protocol):
    """A device with inhibit times, as FeedbackModule is: they count from when its frames leave."""

    inhibited: Mapping[int | None, object]
    """By CAN-ID: the frames for which ``sent`` is called."""

    def sent(self, can_id: int, now: float) -> None:
        """A frame of its own with this CAN-ID has left."""


@runtime_checkable
class BusWatching(Protocol):
    """A device that is notified when the bus fails and is back, as FeedbackModule."""

    def bus_off(self, now: float) -> list[Frame]:
        """The bus is gone."""

    def bus_back(self, now: float) -> list[Frame]:
        """The bus is back."""


@runtime_checkable
class Computing(Protocol):
    """A device with something to compute now and then, as FeedbackModule is."""

    def pending_job(self) -> Any:
        """The pending computation, None if there is none."""

    def finish_job(self, job: Any, result: Any, now: float) -> list[Frame]:
        """What came out, or an Exception."""

    def job_progress(self, job: Any, part: float) -> None:
        """How far it is, 0..1."""
