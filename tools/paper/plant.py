"""Test objects of the claims: encoders, exact tables, and motions with exactly known positions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from canfb import CorrectionTable, TrackResult, phase_in_cycle, track
from canfb.simulation.encoder import Encoder, Harmonic, demo_encoder
from tools.faults.machine import exact_table

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

CYCLES_PER_REVOLUTION = 2500
UNIT = 1 << 28  # positions are integers of 1/2^28 cycle: rounding does not accumulate over a long run
BLOCK = 1 << 18
WRONG_CYCLES = 0.5  # error beyond which a position is in a wrong cycle

IDEAL = Encoder(amplitude_counts=1900.0)
# A mediocre encoder, with half a count of noise on either track.
USUAL = replace(demo_encoder(), harmonics=(Harmonic(3, 0.012, 0.010), Harmonic(5, 0.003, 0.004)))
# The paper's extreme case: 40 % offset and 20 % amplitude error.
EXTREME = Encoder(
    amplitude_counts=1200.0,
    sine_offset=0.4,
    cosine_offset=0.4,
    sine_amplitude=1.2,
    cosine_amplitude=0.8,
    noise_lsb=0.5,
)


def cycles_per_sample(rpm: float, rate_hz: float) -> float:
    """Speed in cycles per sampling interval."""
    return rpm / 60.0 * CYCLES_PER_REVOLUTION / rate_hz


def turning(speed: float, samples: int) -> FloatArray:
    """Positions from rest to this speed, cycles per sample, in 300 samples, then ``samples`` at it."""
    return np.concatenate([[0.0], np.full(300, speed / 300), np.zeros(samples)])


def bisected(low: float, high: float, within: float, good: Callable[[float], bool]) -> float:
    """The largest value that is ``good``, by bisection; ``low`` must be good."""
    while high - low > within:
        middle = (low + high) / 2.0
        low, high = (middle, high) if good(middle) else (low, middle)
    return low


@dataclass(frozen=True, eq=False)
class Way:
    """Exact positions at the samples: integers of 1/UNIT cycle."""

    units: IntArray

    @classmethod
    def from_steps(cls, changes: npt.ArrayLike, start_cycles: float = 0.3) -> Way:
        """From rest; `changes` are the changes of speed, cycles per sample, from sample to sample."""
        units = np.rint(np.asarray(changes) * UNIT).astype(np.int64)
        return cls._summed(units, start_cycles)

    @classmethod
    def _summed(cls, changes_units: IntArray, start_cycles: float) -> Way:
        np.cumsum(changes_units, out=changes_units)
        changes_units[0] += round(start_cycles * UNIT)
        np.cumsum(changes_units, out=changes_units)
        return cls(changes_units)

    @classmethod
    def random(cls, samples: int, top_speed: float, top_change: float, rng: np.random.Generator) -> Way:
        """Ramps between random speeds up to ±`top_speed`, half of them full reversals, and halts.

        `top_speed` in cycles per sample; `top_change` is the largest change of speed from
        sample to sample.
        """
        changes, counts = [0], [1]
        speed, top, total = 0, round(top_speed * UNIT), 1
        while total < samples:
            kind = rng.integers(4)
            target = (top, -top, 0, int(rng.integers(-top, top)))[kind]
            change = int(rng.uniform(0.3, 1.0) * top_change * UNIT) * (1 if target > speed else -1)
            ramp, rest = divmod(abs(target - speed), abs(change))
            hold = int(rng.integers(1, 1500))
            changes += [change, rest if change > 0 else -rest, 0]
            counts += [ramp, 1, hold]
            speed, total = target, total + ramp + 1 + hold
        return cls._summed(np.repeat(np.array(changes), counts)[:samples], float(rng.uniform()))

    def __len__(self) -> int:
        return len(self.units)

    @property
    def cycles(self) -> IntArray:
        return self.units // UNIT

    @property
    def phase(self) -> FloatArray:
        return (self.units % UNIT) / UNIT

    @property
    def reversals(self) -> int:
        sign = np.sign(np.diff(self.units)).astype(np.int8)
        sign = sign[sign != 0]
        return int(np.count_nonzero(sign[1:] != sign[:-1]))

    @property
    def top_speed(self) -> float:
        return float(np.abs(np.diff(self.units)).max()) / UNIT

    def error(self, cycles: IntArray, phase: FloatArray) -> FloatArray:
        """Error of a position in cycles."""
        return (cycles - self.cycles) + (phase - self.phase)


def sampled(
    encoder: Encoder, way: Way, rng: np.random.Generator | None
) -> tuple[npt.NDArray[np.int16], npt.NDArray[np.int16]]:
    """ADC counts of a motion, block by block, which limits the memory for ten million samples."""
    sine, cosine = np.empty(len(way), np.int16), np.empty(len(way), np.int16)
    for start in range(0, len(way), BLOCK):
        part = slice(start, start + BLOCK)
        sine[part], cosine[part] = encoder.sample(Way(way.units[part]).phase, rng)
    return sine, cosine


class Score(NamedTuple):
    """Result of a motion: samples in a wrong cycle, flagged samples, errors of the others."""

    wrong: int
    flagged: int
    peak_error: float


def score(way: Way, result: TrackResult) -> Score:
    error = np.abs(way.error(result.cycles, result.phase))
    off = error > WRONG_CYCLES
    return Score(int(off.sum()), int((~result.ok).sum()), float(error[~off].max(initial=0.0)))


def followed(encoder: Encoder, way: Way, rng: np.random.Generator | None) -> TrackResult:
    """The motion processed by encoder, converter, individual table and tracker."""
    return bare(*sampled(encoder, way, rng), exact_table(encoder.tracks))


def bare(sine: npt.ArrayLike, cosine: npt.ArrayLike, table: CorrectionTable) -> TrackResult:
    """Only the method of the paper: Table 1, table, eq. 9 and eq. 12, without recovery."""
    return track(table(phase_in_cycle(sine, cosine)), 1 / 3)
