"""Samples of both tracks: in memory, in files, and from the bus, by the ADC PDO or a recording object
(2050h)."""

from __future__ import annotations

import contextlib
import csv
import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from canfb import objects as od
from canfb.calibration.over_speeds import sampled_together, speeds
from canfb.calibration.recording import Recording, recorded_tracks, recording
from canfb.master.access import (
    CommissioningError,
    Master,
    NodeAccess,
    ObjectAbsentError,
    OnFrame,
    Progress,
    Unchanged,
    subscribed,
)
from canfb.master.all_or_nothing import put_back
from canfb.signal.phase import ArrayLike, FloatArray
from canfb.signal.sample import TICK_S, TICKS
from canfb.sources.sample_files import read_tracks, with_gaps
from canfb.view.module_view import PdoLayout

# With jittering receive times the rate between pauses is known within about 0.5 %.
LEAST_SKIPPED, SURE_PART = 2, 0.005


@dataclass(frozen=True, eq=False)
class TrackSamples:
    """Both tracks in ADC counts, one sample per interval, NaN: missed.

    rate_hz      rate between pauses; None: not known
    time_s       sample times, rising; None: equidistant
    received_s   receive time of the SYNC of each sample; None: not known
    coarse       coarse sine and cosine, ADC counts, NaN: missed
    at_speed     the analog path changes the harmonics at this speed
    """

    sine: FloatArray
    cosine: FloatArray
    rate_hz: float | None
    origin: str
    time_s: FloatArray | None = None
    received_s: FloatArray | None = None
    coarse: tuple[FloatArray, FloatArray] | None = None
    at_speed: bool = False

    @classmethod
    def of(cls, sine: ArrayLike, cosine: ArrayLike, rate_hz: float | None, origin: str) -> TrackSamples:
        """Samples, in which pairs of -32768 count as missed. ValueError for different lengths."""
        return cls(*with_gaps(sine, cosine), rate_hz, origin)

    def timed(self, stamps: Sequence[int | None]) -> TrackSamples:
        """The same with sample times: ``stamps`` in 100 ns, modulo 2^32; None: interpolated."""
        known = [n for n, stamp in enumerate(stamps) if stamp is not None]
        if len(known) < 2:
            return self
        ticks = np.array([stamps[n] for n in known], np.int64)
        passed = np.concatenate([[0], np.cumsum(np.diff(ticks) % TICKS)])
        step = float(np.median(np.diff(passed) / np.diff(known)))
        # Interpolate missing times linearly; extrapolate with the median step.
        ends = [-1, *known, len(stamps)]
        times = [-step * (known[0] + 1), *passed, passed[-1] + step * (len(stamps) - known[-1])]
        return replace(self, time_s=np.interp(np.arange(len(stamps)), ends, times) * TICK_S)

    def recording(self, adc_bits: int | None) -> Recording:
        return recording(self.sine, self.cosine, self.time_s, None, adc_bits)

    def together(self, cosine_delay_s: float, cycles_per_s: float) -> TrackSamples:
        """The same with the delay of the cosine, ``cosine_delay_s`` (2002:06), removed at this mean speed.

        CommissioningError without a rate, CalibrationError if the samples are on no ellipse.
        """
        if not cosine_delay_s:
            return self
        if not self.rate_hz:
            raise CommissioningError(
                "2002:06 is set, and the rate of the samples is not known: --sample-rate"
            )
        record = recording(self.sine, self.cosine, self.time_s, None, None, may_be_offset=True)
        speed = speeds(record, cycles_per_s / self.rate_hz)
        cosine = sampled_together(record, 2.0 * np.pi * self.rate_hz * cosine_delay_s * speed)
        return replace(self, cosine=cosine, origin=f"{self.origin}, cosine at the instant of the sine")

    def between(self, first: int, stop: int) -> TrackSamples:
        at = slice(first, stop)
        return replace(
            self,
            sine=self.sine[at],
            cosine=self.cosine[at],
            time_s=None if self.time_s is None else self.time_s[at],
            received_s=None if self.received_s is None else self.received_s[at],
            coarse=None if self.coarse is None else (self.coarse[0][at], self.coarse[1][at]),
        )

    def __len__(self) -> int:
        return len(self.sine)

    @property
    def missed(self) -> int:
        return int(np.isnan(self.sine).sum())

    @property
    def duration_s(self) -> float | None:
        times = self.received_s if self.time_s is None else self.time_s
        if times is not None and len(times) > 1 and times[-1] > times[0]:
            return float(times[-1] - times[0]) * len(times) / (len(times) - 1)
        return len(self) / self.rate_hz if self.rate_hz else None

    @property
    def mean_rate_hz(self) -> float | None:
        """Samples per second, pauses included."""
        return len(self) / self.duration_s if self.duration_s else None

    @property
    def skipped(self) -> int:
        if not self.rate_hz or not self.duration_s:
            return 0
        more = round(self.duration_s * self.rate_hz) - len(self)
        return more if more > max(LEAST_SKIPPED, SURE_PART * len(self)) else 0


