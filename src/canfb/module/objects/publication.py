"""The manufacturer objects 2011h and 2012h: every stage of the last sample, and what was counted.

:class:`Latest` is the last feedback and where its position is. :class:`Publication` gives it to 2011h,
computed when it is read, and counts faults in 2012h. :class:`LastLoss` keeps why the position was lost the
last time (2012:10..16): a module that says no more than "lost" leaves its user to guess between a bus that
stalled, a limit that is too narrow and a dirty encoder. So it keeps what it knew in the sample of the loss,
until a reset.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from canfb import objects as od
from canfb.device.od.dictionary import Dictionary
from canfb.module.cia406.position import PHASE_UNITS
from canfb.module.interval import SamplingInterval
from canfb.module.objects.sample_input import SampleInput
from canfb.module.parameters import Limits
from canfb.objects import LossCause
from canfb.signal.chain import SignalChain
from canfb.signal.feedback import FAULT_BITS, FLAGGED_BITS, Feedback
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
LARGEST_INTEGER32 = 0x7FFFFFFF
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
BAD = MISSED | AMPLITUDE | CLIPPED | FROZEN | RESIDUAL
NO_SAMPLE = -1
NOTHING = Feedback(0.0, 0.0, 0.0, math.nan, 0, 0.0, 0.0, 0, 0.0, 0.0, 0, 0)


class Latest:
    """``feedback`` is the last one, ``valid`` the last one with a valid position; None before the first.

    The tracks come late by 2002:07. With v and a of :meth:`Prediction.extrapolate`, cycles and intervals, the
    position at the instant of the sample is x + v l + a l (l + 1)/2, l that delay in sampling intervals.
    """

    __slots__ = ("_chain", "feedback", "valid")

    def __init__(self, chain: SignalChain) -> None:
        self._chain = chain
        self.forget()

    def forget(self) -> None:
        """After a reset of the node: no sample."""
        self.feedback: Feedback | None = None
        self.valid: Feedback | None = None

    def place(self, feedback: Feedback) -> tuple[int, float]:
        """Cycle count and phase, 0 <= phase < 1, at the instant of the sample."""
        lag = self._chain.tracks.lag_intervals
        if not lag:
            return feedback.cycles, feedback.phase
        way = (feedback.speed_cycles + feedback.acceleration_cycles * (1.0 + lag) * 0.5) * lag
        position = feedback.phase + way
        turns = math.floor(position)
        phase = position - turns
        return (feedback.cycles + turns, phase) if phase < 1.0 else (feedback.cycles + turns + 1, 0.0)


class LastLoss:
    """Keeps the last loss, and gives it to 2012:10..16. All are 0 before there is one.

    :meth:`follow` must see each sample that has a fault or whose position is lost, in order.
    ``now()`` is in seconds.
    """

    def __init__(
        self, dictionary: Dictionary, limits: Limits, chain: SignalChain, now: Callable[[], float]
    ) -> None:
        self._limits, self._chain, self._now = limits, chain, now
        for place, read in (
            (od.COUNTER_LOSS_CAUSE, lambda: int(self.cause)),
            (od.COUNTER_LOSS_AGE, self._since_ms),
            (od.COUNTER_LOSS_BAD, lambda: self.bad_samples),
            (od.COUNTER_LOSS_RESIDUAL, lambda: self._residual),
            (od.COUNTER_LOSS_LIMIT, lambda: self._limit),
            (od.COUNTER_LOSS_SPEED, lambda: self._speed),
            (od.COUNTER_LOSS_FAULTS, lambda: self.faults),
        ):
            dictionary.entry(*place).on_read = read
        self.reset()

    def reset(self) -> None:
        """After a reset: not lost since."""
        self.cause = LossCause.NONE
        self.bad_samples = 0
        """Samples in a row that were missed or bad, the one of the loss among them."""
        self.faults = 0
        """Bits of the status word of all samples since the last valid one."""
        self._lost_s = 0.0
        self._residual = self._limit = self._speed = 0
        self._before = NO_SAMPLE  # number of the last sample with a fault
        self._begin_row()
        self._is_lost = False

    def _begin_row(self) -> None:
        self._bad = self._row_faults = 0

    def follow(self, feedback: Feedback) -> None:
        """A sample with a fault, or without a valid position."""
        status, number = feedback.status, feedback.samples
        if number != self._before + 1:
            self._begin_row()
        self._before = number
        if status & VALID:
            self._begin_row()
            self._is_lost = False
            return
        self._bad = self._bad + 1 if status & BAD else 0
        self._row_faults |= status & FAULT_BITS
        if status & LOST and not self._is_lost:
            self._keep(feedback)
        self._is_lost = bool(status & LOST)

    def _keep(self, feedback: Feedback) -> None:
        limits = self._limits.in_force
        self.cause = self._chain.loss_cause
        self.bad_samples, self.faults = self._bad, self._row_faults
        self._lost_s = self._now()
        self._residual = min(round(feedback.residual * SIXTEEN_BITS), U32)
        self._limit = min(round(limits.residual_limit * SIXTEEN_BITS), U32)
        self._speed = min(round(abs(feedback.speed_cycles) * SIXTEEN_BITS), U32)

    def _since_ms(self) -> int:
        if not self.cause:
            return 0
        return max(0, min(round((self._now() - self._lost_s) * 1e3), U32))


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
        if feedback.status & FLAGGED_BITS or self._lost:
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
