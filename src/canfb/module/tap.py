"""Who listens to every sample: the recording and the module's own reference measurement."""

from __future__ import annotations

from typing import Protocol

from canfb.signal.feedback import Feedback
from canfb.signal.sample import Sample


class Tap(Protocol):
    """Gets every sampling interval while it is open, after the position of it was published."""

    def take(self, sample: Sample, feedback: Feedback) -> None:
        """A sample, and what the chain made of it."""

    def miss(self) -> None:
        """A SYNC without a sample."""


class Taps:
    """The present listeners; usually none."""

    __slots__ = ("open",)

    def __init__(self) -> None:
        self.open: tuple[Tap, ...] = ()

    def add(self, tap: Tap) -> None:
        """Let it hear from the next sample on; nothing happens when it does already."""
        if tap not in self.open:
            self.open = (*self.open, tap)

    def remove(self, tap: Tap) -> None:
        """No more samples for it."""
        self.open = tuple(one for one in self.open if one is not tap)

    def take(self, sample: Sample, feedback: Feedback) -> None:
        """A sample for all of them."""
        for tap in self.open:
            tap.take(sample, feedback)

    def miss(self) -> None:
        """No sample, for all of them."""
        for tap in self.open:
            tap.miss()