def write_npz(path: Path, samples: TrackSamples, hertz: float | None = None) -> None:
    """Write INTEGER16 tracks, -32768 for a missed sample, rate_hz (0: not known), time_s, cycles_per_s
    (``hertz``).
    """
    sine, cosine = (
        np.nan_to_num(track, nan=od.MISSED_COUNTS).astype(np.int16)
        for track in (samples.sine, samples.cosine)
    )
    known: dict[str, Any] = {} if samples.time_s is None else {"time_s": samples.time_s}
    if hertz is not None:
        known["cycles_per_s"] = hertz
    np.savez_compressed(
        path,
        sine=sine,
        cosine=cosine,
        rate_hz=samples.rate_hz or 0.0,
        origin=np.array(samples.origin),
        **known,
    )


def write_csv(path: Path, samples: TrackSamples) -> None:
    """Write columns t_s (if the rate is known), sine, cosine; a missed sample has no row."""
    names = ["t_s", "sine", "cosine"] if samples.rate_hz else ["sine", "cosine"]
    with path.open("w", newline="", encoding="ascii") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(names)
        for number, pair in enumerate(zip(samples.sine.tolist(), samples.cosine.tolist(), strict=True)):
            if not math.isnan(pair[0]):
                time = [f"{number / samples.rate_hz:.9g}"] if samples.rate_hz else []
                rows.writerow([*time, *map(int, pair)])


def read_npz(path: Path) -> TrackSamples:
    tracks = read_tracks(path)
    return TrackSamples(tracks.sine, tracks.cosine, tracks.rate_hz, f"file {path.name}", tracks.time_s)


PATIENCE_S = 2.0  # longest wait for a SYNC or a sample, also for the first one
LOOK_S = 0.1
LONGEST = 6.0  # if SYNCs are rare, the measurement takes at most this times the requested duration
PART_MISSED = 0.5
MISSED = (od.MISSED_COUNTS, od.MISSED_COUNTS)


NEWEST, COARSE, TIME = 0, -1, -2  # parts of a sample; 1, 2, .. are the earlier pairs


