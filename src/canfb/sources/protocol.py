"""Where samples come from: one interface for a local ADC, a recording and a simulated machine; those of
each SYNC out of the scans of a converter that samples faster, by a clock of its own.

A kind of source is one file, ``*_source.py``, with a subclass of :class:`SourceConfig`.

With n scans in an interval the newest sample is the n-th scan after that of the SYNC before, and the others
are n/m scans apart. Only the drift of the clock against SYNC moves this grid, by one scan.
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
        """The sample of this SYNC, counts within INTEGER16; None where there is none.

        SourceEnded: none will come any more; SourceError: not now.
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
        """Pairs of sine and cosine in a sample, 1..8."""


class SourceEnded(Exception):
    """A recording has no sample left."""


class SourceError(CanfbError):
    """A source that cannot give its sample; the text says what and where."""


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


class SimulatedMachine(Protocol):
    """The machine of the ``simulation:`` section."""

    def source(self, adc_bits: int, cycles_per_revolution: int, interval_s: float) -> Source:
        """Its encoder, sampled once every ``interval_s`` seconds."""


@dataclass(frozen=True)
class Surroundings:
    """What there is for a source that is opened.

    adc_bits, cycles_per_revolution   of the module
    simulation                        gives the simulated machine
    captured                          (opened, name, wait_s, picked): runs a capture in a thread, and gives
                                      a source of the scans that are picked, the newest without; a SYNC
                                      waits ``wait_s`` for a scan that it has fired
    resources                         what is entered there is closed when the program ends
    """

    adc_bits: int
    cycles_per_revolution: int
    simulation: Callable[[], SimulatedMachine]
    captured: Callable[..., Source]
    resources: contextlib.ExitStack


@dataclass(frozen=True, kw_only=True)
class SourceConfig:
    """One source, as the configuration has it; each kind is a class of its own, in a file of its own.

    Its fields are the keys of the YAML, but those with ``metadata={"key": False}``; one that holds a list
    has ``metadata={"list": True}``. ValueError for a wrong value, with the name of the key before all.

    kind   the word after ``kind:``: which source it is
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
        """The same, for a module with these keys in its configuration: those alone that are there."""
        return self

    def check_machine(self) -> None:
        """ConfigError, which names the key, for what cannot be on this machine. Nothing is opened."""

    def open(self, surroundings: Surroundings) -> Source:
        """The source. CanfbError, in one line, for one that cannot be used."""
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


SETTLED_S = 1.0  # without a failure, before a source is said to work again
LEAST, MOST = -32768, 32767  # INTEGER16


class SourceWatch:
    """Calls ``ask`` at each SYNC; ``report`` gets a line when the source fails, works again, or has ended."""

    def __init__(self, ask: Callable[[], Sample | None], report: Callable[[str], None]) -> None:
        self._ask = ask
        self._report = report
        self.failed_s: float | None = None  # When it failed last; None: it works.
        self.ended = False  # The source has no sample left.

    def sample(self, now: float) -> Sample | None:
        """The sample of the SYNC at ``now`` (seconds), in whole counts; None for a missed one."""
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
        except Exception as error:  # a node on a bus outlives its converter, with any error of the driver
            first, self.failed_s = self.failed_s is None, now
            if first:
                self._report(f"the source fails: {_one_line(error)}")
            return None
        if sample is not None and self.failed_s is not None and now - self.failed_s >= SETTLED_S:
            self.failed_s = None
            self._report("the source works again")
        return sample


def _checked(sample: Sample) -> Sample:
    """The sample in whole counts; half a coarse track is not used. ValueError for what no object can hold."""
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
LAGS = 32  # SYNCs over which the lag of the grid is watched: one that is late is no drift
SETTLE = 64.0  # scans over which their usual distance is followed
STEP = 0.5  # relative to it: a distance that differs by more is no distance of neighbours
KNOWN_BREAKS = 8
BLOCK_SYNCS, BLOCKS, LEAST_BLOCKS = 16, 16, 4  # in which scans are counted, to hold their number against
MOST_SCANS_OFF, PART_OFF = 1.5, 1.0 / 16.0  # of a block; and so much of an interval


class EvenScans:
    """Takes scans as they come, and gives ``per_sync`` of ``scans_per_sync`` for each SYNC."""

    def __init__(self, per_sync: int, scans_per_sync: int) -> None:
        self.per_sync = per_sync
        self._interval = scans_per_sync
        self._apart = scans_per_sync // per_sync
        self._lead = 1 + scans_per_sync // 16  # scans that are newer than the newest sample, at the start
        self._slack = min(2 + scans_per_sync // 16, scans_per_sync // 4)
        self.forget()

    def forget(self) -> None:
        self._scans: deque[Sample] = deque(maxlen=KEPT_INTERVALS * self._interval + self._lead)
        self._count = 0
        self._last: int | None = None  # the newest sample of the SYNC before, by the number of its scan
        self._lags: deque[int] = deque(maxlen=LAGS)
        self._syncs, self._block_began = 0, 0
        self._blocks: deque[int] = deque(maxlen=BLOCKS)  # scans that have come in this many SYNCs
        self._usual = 0.0  # 100 ns, from scan to scan
        self._breaks: deque[int] = deque(maxlen=KNOWN_BREAKS)  # scans before which others are missing
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
        """The samples of this SYNC; None: too few scans. SourceError for missing ones, or a wrong number of
        them.
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
        if lag >= interval:  # SYNCs that were missed
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
        """Hold the scans that come against those that should; blocks with a late or a lost SYNC are few."""
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
