"""The manufacturer objects 2011h and 2012h: every stage of a sample, and the counters."""

from __future__ import annotations

import math

from canfb.device.dictionary import Dictionary
from canfb.module.position import PHASE_UNITS
from canfb.signal.chain import Feedback
from canfb.signal.supervision import AMPLITUDE, CLIPPED, COASTING, LOST, MISSED, RESIDUAL

FEEDBACK, COUNTERS = 0x2011, 0x2012
U16, U32 = 0xFFFF, 0xFFFFFFFF
SIXTEEN_BITS = 65536.0
TWO_PI = 2.0 * math.pi
# Sub-index of 2012h and the status bit that it counts; clipping counts as an amplitude fault.
COUNTED = ((1, MISSED), (2, RESIDUAL), (3, AMPLITUDE | CLIPPED), (4, COASTING))
LOST_COUNTER = 5
FAULTS = MISSED | RESIDUAL | AMPLITUDE | CLIPPED | COASTING | LOST


class Publication:
    """Writes a :class:`canfb.signal.chain.Feedback` into 2011h and counts faults in 2012h."""

    def __init__(self, dictionary: Dictionary) -> None:
        entry = dictionary.entry
        (self._status, self._residual, self._phase, self._cycles) = (entry(FEEDBACK, n) for n in range(1, 5))
        (self._amplitude, self._raw, self._velocity, self._samples) = (
            entry(FEEDBACK, n) for n in range(5, 9)
        )
        self._counters = {n: entry(COUNTERS, n) for n in range(1, 9)}
        self._cycles_per_revolution = entry(0x2001, 1)
        self._lost = False

    def reset(self) -> None:
        """After a reset: counting of losses starts anew."""
        self._lost = False

    def publish(self, feedback: Feedback, interval_s: float) -> int:
        """Write 2011h, count in 2012h; the phase in 1/2^32 cycle. ``interval_s`` 0 = not known."""
        phase_units = int(feedback.phase * PHASE_UNITS)
        status, amplitude, raw = feedback.status, feedback.amplitude, feedback.raw_phase
        self._status.value = status
        self._residual.value = int(feedback.residual * SIXTEEN_BITS)
        self._phase.value = phase_units
        self._cycles.value = feedback.cycles
        self._samples.value = feedback.samples & U32
        if amplitude < U16:
            self._amplitude.value = int(amplitude)
        else:
            self._amplitude.value = U16 if amplitude == amplitude else 0
        if raw == raw:
            self._raw.value = int(raw * SIXTEEN_BITS)
        if interval_s > 0.0:
            seconds_per_turn = self._cycles_per_revolution.value * interval_s
            self._velocity.value = feedback.speed_cycles * TWO_PI / seconds_per_turn
        if status & FAULTS or self._lost:
            self._count(status)
        return phase_units

    def _count(self, status: int) -> None:
        for subindex, bits in COUNTED:
            if status & bits:
                counter = self._counters[subindex]
                counter.value = (counter.value + 1) & U32
        lost = bool(status & LOST)
        if lost and not self._lost:
            self._counters[LOST_COUNTER].value += 1
        self._lost = lost
