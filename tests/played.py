"""Sources of samples, and senders of frames, as a test lists them."""

import contextlib
import itertools
from collections.abc import Callable, Iterable
from typing import Any

from canfb import Frame, Sample
from canfb.device.core import NEVER
from canfb.sources.protocol import Source, SourceEnded


class Listed:
    """A source of samples, pairs of counts, None (a lost one), errors; it was asked ``taken`` times."""

    def __init__(self, samples: Iterable[Sample | tuple[int, int] | Exception | None]) -> None:
        self._samples = iter(samples)
        self.taken = 0

    def next(self) -> Sample | None:
        self.taken += 1
        try:
            sample = next(self._samples)
        except StopIteration:
            raise SourceEnded from None
        if isinstance(sample, Exception):
            raise sample
        return sample if sample is None or isinstance(sample, Sample) else Sample(*sample)


def repeated(*samples: Sample | tuple[int, int] | Exception | None) -> Listed:
    """A source whose last sample comes again and again."""
    return Listed(itertools.chain(samples, itertools.repeat(samples[-1])))


def until_end(source: Source) -> list[Sample | None]:
    """The samples of a source; a thousand of one that has no end."""
    samples: list[Sample | None] = []
    with contextlib.suppress(SourceEnded):
        while len(samples) < 1000:
            samples.append(source.next())
    return samples


class Changing:
    """A source whose samples a test may change on the way: to others, pairs of counts, None (a lost one)."""

    def __init__(self, source: Any) -> None:
        self.source = source
        self.change: Callable[[Any], Any] = lambda sample: sample

    def next(self) -> Sample | None:
        changed = self.change(self.source.next())
        return None if changed is None else Sample(*changed)


class Still:
    """A source of equal samples."""

    def __init__(self, sine: int = 1000, cosine: int = 0) -> None:
        self._sample = Sample(sine, cosine)

    def next(self) -> Sample:
        return self._sample


class Sender:
    """A node that sends frames at given times, and notes what it hears, with the time."""

    def __init__(self, *frames: tuple[float, Frame]) -> None:
        self._frames = sorted(frames, key=lambda pair: pair[0])
        self.heard: list[tuple[int, float]] = []

    def start(self, now: float) -> list[Frame]:
        return []

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        assert frame.timestamp == now
        self.heard.append((frame.can_id, now))
        return []

    def deadline(self) -> float | None:
        return self._frames[0][0] if self._frames else None

    def tick(self, now: float, until: float = NEVER) -> list[Frame]:
        frames = [frame for at, frame in self._frames if at <= min(now, until)]
        del self._frames[: len(frames)]
        return frames