class PdoRecorder:
    """Assigns to each SYNC the first of each part of a sample received before the next SYNC.

    Called in the receiving thread; read by another one.
    """

    def __init__(self, layout: PdoLayout) -> None:
        self.layout = layout
        self._times_s: list[float] = []  # receive times of the SYNCs
        self._intervals: list[dict[int, Any]] = []  # the parts received after each SYNC
        self._parts: defaultdict[int, list[tuple[int, Callable[[bytes], Any]]]] = defaultdict(list)
        for part, place in [*enumerate((layout, *layout.earlier)), (COARSE, layout.coarse)]:
            if place is not None:
                self._parts[place.can_id].append((part, place.unpack))
        timed = layout.timed_by or layout
        self._parts[timed.can_id].append((TIME, timed.sample_time))
        self.samples = 0

    @property
    def syncs(self) -> int:
        return len(self._times_s)

    def callbacks(self) -> list[tuple[int, OnFrame]]:
        """A callback for each CAN-ID; that of the SYNC is the last."""
        return [*((can_id, self.on_pdo) for can_id in self._parts), (self.layout.sync_id, self.on_sync)]

    def on_sync(self, can_id: int, data: bytes, time_s: float) -> None:
        self._times_s.append(time_s)
        self._intervals.append({})

    def on_pdo(self, can_id: int, data: bytes, time_s: float) -> None:
        if not self._intervals:
            return
        now = self._intervals[-1]
        came = {part: read(data) for part, read in self._parts[can_id] if now.get(part) is None}
        self.samples += came.get(NEWEST) is not None
        now |= came

    def result(self, origin: str) -> TrackSamples:
        """The samples in order, without those of the last interval, which is incomplete."""
        intervals, per_sync = self._intervals[:-1], 1 + len(self.layout.earlier)
        rate_hz = self._rate_hz()
        in_order = [one.get(part) or MISSED for one in intervals for part in reversed(range(per_sync))]
        pairs = np.array(in_order, np.float64).reshape(-1, 2)
        samples = TrackSamples.of(pairs[:, 0], pairs[:, 1], rate_hz and rate_hz * per_sync, origin)
        if rate_hz or per_sync == 1:
            before_s = np.arange(per_sync - 1, -1, -1) / per_sync / (rate_hz or 1.0)
            at_s = np.array(self._times_s[:-1])
            samples = replace(samples, received_s=(at_s[:, None] - before_s).reshape(-1))
        if self.layout.coarse is not None:
            tracks = np.full((len(pairs), 2), np.nan)
            tracks[per_sync - 1 :: per_sync] = [one.get(COARSE) or (np.nan, np.nan) for one in intervals]
            samples = replace(samples, coarse=(tracks[:, 0], tracks[:, 1]))
        stamps: list[int | None] = [None] * len(pairs)
        stamps[per_sync - 1 :: per_sync] = [one.get(TIME) for one in intervals]
        return samples.timed(stamps)

    def _rate_hz(self) -> float | None:
        steps = np.diff(self._times_s)
        # The median ignores pauses; the mean of the steps near it averages late time stamps.
        if not len(steps) or (middle := float(np.median(steps))) <= 0.0:
            return None
        near = steps[np.abs(steps - middle) < 0.5 * middle]
        return 1.0 / float(near.mean()) if len(near) else None


class Listener:
    """Listens to SYNCs and samples. Call :meth:`look` regularly; it detects when they are missing."""

    def __init__(self, master: Master, layout: PdoLayout) -> None:
        self._master = master
        self.recorder = PdoRecorder(layout)
        self._syncs = Unchanged(master, 0)
        self._began_s: float | None = None
        self._samples: Unchanged | None = None  # None before the first SYNC

    @property
    def intervals(self) -> int:
        """Number of complete intervals, as in :meth:`result`."""
        return max(self.recorder.syncs - 1, 0)

    @property
    def elapsed_s(self) -> float:
        return 0.0 if self._began_s is None else self._master.now() - self._began_s

    def look(self) -> None:
        recorder, sync_id = self.recorder, self.recorder.layout.sync_id
        if recorder.syncs and self._began_s is None:
            self._began_s, self._samples = self._master.now(), Unchanged(self._master, 0)
        if self._syncs.seconds(recorder.syncs) > PATIENCE_S:
            raise CommissioningError(
                f"no SYNC ({sync_id:03X}h) for {PATIENCE_S:g} s: start the node that produces it, the "
                "drive or the controller, or let canfb produce it (--rate HZ)"
            )
        if self._samples is not None and self._samples.seconds(recorder.samples) > PATIENCE_S:
            raise self._no_samples()

    def result(self) -> TrackSamples:
        can_id = self.recorder.layout.can_id
        if not self.recorder.samples:
            raise self._no_samples()
        samples = self.recorder.result(f"PDO {can_id:03X}h at each SYNC")
        if samples.missed > PART_MISSED * len(samples):
            raise CommissioningError(
                f"{samples.missed} of {len(samples)} SYNCs were not followed by PDO {can_id:03X}h: "
                "samples are lost, or the PDO is not sent at each SYNC (transmission type 1 is needed)"
            )
        return samples

    def _no_samples(self) -> CommissioningError:
        return CommissioningError(
            f"SYNC is received, but not PDO {self.recorder.layout.can_id:03X}h with the samples: is the "
            "encoder interface OPERATIONAL (NMT start), and is its node-ID right?"
        )


