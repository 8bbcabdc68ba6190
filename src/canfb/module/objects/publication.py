"""The manufacturer objects 2011h and 2012h: every stage of a sample, and the counters."""

from __future__ import annotations

import math

from canfb import objects as od
from canfb.device.od.dictionary import Dictionary
from canfb.module.cia406.position import PHASE_UNITS
from canfb.module.interval import SamplingInterval
from canfb.module.latest import Latest
from canfb.module.objects.last_loss import LastLoss
from canfb.module.objects.sample_input import SampleInput
from canfb.module.parameters import Limits
from canfb.signal.chain import SignalChain
from canfb.signal.feedback import Feedback
from canfb.signal.supervision import (
    AMPLITUDE,
    CALIBRATING,
    CLIPPED,
    COARSE,
    COASTING,
    FROZEN,
    LOST,
    MISSED,
    RESIDUAL,
    SECOND_POSITION,
    VALID,
)

U16, U32 = 0xFFFF, 0xFFFFFFFF
SIXTEEN_BITS = 65536.0
LARGEST_REAL32 = 3.4e38
# Counter and the status bit that it counts; clipping counts as an amplitude fault, too.
COUNTED = (
    (od.COUNTER_MISSED, MISSED),
    (od.COUNTER_RESIDUAL, RESIDUAL),
    (od.COUNTER_AMPLITUDE, AMPLITUDE | CLIPPED),
    (od.COUNTER_COASTED, COASTING),
    (od.COUNTER_CLIPPED, CLIPPED),
    (od.COUNTER_FROZEN, FROZEN),
    (od.COUNTER_COARSE_DISAGREEMENTS, COARSE),
    (od.COUNTER_SECOND_DISAGREEMENTS, SECOND_POSITION),
)
FAULTS = MISSED | RESIDUAL | AMPLITUDE | CLIPPED | COASTING | LOST | FROZEN | COARSE | SECOND_POSITION
LARGEST_INTEGER32 = 0x7FFFFFFF


NOTHING = Feedback(0.0, 0.0, 0.0, math.nan, 0, 0.0, 0.0, 0, 0.0, 0.0, 0, 0)


class Publication:
    """2011h but for what the default PDOs hold, which is computed when it is read; faults in 2012h."""

    def __init__(
        self,
        dictionary: Dictionary,
        interval: SamplingInterval,
        chain: SignalChain,
        source: SampleInput,
        limits: Limits,
        latest: Latest,
        loss: LastLoss,
    ) -> None:
        entry = dictionary.entry
        self._status = entry(*od.FEEDBACK_STATUS)
        entry(*od.FEEDBACK_PHASE).on_read = self._phase
        entry(*od.FEEDBACK_CYCLE_COUNT).on_read = self._cycle_count
        entry(*od.FEEDBACK_AMPLITUDE).on_read = self._amplitude
        entry(*od.FEEDBACK_RAW_PHASE).on_read = self._raw_phase
        entry(*od.FEEDBACK_VELOCITY).on_read = self._velocity
        entry(*od.FEEDBACK_ACCELERATION).on_read = self._acceleration
        entry(*od.FEEDBACK_JUMP).on_read = self._jump
        entry(*od.FEEDBACK_NOISE).on_read = lambda: _sixteen_bits(limits.noise.rms_cycles)
        entry(*od.COUNTER_RECOVERED).on_read = lambda: chain.reference.recovered & U32
        entry(*od.COUNTER_SET_RIGHT).on_read = lambda: chain.reference.set_right & U32
        entry(*od.COUNTER_ZERO_PULSES).on_read = lambda: source.pulses & U32
        self._counted = [(entry(*counter), bits) for counter, bits in COUNTED]
        self._losses = entry(*od.COUNTER_LOST)
        self._cycles_per_revolution = entry(*od.ENCODER_CYCLES_PER_REVOLUTION)
        self._interval = interval
        self._latest = latest
        self._loss = loss
        self.work = 0
        """Bit 10 of the status word."""
        self.reset()

    def reset(self) -> None:
        """After a reset: no feedback; counting of losses restarts."""
        self._last_raw = 0.0  # the last one before the present sample
        self._lost = False
        self._loss.reset()

    def withhold(self) -> None:
        """What stands there is not valid any more, until the next sample."""
        self._status.value &= ~VALID

    def count(self, feedback: Feedback) -> None:
        """Count its faults in 2012h, before it is the latest one."""
        self._last_raw = self._known_raw()
        self.count_between(feedback)

    def count_between(self, feedback: Feedback) -> None:
        """Count the faults of a sample that is not published: another one of its SYNC follows."""
        if feedback.status & FAULTS or self._lost:
            self._count(feedback)

    def calibrating(self, working: bool) -> None:
        """Bit 10 of the status word, at once: the module records or computes for 2030h."""
        self.work = CALIBRATING if working else 0
        self._status.value = self._status.value & ~CALIBRATING | self.work

    @property
    def _last(self) -> Feedback:
        return self._latest.feedback or NOTHING

    def _known_raw(self) -> float:
        """The last raw phase that there was, cycles."""
        raw = self._last.raw_phase
        return raw if raw == raw else self._last_raw

    def _phase(self) -> int:
        return int(self._latest.place(self._last)[1] * PHASE_UNITS)

    def _cycle_count(self) -> int:
        return self._latest.place(self._last)[0]

    def _amplitude(self) -> int:
        amplitude = self._last.amplitude
        return min(int(amplitude), U16) if amplitude == amplitude else 0

    def _raw_phase(self) -> int:
        return int(self._known_raw() * SIXTEEN_BITS)

    def _velocity(self) -> float:
        return self._rad_s(self._last.speed_cycles, 1)

    def _acceleration(self) -> float:
        return self._rad_s(self._last.acceleration_cycles, 2)

    def _rad_s(self, per_interval: float, power: int) -> float:
        """Cycles per interval, or per interval squared, in rad and s; what REAL32 cannot hold is cut off."""
        interval_s = self._interval.sample_s
        if interval_s <= 0.0:
            return 0.0
        rad_per_cycle = 2.0 * math.pi / float(self._cycles_per_revolution.value)
        value = per_interval * rad_per_cycle / interval_s**power
        return max(-LARGEST_REAL32, min(value, LARGEST_REAL32))

    def _jump(self) -> int:
        return max(-LARGEST_INTEGER32, min(self._last.jump_cycles, LARGEST_INTEGER32))

    def _count(self, feedback: Feedback) -> None:
        status = feedback.status
        self._loss.follow(feedback)
        for counter, bits in self._counted:
            if status & bits:
                counter.value = (counter.value + 1) & U32
        lost = bool(status & LOST)
        if lost and not self._lost:
            self._losses.value += 1
        self._lost = lost


def _sixteen_bits(cycles: float) -> int:
    """In 1/65536 cycle, FFFFh at most; 0 for what is not known."""
    return 0 if cycles != cycles else min(round(cycles * SIXTEEN_BITS), U16)
