"""What a source may ask of the program that runs its module, and a converter of the thread that reads it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from canfb.signal.sample import Sample
from canfb.sources.protocol import Source


class Capture(Protocol):
    """An open converter that captures scans. It may block: only a thread of ``bus/`` waits for it.

    :meth:`refill` may be called in another thread than :meth:`fire` and :meth:`cancel`.
    """

    @property
    def adc_bits(self) -> int:
        """Bits of a count, 4..16."""

    @property
    def is_fired(self) -> bool:
        """Each scan waits for :meth:`fire`."""

    def fire(self) -> None:
        """Have one scan taken. OSError if that fails."""

    def refill(self) -> Sample | None:
        """Wait for the next scan, some seconds at most; None if there was none. OSError when it ends."""

    def cancel(self) -> None:
        """Let :meth:`refill` end with an OSError, now and ever after."""


class Picked(Protocol):
    """Which scans are the sample of a SYNC: :mod:`canfb.sources.even_scans`."""

    @property
    def per_sync(self) -> int:
        """Pairs of sine and cosine in a sample, 1..4."""

    def came(self, scan: Sample) -> None:
        """A scan, in the order in which they are taken."""

    def forget(self) -> None:
        """What has come is of no use any more."""

    def take(self) -> Sample | None:
        """The sample of this SYNC; None where there is none. SourceError."""


class Captured(Protocol):
    """Runs a capture in a thread, and gives a sample of its scans for each SYNC."""

    def __call__(
        self, opened: Callable[[], Capture], name: str, wait_s: float, picked: Picked | None
    ) -> Source:
        """The source. What ``opened`` raises now goes through; later it is tried again every second.

        ``name`` is that of the thread. A SYNC waits ``wait_s`` for a scan that it has fired. ``picked``
        chooses the scans; None: the newest is the sample.
        """


class SimulatedMachine(Protocol):
    """The machine of the ``simulation:`` section."""

    def source(self, adc_bits: int, cycles_per_revolution: int, interval_s: float) -> Source:
        """Its encoder, sampled once every ``interval_s`` seconds."""


@dataclass(frozen=True)
class Surroundings:
    """What there is for a source that is opened.

    adc_bits, cycles_per_revolution   of the module
    simulation                        the simulated machine
    captured                          threads for converters
    resources                         what is entered there is closed when the program ends
    """

    adc_bits: int
    cycles_per_revolution: int
    simulation: SimulatedMachine
    captured: Captured
    resources: contextlib.ExitStack
