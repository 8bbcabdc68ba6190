"""Samples of both tracks, in memory and in files."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from canfb.calibration.over_speeds import sampled_together, speeds
from canfb.calibration.recording import Recording, recording
from canfb.master.access import CommissioningError
from canfb.objects import MISSED_COUNTS
from canfb.signal.phase import FloatArray
from canfb.signal.sample import TICK_S, TICKS
from canfb.sources.tracks_file import read_tracks, with_gaps

# The rate between pauses is known to about half a percent where receive times jitter.
LEAST_SKIPPED, SURE_PART = 2, 0.005


@dataclass(frozen=True, eq=False)
class TrackSamples:
    """Both tracks in ADC counts, one sample an interval, NaN where one was missed.

    rate_hz      without pauses; None: not known
    time_s       sample times, rising; None: equidistant
    received_s   of the SYNC of each sample; None: not known
    coarse       sine and cosine, ADC counts, NaN where they did not come
    at_speed     the analog path counts
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
    def of(
        cls, sine: npt.ArrayLike, cosine: npt.ArrayLike, rate_hz: float | None, origin: str
    ) -> TrackSamples:
        """Pairs of -32768 are missed. ValueError for different lengths."""
        return cls(*with_gaps(sine, cosine), rate_hz, origin)

    @classmethod
    def from_bytes(cls, data: bytes, rate_hz: float | None, origin: str) -> TrackSamples:
        """From 2050:03: pairs of INTEGER16, little-endian."""
        pairs = np.frombuffer(data[: len(data) // 4 * 4], "<i2").reshape(-1, 2)
        return cls.of(pairs[:, 0], pairs[:, 1], rate_hz, origin)

    def timed(self, stamps: Sequence[int | None]) -> TrackSamples:
        """Sample times in 100 ns, modulo 2^32, or None."""
        known = [n for n, stamp in enumerate(stamps) if stamp is not None]
        if len(known) < 2:
            return self
        ticks = np.array([stamps[n] for n in known], np.int64)
        passed = np.concatenate([[0], np.cumsum(np.diff(ticks) % TICKS)])
        step = float(np.median(np.diff(passed) / np.diff(known)))
        # Beyond the first and the last one that came, and between two, at a steady pace.
        ends = [-1, *known, len(stamps)]
        times = [-step * (known[0] + 1), *passed, passed[-1] + step * (len(stamps) - known[-1])]
        return replace(self, time_s=np.interp(np.arange(len(stamps)), ends, times) * TICK_S)

    def recording(self, adc_bits: int | None) -> Recording:
        return recording(self.sine, self.cosine, self.time_s, None, adc_bits)

    def together(self, cosine_delay_s: float, cycles_per_s: float) -> TrackSamples:
        """As if the cosine had not been sampled ``cosine_delay_s`` later (2002:06), at this mean speed.

        CommissioningError without a rate, CalibrationError where the samples are on no ellipse.
        """
        if not cosine_delay_s:
            return self
        if not self.rate_hz:
            raise CommissioningError("2002:06 is set, and the rate of the samples is not known: --rate")
        record = recording(self.sine, self.cosine, self.time_s, None, None, may_be_offset=True)
        speed = speeds(record, cycles_per_s / self.rate_hz)
        cosine = sampled_together(record, 2.0 * np.pi * self.rate_hz * cosine_delay_s * speed)
        cosine[np.isnan(self.cosine)] = np.nan
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
    """INTEGER16 tracks, -32768 for a missed sample, rate_hz (0: not known), time_s, cycles_per_s
    (``hertz``).
    """
    sine, cosine = (
        np.nan_to_num(track, nan=MISSED_COUNTS).astype(np.int16) for track in (samples.sine, samples.cosine)
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
    """Columns t_s (if the rate is known), sine, cosine; a missed sample has no row."""
    names = ["t_s", "sine", "cosine"] if samples.rate_hz else ["sine", "cosine"]
    with path.open("w", newline="", encoding="ascii") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(names)
        for number, pair in enumerate(zip(samples.sine.tolist(), samples.cosine.tolist(), strict=True)):
            if not math.isnan(pair[0]):
                time = [f"{number / samples.rate_hz:.9g}"] if samples.rate_hz else []
                rows.writerow([*time, *map(int, pair)])


def read_speed(path: Path) -> float | None:
    """cycles_per_s of an NPZ file, or None."""
    return read_tracks(path).cycles_per_s


def read_npz(path: Path) -> TrackSamples:
    tracks = read_tracks(path)
    return TrackSamples(tracks.sine, tracks.cosine, tracks.rate_hz, f"file {path.name}", tracks.time_s)
