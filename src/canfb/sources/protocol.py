"""Where samples come from: one small interface for a local ADC, a recording and a simulated machine."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from canfb.errors import CanfbError
from canfb.signal.sample import Sample


class Source(Protocol):
    """Gives one sample for each SYNC; it is passive and never waits."""

    def next(self) -> Sample | None:
        """The sample of this SYNC, ADC counts within INTEGER16; None where there is none.

        SourceEnded when none will come any more, SourceError where the converter cannot be read: it is
        asked again at the next SYNC.
        """


@runtime_checkable
class Machine(Protocol):
    """A source that turns whether it is sampled or not."""

    def sample_at(self, now: float) -> Sample | None:
        """The sample at the true time ``now`` of the node, seconds; None for one that is lost."""


@runtime_checkable
class Converter(Protocol):
    """A source that knows its converter."""

    @property
    def adc_bits(self) -> int:
        """Bits of a count, 4..16."""


@runtime_checkable
class Grouped(Protocol):
    """A source whose samples hold all pairs of a SYNC, with the time of the newest if there are several."""

    @property
    def samples_per_sync(self) -> int:
        """Pairs of sine and cosine in a sample, 1..4."""


class SourceEnded(Exception):
    """A recording has no sample left."""


class SourceError(CanfbError):
    """A source that cannot give its sample; the text says what and where."""
