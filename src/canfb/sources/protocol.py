"""Sources of samples: one interface for a local ADC, a recording and a simulated machine; selection of the
samples of each SYNC from the scans of a converter that samples faster, with its own clock.

Each kind of source is one file, ``*_source.py``, with a subclass of :class:`SourceConfig`.

With n scans and m samples in an interval, the newest sample is the n-th scan after the newest sample of the
previous SYNC; samples are n/m scans apart. Only a drift of the clock against SYNC shifts this grid, by one
scan.
"""

from __future__ import annotations

import contextlib
import importlib
import math
import pkgutil
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import median
from typing import Any, Protocol, runtime_checkable

import canfb.sources
from canfb.errors import CanfbError
from canfb.signal.sample import TICKS, Sample


class Source(Protocol):
    """Gives one sample for each SYNC; it is passive and never waits."""

    def next(self) -> Sample | None:
        """The sample of this SYNC, counts within INTEGER16; None: no sample.

        SourceEnded: no further samples; SourceError: not now.
        """


@runtime_checkable
class Machine(Protocol):
    """A source that moves independently of the sampling."""

    def sample_at(self, now: float) -> Sample | None:
        """The sample at the true time ``now`` of the node, seconds; None: lost."""


@runtime_checkable
class Converter(Protocol):
    """A source that knows the resolution of its converter."""

    @property
    def adc_bits(self) -> int:
        """Bits of a count, 4..16."""


@runtime_checkable
class Grouped(Protocol):
    """A source whose samples contain all pairs of a SYNC, with the time of the newest."""

    @property
    def samples_per_sync(self) -> int:
        """Pairs of sine and cosine in a sample, 1..8."""


class SourceEnded(Exception):
    """A recording has no sample left."""


class SourceError(CanfbError):
    """A source cannot give its sample; the text says what failed and where."""


class Capture(Protocol):
    """An open converter that captures scans.

    :meth:`refill` blocks: only a thread of ``hosting/`` calls it, which need not be that of :meth:`fire` and
    :meth:`cancel`.
    """

    @property
    def adc_bits(self) -> int:
        """Bits of a count, 4..16."""

    @property
    def is_fired(self) -> bool:
        """Whether each scan waits for :meth:`fire`."""

    def fire(self) -> None:
        """Trigger one scan. OSError if that fails."""

    def refill(self) -> Sample | None:
        """Wait for the next scan, at most some seconds; None if there was none. OSError when it ends."""

    def cancel(self) -> None:
        """End :meth:`refill` with an OSError, now and in future calls."""


@dataclass(frozen=True)
class Surroundings:
    """What a source may use when it is opened.

    adc_bits, cycles_per_revolution   of the module
    simulated                         (adc_bits, cycles_per_revolution, interval_s): gives the encoder of
                                      ``simulation:``, sampled every ``interval_s`` seconds
    captured                          (opened, name, wait_s, picked): runs a capture in a thread; returns a
                                      source of the scans selected by ``picked`` (None: the newest); a SYNC
                                      waits ``wait_s`` for the scan that it fired
    resources                         closed when the program ends
    """

    adc_bits: int
    cycles_per_revolution: int
    simulated: Callable[[int, int, float], Source]
    captured: Callable[..., Source]
    resources: contextlib.ExitStack


@dataclass(frozen=True, kw_only=True)
class SourceConfig:
    """The configuration of a source; each kind is a subclass in its own file.

    Its fields are the keys of the YAML, except those with ``metadata={"key": False}``; a list has
    ``metadata={"list": True}``. ValueError for a wrong value; its text begins with the key.

    kind   the word after ``kind:`` that selects this source
    """

    kind: str = ""

    def __post_init__(self) -> None:
        own_kind = type(self).kind
        if self.kind != own_kind:
            raise ValueError(f"kind must be {own_kind} here, not {self.kind!r}")

    @property
    def title(self) -> str:
        return f"source {self.kind!r}"

    def of_module(self, keys: Mapping[str, Any]) -> SourceConfig:
        """This configuration, adapted to a module whose YAML has these ``keys``, defaults excluded."""
        return self

    def check_machine(self) -> None:
        """ConfigError, with the key, for a setting that this machine does not support. Opens nothing."""

    def open(self, surroundings: Surroundings) -> Source:
        """The open source. CanfbError, in one line, if it is unusable."""
        raise NotImplementedError


