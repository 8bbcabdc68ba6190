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
LARGEST_REAL32 = 3.4e38
# Sub-index of 2012h and the status bit that it counts; clipping counts as an amplitude fault.
COUNTED = ((1, MISSED), (2, RESIDUAL), (3, AMPLITUDE | CLIPPED), (4, COASTING))
LOST_COUNTER = 5
FAULTS = MISSED | RESIDUAL | AMPLITUDE | CLIPPED | COASTING | LOST


NOTHING = Feedback(0.0, 0.0, 0.0, math.nan, 0, 0.0, 0.0, 0, 0.0, 0.0, 0, 0)


class Publication:
    """Puts a :class:`canfb.signal.chain.Feedback` into 2011h and counts faults in 2012h.

    What the default PDOs do not hold is computed when it is read, because few samples are asked for it.
    """

    def __init__(self, dictionary: Dictionary, interval: IntervalEstimate) -> None:
        entry = dictionary.entry
        self._status, self._residual, self._samples = (entry(FEEDBACK, n) for n in (1, 2, 8))
        entry(FEEDBACK, 3).on_read = self._phase
        entry(FEEDBACK, 4).on_read = self._cycle_count
        entry(FEEDBACK, 5).on_read = self._amplitude
        entry(FEEDBACK, 6).on_read = self._raw_phase
        entry(FEEDBACK, 7).on_read = self._velocity
        self._counters = {n: entry(COUNTERS, n) for n in range(1, 9)}
        self._cycles_per_revolution = entry(0x2001, 1)
        self._interval = interval
        self.reset()

    def reset(self) -> None:
        """After a reset: no feedback; counting of losses starts anew."""
        self._last = NOTHING
        self._last_raw = 0.0
        self._lost = False

    def publish(self, feedback: Feedback) -> None:
        """Put it into 2011h, count in 2012h."""
        self._last = feedback
        status, raw = feedback.status, feedback.raw_phase
        self._status.value = status
        self._residual.value = int(feedback.residual * SIXTEEN_BITS)
        self._samples.value = feedback.samples & U32
        if raw == raw:
            self._last_raw = raw
        if status & FAULTS or self._lost:
            self._count(status)

    def _phase(self) -> int:
        return int(self._last.phase * PHASE_UNITS)

    def _cycle_count(self) -> int:
        return self._last.cycles

    def _amplitude(self) -> int:
        amplitude = self._last.amplitude
        return min(int(amplitude), U16) if amplitude == amplitude else 0

    def _raw_phase(self) -> int:
        return int(self._last_raw * SIXTEEN_BITS)

    def _velocity(self) -> float:
        interval_s = self._interval.seconds
        if interval_s <= 0.0:
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
