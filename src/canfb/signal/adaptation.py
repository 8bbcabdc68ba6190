"""Follows offset, gain and phase of the tracks slowly in operation (``adapt``, 2002:08).

Half of the change since the reference measurement goes into the conditioning, bounded in rate and range:
no fault hides behind it by more than :attr:`AdaptConfig.hidden_cycles`. Only valid samples in a row are used.

Samples over the whole cycle determine the change. After conditioning the tracks are z(x) = c + i s
= sum z_k e^ikx. Offsets are z_0, gain and phase error z_-1 = (-gain / 2 + i phase / 2) z_1. In the frame
that turns with the phase, w = z e^-ix,

    z_0 = mean of (w - z_1) e^ix,      z_-1 = mean of (w - z_1) e^2ix

over phases that are evenly distributed: the mean of 16 sectors. Only half of a change is seen, since the
phase follows the tracks: it shows in their radius alone.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from canfb.checks import within
from canfb.signal.conditioning import HARMONIC_ORDERS, Conditioning
from canfb.signal.correction import NO_CORRECTION, Correction
from canfb.signal.phase import FloatArray
from canfb.signal.sample import FLAGGED_BITS, Feedback
from canfb.signal.supervision import VALID

SECTORS = 16
FEWEST = 4  # samples in each sector
ROUNDS = 8  # iterations beyond the first order; each leaves a small part of the error
TURN = 2.0 * math.pi
# The mean of e^ix and of e^2ix over a sector, relative to the value at its middle.
LEFT_OF_FIRST, LEFT_OF_SECOND = (math.sin(m * math.pi / SECTORS) * SECTORS / (m * math.pi) for m in (1, 2))


class CircleDeviation(NamedTuple):
    """Deviation of conditioned tracks from a circle about the origin, relative to the fundamental.

    ``offset`` is z_0, cosine + i sine, ``backward`` is z_-1.
    """

    offset: complex
    backward: complex


NO_DEVIATION = CircleDeviation(0j, 0j)


class TrackSectors:
    """Takes samples until there are :data:`FEWEST` of them in each sector of the cycle."""

    __slots__ = ("_counts", "_places", "_turned", "taken")

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        self.taken = 0
        self._counts = [0] * SECTORS
        self._places, self._turned = [0.0] * SECTORS, [0j] * SECTORS

    def take(self, sine: float, cosine: float, phase: float) -> bool:
        """Take conditioned tracks, counts, and corrected phase, cycles; True if no sector needs more."""
        sector = int(phase * SECTORS)
        self._places[sector] += phase
        self._turned[sector] += complex(cosine, sine) * cmath.exp(-1j * TURN * phase)
        self._counts[sector] += 1
        self.taken += 1
        return min(self._counts) >= FEWEST

    def found(self) -> tuple[CircleDeviation, float]:
        """The deviation, and the mean amplitude in counts."""
        counts = self._counts
        turning = [one / n for one, n in zip(self._turned, counts, strict=True)]
        turns = [cmath.exp(1j * TURN * place / n) for place, n in zip(self._places, counts, strict=True)]
        fundamental = sum(turning) / SECTORS
        rest = [one - fundamental for one in turning]
        offset = sum(one * turn for one, turn in zip(rest, turns, strict=True)) / SECTORS
        backward = sum(one * turn * turn for one, turn in zip(rest, turns, strict=True)) / SECTORS
        size = abs(fundamental)
        if not size:
            return NO_DEVIATION, 0.0
        backward = backward * fundamental / (LEFT_OF_SECOND * size * size)
        return CircleDeviation(offset / (LEFT_OF_FIRST * size), backward), size


def deviation_of(correction: Correction) -> CircleDeviation | None:
    """Deviation of the tracks at the reference measurement with this correction; None: not known.

    Without a table it is none. With a table, the harmonics (2005h) give z_-1, and the rest of what the table
    corrects is z_0.
    """
    table, conditioning = correction.table, correction.conditioning
    if table is None:
        return NO_DEVIATION
    if not any(conditioning.harmonics):
        return None
    places = (np.arange(8 * SECTORS) + 0.5) / (8 * SECTORS)
    raw = np.arange(len(table)) / len(table)
    phases = table.entries
    phase = np.concatenate((phases - 1.0, phases, phases + 1.0))
    angle = _angle(raw)
    removed = np.interp(places, phase, np.concatenate((angle - 1.0, angle, angle + 1.0))) - places
    turns = np.exp(1j * TURN * places)
    known = 1.0 + sum(
        one * turns ** (order - 1) for order, one in zip(HARMONIC_ORDERS, conditioning.harmonics, strict=True)
    )
    offset = 0j
    for _ in range(ROUNDS):
        left = TURN * removed - np.angle(known + offset / turns)
        offset += complex(np.mean(left / turns) * -2j).conjugate()
    return CircleDeviation(offset, conditioning.harmonics[0])


def _angle(raw: FloatArray) -> FloatArray:
    """Arc tangent of the tracks, cycles, at a raw phase: the inverse of Table 1."""
    octant = np.floor(4.0 * raw + 0.5)
    return np.asarray(octant / 4.0 + np.arctan(8.0 * (raw - octant / 4.0)) / TURN, np.float64)


NEVER: Final = 1 << 62  # no sample has this number
EVERY_S = 0.02  # time between two samples that are used
PAUSE_S = 1.0  # time after a fault in which none is used
RECENT_S = 10.0  # a result is recent for this time, or for that of four blocks
MOST_TAKEN = 4096  # samples within which all sectors must be full
REFERENCE_BLOCKS = 4
GAIN = 0.5  # part of the remaining change that is corrected by each block
MOST_STEP = 0.004  # largest correction by a block, of the amplitude or in rad: 0.0006 cycle
PER_HOUR = 1.0 / 3600.0
HYSTERESIS = 31.0 / 32.0


@dataclass(frozen=True, kw_only=True)
class AdaptConfig:
    """Bounds of range and rate within which offset, gain and phase of the tracks are followed.

    offset         largest change of an offset, 0..0.25 of the amplitude (2002:09); 0: not followed
    gain           largest change of the ratio of the gains, 0..0.5 (2002:0A); 0: not followed
    phase_rad      largest change of the phase error, 0..0.25 rad (2002:0B); 0: not followed
    rate_per_hour  largest change of each per hour, 0..10 (2002:0C); 0: only measured
    """

    offset: float = 0.15
    gain: float = 0.25
    phase_rad: float = 0.05
    rate_per_hour: float = 0.5

    def __post_init__(self) -> None:
        within(self, offset=(0.0, 0.25), gain=(0.0, 0.5), phase_rad=(0.0, 0.25), rate_per_hour=(0.0, 10.0))

    @property
    def hidden_cycles(self) -> float:
        """Largest change that it makes to a position, cycles; docs/analog-front-end.md has the proof."""
        most, half = 1.0 + 0.5 * self.gain, 0.5 * self.phase_rad
        turned = math.atan2(most * math.sin(self.phase_rad), 2.0 - most + most * math.cos(self.phase_rad))
        rest = self.hidden_amplitude - (1.0 - math.cos(half))
        angle = turned + math.asin(rest / math.cos(half))
        return (1.0 - math.tan(math.pi / 4.0 - angle / 2.0)) / 4.0  # where Table 1 is steepest

    @property
    def hidden_amplitude(self) -> float:
        """Largest relative change that it makes to an amplitude."""
        half = 0.5 * self.phase_rad
        return (
            math.sqrt(2.0) * self.offset + math.hypot(0.5 * self.gain, math.sin(half)) + 1.0 - math.cos(half)
        )


class FollowedDrift(NamedTuple):
    """The change of the conditioned tracks since the reference measurement, as far as it is followed.

    sine_offset_counts, cosine_offset_counts  after conditioning (2002:0F, 2002:10)
    gain                                      of the sine over that of the cosine, minus 1 (2002:11)
    phase_rad                                 of the phase error (2002:12)
    """

    sine_offset_counts: float = 0.0
    cosine_offset_counts: float = 0.0
    gain: float = 0.0
    phase_rad: float = 0.0

    def removed_by(self, used: Conditioning) -> Conditioning:
        offset_s, gain_s, offset_c, factor_c, skew = used.coefficients()
        sine, cosine = 1.0 / (1.0 + 0.5 * self.gain), 1.0 / (1.0 - 0.5 * self.gain)
        factor = factor_c * cosine / math.cos(self.phase_rad)
        turned = math.atan(skew * cosine / (sine * math.cos(self.phase_rad)) + math.tan(self.phase_rad))
        return replace(
            used,
            sine_offset_counts=offset_s + self.sine_offset_counts / gain_s,
            cosine_offset_counts=offset_c
            + (self.cosine_offset_counts + skew * self.sine_offset_counts) / factor_c,
            sine_gain=gain_s * sine,
            cosine_gain=factor * math.cos(turned),
            phase_error_rad=turned,
        )


NO_DRIFT = FollowedDrift()


class Adaptation:
    """Follows the drift of one encoder; off until :meth:`use_limits`.

    drift   the change that is followed
    due     number of the next valid sample that :meth:`take` needs
    used    drift of the last block relative to its limit, the largest of all; 1 and more: at its limit
    """

    __slots__ = (
        "_blocks",
        "_known",
        "_limits",
        "_recent_until",
        "_sectors",
        "_stride",
        "at_limit",
        "drift",
        "due",
        "on_limit",
        "used",
    )
    due: int

    def __init__(self) -> None:
        self._limits: AdaptConfig | None = None
        self._sectors = TrackSectors()
        self.on_limit: Callable[[], None] | None = None
        """Called when :attr:`at_limit` has changed."""
        self.at_limit = False
        self.use(NO_CORRECTION)

    @property
    def is_on(self) -> bool:
        return self._limits is not None

    def use_limits(self, limits: AdaptConfig | None, start_from: FollowedDrift | None) -> None:
        was_on, self._limits = self.is_on, limits
        if not (was_on and self.is_on):
            self._forget()
        if self.is_on and start_from is not None and all(map(math.isfinite, start_from)):
            self.drift = start_from

    def use(self, correction: Correction) -> None:
        self._known = deviation_of(correction)
        self._blocks: list[CircleDeviation] = []  # those that will be the reference, while it is not known
        self._forget()

    def is_recent(self, samples: int) -> bool:
        return samples <= self._recent_until

    def take(self, feedback: Feedback, interval_s: float) -> bool:
        """Take a sample; True if :attr:`drift` changed. ``interval_s``: sampling interval, 0.0: not known."""
        samples = feedback.samples
        if feedback.status & (FLAGGED_BITS | VALID) != VALID:
            self._begin(samples + int(PAUSE_S / interval_s) if interval_s > 0.0 else samples)
            return False
        if samples < self.due:
            return False
        if not interval_s > 0.0:
            self._begin(samples)
            return False
        sectors = self._sectors
        if not sectors.taken:
            # Odd, so that at a constant fraction of a cycle per sample all its phases are seen.
            self._stride = max(1, round(EVERY_S / interval_s)) | 1
        self.due = samples + self._stride
        if not sectors.take(feedback.sine, feedback.cosine, feedback.phase):
            if sectors.taken >= MOST_TAKEN:
                sectors.begin()
            return False
        (found, amplitude), seconds = sectors.found(), sectors.taken * self._stride * interval_s
        sectors.begin()
        self._recent_until = samples + int(max(RECENT_S, 4.0 * seconds) / interval_s)
        if self._known is None:
            self._learn_reference(found)
            return False
        return self._follow(found, amplitude, seconds)

    def drop(self) -> None:
        self._sectors.begin()

    def _begin(self, samples: int) -> None:
        self._sectors.begin()
        self.due = samples

    def _forget(self) -> None:
        self.drift = NO_DRIFT
        self._recent_until = -1
        self._begin(0 if self.is_on else NEVER)
        self._judge(0.0)

    def _judge(self, used: float) -> None:
        before, self.used = self.at_limit, used
        self.at_limit = used >= (HYSTERESIS if before else 1.0)
        if self.at_limit is not before and self.on_limit is not None:
            self.on_limit()

    def _learn_reference(self, found: CircleDeviation) -> None:
        self._blocks.append(found)
        if len(self._blocks) == REFERENCE_BLOCKS:
            sums = map(sum, zip(*self._blocks, strict=True))
            self._known = CircleDeviation(*(one / REFERENCE_BLOCKS for one in sums))

    def _follow(self, found: CircleDeviation, amplitude: float, seconds: float) -> bool:
        limits, known = self._limits, self._known
        assert limits is not None
        assert known is not None
        offset, backward = found.offset - known.offset, found.backward - known.backward
        left = (2.0 * offset.imag, 2.0 * offset.real, -4.0 * backward.real, 4.0 * backward.imag)
        most = min(limits.rate_per_hour * PER_HOUR * seconds, MOST_STEP)
        ranges = (limits.offset, limits.offset, limits.gain, limits.phase_rad)
        units = (amplitude, amplitude, 1.0, 1.0)
        used, moved = 0.0, []
        for present, error, largest, unit in zip(self.drift, left, ranges, units, strict=True):
            now = present / unit
            if largest:
                used = max(used, abs(now + error) / largest)
            step = max(-most, min(GAIN * error, most))
            moved.append(unit * max(-largest, min(now + step, largest)))
        self._judge(used)
        before, self.drift = self.drift, FollowedDrift(*moved)
        return self.drift != before