def column(name: str, value: object) -> None:
    """ValueError unless ``value`` is the name or the number of a column."""
    if isinstance(value, bool) or not isinstance(value, (str, int)) or value == "":
        raise ValueError(f"{name} must be a name or a number from 0, not {value!r}")


ENDING = "_source"


def source_kinds() -> dict[str, type[SourceConfig]]:
    """The class for each word after ``kind:``, in alphabetical order."""
    for _, name, _ in pkgutil.iter_modules(canfb.sources.__path__):
        if name.endswith(ENDING):
            importlib.import_module(f"{canfb.sources.__name__}.{name}")
    found = (kind for kind in SourceConfig.__subclasses__() if kind.__module__.endswith(ENDING))
    return {kind.kind: kind for kind in sorted(found, key=lambda kind: kind.kind)}


SETTLED_S = 1.0  # time without a failure, after which a source is reported to work again
LEAST, MOST = -32768, 32767  # INTEGER16


class SourceWatch:
    """Calls ``ask`` at each SYNC; ``report`` gets a line when the source fails, works again, or has ended."""

    def __init__(self, ask: Callable[[], Sample | None], report: Callable[[str], None]) -> None:
        self._ask = ask
        self._report = report
        self.failed_s: float | None = None  # Time of the last failure; None: it works.
        self.ended = False  # The source has no sample left.

    def sample(self, now: float) -> Sample | None:
        """The sample of the SYNC at ``now`` (seconds), in whole counts; None: missed."""
        if self.ended:
            return None
        try:
            sample = self._ask()
            if sample is not None:
                sample = _checked(sample)
        except SourceEnded:
            self.ended = True
            self._report("the source has ended: no more samples")
            return None
        except Exception as error:  # the node must survive any error of the driver of its converter
            first, self.failed_s = self.failed_s is None, now
            if first:
                self._report(f"the source fails: {_one_line(error)}")
            return None
        if sample is not None and self.failed_s is not None and now - self.failed_s >= SETTLED_S:
            self.failed_s = None
            self._report("the source works again")
        return sample


def _checked(sample: Sample) -> Sample:
    """The sample in whole counts; a single coarse track is dropped. ValueError if it does not fit 2000h."""
    sine, cosine = _counts("sine", sample.sine), _counts("cosine", sample.cosine)
    if not 0.0 < sample.elapsed <= TICKS:
        raise ValueError(f"elapsed {sample.elapsed} is not a number of intervals")
    if sample.zero_pulse is not None and not 0.0 <= sample.zero_pulse <= 1.0:
        raise ValueError(f"zero_pulse {sample.zero_pulse} is not a fraction of the interval")
    coarse_sine = coarse_cosine = None
    if sample.coarse_sine is not None and sample.coarse_cosine is not None:
        coarse_sine = _counts("coarse_sine", sample.coarse_sine)
        coarse_cosine = _counts("coarse_cosine", sample.coarse_cosine)
    earlier = tuple((_counts("sine", one), _counts("cosine", other)) for one, other in sample.earlier)
    return sample._replace(
        sine=sine,
        cosine=cosine,
        coarse_sine=coarse_sine,
        coarse_cosine=coarse_cosine,
        time_100ns=None if sample.time_100ns is None else int(sample.time_100ns) % TICKS,
        earlier=earlier,
    )


def _counts(name: str, value: float) -> int:
    if not math.isfinite(value) or not LEAST <= (counts := round(value)) <= MOST:
        raise ValueError(f"{name} {value} does not fit INTEGER16")
    return counts


def _one_line(error: Exception) -> str:
    text = str(error).strip().splitlines()
    return text[0] if text else type(error).__name__


LEAST_SCANS_PER_SYNC, MOST_SCANS_PER_SYNC = 2, 256
KEPT_INTERVALS = 3
LAGS = 32  # SYNCs over which the least lag of the grid is taken: a single late SYNC is not drift
SETTLE = 64.0  # time constant of the usual distance of scans, in scans
STEP = 0.5  # relative difference from the usual distance beyond which scans are not neighbours
KNOWN_BREAKS = 8
# Scans are counted in blocks of BLOCK_SYNCS. The median of the last BLOCKS, at least LEAST_BLOCKS, may differ
# from the nominal number by MOST_SCANS_OFF scans plus PART_OFF of an interval.
BLOCK_SYNCS, BLOCKS, LEAST_BLOCKS = 16, 16, 4
MOST_SCANS_OFF, PART_OFF = 1.5, 1.0 / 16.0


