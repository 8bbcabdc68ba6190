"""The manufacturer objects 2011h and 2012h: every stage of a sample, and the counters."""

from __future__ import annotations

import math

from canfb.device.dictionary import Dictionary
from canfb.module.interval import IntervalEstimate
from canfb.module.position import PHASE_UNITS
from canfb.signal.chain import Feedback
from canfb.signal.supervision import AMPLITUDE, CLIPPED, COASTING, LOST, MISSED, RESIDUAL

FEEDBACK, COUNTERS = 0x2011, 0x2012
U16, U32 = 0xFFFF, 0xFFFFFFFF
SIXTEEN_BITS = 65536.0
PHASE_SCALE = float(PHASE_UNITS)
LARGEST_REAL32 = 3.4e38
# Sub-index of 2012h and the status bit that it counts; clipping counts as an amplitude fault.
COUNTED = ((1, MISSED), (2, RESIDUAL), (3, AMPLITUDE | CLIPPED), (4, COASTING))
LOST_COUNTER = 5
FAULTS = MISSED | RESIDUAL | AMPLITUDE | CLIPPED | COASTING | LOST


class Publication:
    """Writes a :class:`canfb.signal.chain.Feedback` into 2011h and counts faults in 2012h.

    Amplitude and velocity are computed when they are read, because few samples are asked for them.
    """

    def __init__(self, dictionary: Dictionary, interval: IntervalEstimate) -> None:
        entry = dictionary.entry
        (self._status, self._residual, self._phase, self._cycles) = (entry(FEEDBACK, n) for n in range(1, 5))
        self._raw, self._samples = entry(FEEDBACK, 6), entry(FEEDBACK, 8)
        entry(FEEDBACK, 5).on_read = self._amplitude_counts
        entry(FEEDBACK, 7).on_read = self._velocity_rad_s
        self._last: Feedback | None = None
        self._interval = interval
        self._counters = {n: entry(COUNTERS, n) for n in range(1, 9)}
        self._cycles_per_revolution = entry(0x2001, 1)
        self._lost = False

    def reset(self) -> None:
        """After a reset: no feedback; counting of losses starts anew."""
        self._last = None
        self._lost = False

    def publish(self, feedback: Feedback) -> int:
        """Write 2011h, count in 2012h; the phase in 1/2^32 cycle."""
        self._last = feedback
        phase_units = int(feedback.phase * PHASE_SCALE)
        status, raw = feedback.status, feedback.raw_phase
        self._status.value = status
        self._residual.value = int(feedback.residual * SIXTEEN_BITS)
        self._phase.value = phase_units
        self._cycles.value = feedback.cycles
        self._samples.value = feedback.samples & U32
        if raw == raw:
            self._raw.value = int(raw * SIXTEEN_BITS)
        if status & FAULTS or self._lost:
            self._count(status)
        return phase_units

    def _amplitude_counts(self) -> int:
        amplitude = 0.0 if self._last is None else self._last.amplitude
        return min(int(amplitude), U16) if amplitude == amplitude else 0

    def _velocity_rad_s(self) -> float:
        interval_s = self._interval.seconds
        if self._last is None or interval_s <= 0.0:
            return 0.0
        rad_per_cycle = 2.0 * math.pi / float(self._cycles_per_revolution.value)
        velocity = self._last.speed_cycles * rad_per_cycle / interval_s
        return max(-LARGEST_REAL32, min(velocity, LARGEST_REAL32))

    def _count(self, status: int) -> None:
        for subindex, bits in COUNTED:
            if status & bits:
                counter = self._counters[subindex]
                counter.value = (counter.value + 1) & U32
        lost = bool(status & LOST)
        if lost and not self._lost:
            self._counters[LOST_COUNTER].value += 1
        self._lost = lost