@contextlib.contextmanager
def listening(master: Master, layout: PdoLayout) -> Iterator[Listener]:
    listener = Listener(master, layout)
    with subscribed(master, listener.recorder.callbacks()):
        yield listener


def listen(
    master: Master,
    layout: PdoLayout,
    duration_s: float,
    least_samples: int = 0,
    progress: Progress = lambda part: None,
    enough: Callable[[Listener], bool] = lambda listener: False,
) -> TrackSamples:
    """Samples of ``duration_s`` from the first SYNC on, and of at least ``least_samples`` intervals.

    ``progress`` gets 0..1. Ends at LONGEST x ``duration_s`` at the latest, or when ``enough`` is true.
    CommissioningError without SYNC or samples.
    """
    with listening(master, layout) as listener:
        while True:
            master.wait(LOOK_S)
            listener.look()
            passed = listener.elapsed_s / duration_s
            part = min(passed, listener.intervals / least_samples if least_samples else passed)
            progress(min(1.0, max(part, passed / LONGEST)))
            if part >= 1.0 or passed >= LONGEST or enough(listener):
                break
    return listener.result()


RECORDING_LOOK_S = 0.2
STANDING_S = 1.0  # no further samples for this long: the memory of the node is full
EMPTY_S = 2.0  # no sample at all for this long: the node does not sample
UPLOAD_PART = 0.5  # part of the upload in the reported progress


def record(
    node: NodeAccess, duration_s: float, rate_hz: float | None, progress: Progress, least_samples: int = 0
) -> TrackSamples:
    """Let ``node`` record as :func:`listen` does, and upload it; ``progress`` gets 0..1.

    ``rate_hz`` is used if 2050:04 is 0. CommissioningError if it cannot record, or recorded nothing.
    """
    try:
        node.write(*od.RECORDING_COMMAND, "B", od.RecordingCommand.START)
    except ObjectAbsentError:
        raise CommissioningError(f"{node.name} cannot record: it has no object 2050h") from None
    try:
        _wait(node, duration_s, least_samples, progress)
    finally:
        put_back(
            node, "2050:01 = 0", lambda: node.write(*od.RECORDING_COMMAND, "B", od.RecordingCommand.STOP)
        )
    count = node.integer(*od.RECORDING_RECORDED, "I")
    if not count:
        raise CommissioningError(f"{node.name} has recorded nothing (2050:02): is it OPERATIONAL?")
    data = node.upload_domain(
        *od.RECORDING_SAMPLES, lambda part: progress(UPLOAD_PART + (1.0 - UPLOAD_PART) * part)
    )
    known_hz = float(node.integer_if_there(od.RECORDING_RATE, "I") or 0.0)
    tracks = recorded_tracks(data[: len(data) // 4 * 4])
    return TrackSamples(*tracks, known_hz or rate_hz, f"recording 2050h of {node.name}")


def _wait(node: NodeAccess, duration_s: float, least_samples: int, progress: Progress) -> None:
    master, end_s = node.master, duration_s
    began, recorded = master.now(), Unchanged(master, 0)
    while (passed := master.now() - began) < end_s:
        progress(UPLOAD_PART * passed / end_s)
        master.wait(min(RECORDING_LOOK_S, end_s - passed))
        count = node.integer(*od.RECORDING_RECORDED, "I")
        if recorded.seconds(count) > (STANDING_S if count else EMPTY_S):
            return  # the memory is full, or the node does not sample
        end_s = duration_s * (1.0 if count >= least_samples else LONGEST)