class EvenScans:
    """Collects scans, and gives ``per_sync`` of the ``scans_per_sync`` for each SYNC."""

    def __init__(self, per_sync: int, scans_per_sync: int) -> None:
        self.per_sync = per_sync
        self._interval = scans_per_sync
        self._apart = scans_per_sync // per_sync
        self._lead = 1 + scans_per_sync // 16  # initial number of scans newer than the newest sample
        self._slack = min(2 + scans_per_sync // 16, scans_per_sync // 4)
        self.forget()

    def forget(self) -> None:
        self._scans: deque[Sample] = deque(maxlen=KEPT_INTERVALS * self._interval + self._lead)
        self._count = 0
        self._last: int | None = None  # scan number of the newest sample of the previous SYNC
        self._lags: deque[int] = deque(maxlen=LAGS)
        self._syncs, self._block_began = 0, 0
        self._blocks: deque[int] = deque(maxlen=BLOCKS)  # scans in each block of BLOCK_SYNCS
        self._usual = 0.0  # usual distance of two scans, 100 ns
        self._breaks: deque[int] = deque(maxlen=KNOWN_BREAKS)  # numbers of scans that follow missing ones
        self._misfit = ""

    def came(self, scan: Sample) -> None:
        if self._scans and scan.time_100ns is not None and self._scans[-1].time_100ns is not None:
            self._follow((scan.time_100ns - self._scans[-1].time_100ns) % TICKS)
        self._scans.append(scan)
        self._count += 1

    def _follow(self, distance: int) -> None:
        usual = self._usual or float(distance)
        low, high = (1.0 - STEP) * usual, (1.0 + STEP) * usual
        if not low < distance < high:
            self._breaks.append(self._count)
        self._usual = usual + (min(max(distance, low), high) - usual) / SETTLE

    def take(self) -> Sample | None:
        """The samples of this SYNC; None: too few scans yet. SourceError if scans are missing, or if their
        number is wrong.
        """
        self._count_sync()
        newest = self._begin() if self._last is None else self._next(self._last)
        if newest is None:
            return None
        self._last = newest
        first = newest - (self.per_sync - 1) * self._apart
        if self._misfit:
            raise SourceError(self._misfit)
        if any(first < one <= newest for one in self._breaks):
            raise SourceError("scans are missing: the buffer has overrun, or the trigger came late")
        chosen = [self._scans[number - self._count] for number in range(newest, first - 1, -self._apart)]
        return chosen[0]._replace(earlier=tuple((one.sine, one.cosine) for one in chosen[1:]))

    def _begin(self) -> int | None:
        newest = self._count - 1 - self._lead
        return newest if newest >= self._interval else None

    def _next(self, last: int) -> int | None:
        interval, latest = self._interval, self._count - 1
        newest = last + interval
        lag = latest - newest
        if lag >= interval:  # SYNCs were missed
            newest += lag // interval * interval
            lag %= interval
        if 2 * lag < -interval:
            return None
        if lag < 0:
            newest, lag = self._moved(newest, lag), 0
        elif len(self._lags) == LAGS and min(self._lags) > self._slack:
            newest, lag = self._moved(newest, 1), lag - 1
        self._lags.append(lag)
        return newest

    def _moved(self, newest: int, scans: int) -> int:
        self._lags = deque((lag - scans for lag in self._lags), maxlen=LAGS)
        return newest + scans

    def _count_sync(self) -> None:
        """Compare the number of scans to the nominal one; the median ignores late and lost SYNCs."""
        self._syncs += 1
        if self._syncs % BLOCK_SYNCS:
            return
        if self._last is not None:
            self._blocks.append(self._count - self._block_began)
        self._block_began = self._count
        if len(self._blocks) >= LEAST_BLOCKS:
            scans, interval = median(self._blocks), self._interval
            fits = abs(scans - BLOCK_SYNCS * interval) <= MOST_SCANS_OFF + PART_OFF * interval
            real = scans / BLOCK_SYNCS
            self._misfit = (
                ""
                if fits
                else f"scans_per_sync is {interval}, but {real:.3g} come with each SYNC; see rate_hz"
            )


class NewestScan:
    """Gives the newest scan that no SYNC has taken."""

    per_sync = 1

    def __init__(self) -> None:
        self._scan: Sample | None = None

    def came(self, scan: Sample) -> None:
        self._scan = scan

    def forget(self) -> None:
        self._scan = None

    def take(self) -> Sample | None:
        scan, self._scan = self._scan, None
        return scan
