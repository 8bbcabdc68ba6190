"""The manufacturer objects 2011h and 2012h: every stage of the last sample, and the counters.

:class:`LastLoss` keeps the circumstances of the last loss (2012:10..16): they distinguish a bus that stalled,
a limit that is too narrow and a dirty encoder.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from canfb import objects as od
from canfb.device.od.dictionary import Dictionary
from canfb.module.cia406.position import PHASE_UNITS, STILL
from canfb.module.interval import SamplingInterval
from canfb.module.objects.sample_input import SampleInput
from canfb.module.parameters import Limits
from canfb.signal.chain import SignalChain
from canfb.signal.sample import FAULT_BITS, FLAGGED_BITS, Feedback
from canfb.signal.supervision import AMPLITUDE, CALIBRATING, CLIPPED, FROZEN, LOST, MISSED, RESIDUAL, VALID

U16, U32 = 0xFFFF, 0xFFFFFFFF
SIXTEEN_BITS = 65536.0  # units of 1/65536 cycle
LARGEST_REAL32 = 3.4e38
LARGEST_INTEGER32 = 0x7FFFFFFF
BAD = MISSED | AMPLITUDE | CLIPPED | FROZEN | RESIDUAL
NO_SAMPLE = -1


class Latest:
    """``feedback``, and the last one with a ``valid`` position; None: none yet."""

    __slots__ = ("_chain", "feedback", "valid")

    def __init__(self, chain: SignalChain) -> None:
        self._chain = chain
        self.forget()

    def forget(self) -> None:
        self.feedback: Feedback | None = None
        self.valid: Feedback | None = None

    def place(self, feedback: Feedback) -> tuple[int, float]:
        """Cycle count and phase, 0 <= phase < 1, at the instant of the sample.

        The tracks are late by 2002:07, l sampling intervals: x + v l + a l (l + 1)/2, as in Prediction.
        """
        lag = self._chain.tracks.lag_intervals
        if not lag:
            return feedback.cycles, feedback.phase
        displacement = (feedback.speed_cycles + feedback.acceleration_cycles * (1.0 + lag) * 0.5) * lag
        position = feedback.phase + displacement
        turns = math.floor(position)
        phase = position - turns
        return (feedback.cycles + turns, phase) if phase < 1.0 else (feedback.cycles + turns + 1, 0.0)


class LastLoss:
    """Counts losses (2012:05), and shows the last one in 2012:10..16, 0 before. ``now()`` is in seconds.

    :meth:`follow` must get each sample that has a fault or a lost position, in order. ``bad_samples``: missed
    or bad ones in a row up to the loss; ``faults``: all bits since the last valid sample.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        limits: Limits,
        chain: SignalChain,
        latest: Latest,
        now: Callable[[], float],
    ) -> None:
        self._limits, self._chain, self._latest, self._now = limits, chain, latest, now
        self._losses = dictionary.entry(*od.COUNTER_LOST)
        dictionary.read_live(
            {
                od.COUNTER_LOSS_CAUSE: lambda: int(self.cause),
                od.COUNTER_LOSS_AGE: self._since_ms,
                od.COUNTER_LOSS_BAD: lambda: self.bad_samples,
                od.COUNTER_LOSS_RESIDUAL: lambda: self._residual,
                od.COUNTER_LOSS_LIMIT: lambda: self._limit,
                od.COUNTER_LOSS_SPEED: lambda: self._speed,
                od.COUNTER_LOSS_FAULTS: lambda: self.faults,
            }
        )
        self.reset()

    def reset(self) -> None:
        self.cause = od.LossCause.NONE
        self.bad_samples = self.faults = 0
        self._lost_s = 0.0
        self._residual = self._limit = self._speed = 0
        self._before = NO_SAMPLE  # number of the last sample with a fault
        self._bad = self._row_faults = 0
        self.is_lost = False

    def follow(self, feedback: Feedback) -> None:
        status, number = feedback.status, feedback.samples
        if status & VALID or number != self._before + 1:
            self._bad = self._row_faults = 0
        self._before = number
        lost = bool(status & LOST)
        if not status & VALID:
            # A SYNC without a sample misses all of its samples.
            samples = self._limits.in_force.samples_per_sync if math.isnan(feedback.sine) else 1
            self._bad = self._bad + samples if status & BAD else 0
            self._row_faults |= status & FAULT_BITS
            if lost and not self.is_lost:
                self._keep(feedback)
        self.is_lost = lost

    def _keep(self, feedback: Feedback) -> None:
        self._losses.value += 1
        self.cause = self._chain.loss_cause
        self.bad_samples, self.faults = self._bad, self._row_faults
        self._lost_s = self._now()
        self._residual = _sixteen_bits(feedback.residual, U32)
        self._limit = _sixteen_bits(self._limits.in_force.residual_limit, U32)
        # Not that of the sample of the loss: its error is contained in its speed.
        self._speed = _sixteen_bits(abs((self._latest.valid or feedback).speed_cycles), U32)

    def _since_ms(self) -> int:
        age_s = self._now() - self._lost_s if self.cause else 0.0
        return max(0, min(round(age_s * 1e3), U32))


class Publication:
    """Faults in 2012h, and 2011h except for the objects in the default PDOs. ``work``: bit 10 of 2011:01."""

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
        dictionary.read_live(
            {
                od.FEEDBACK_PHASE: lambda: int(latest.place(self._last)[1] * PHASE_UNITS),
                od.FEEDBACK_CYCLE_COUNT: lambda: latest.place(self._last)[0],
                od.FEEDBACK_AMPLITUDE: self._amplitude,
                od.FEEDBACK_RAW_PHASE: lambda: int(self._known_raw() * SIXTEEN_BITS),
                od.FEEDBACK_VELOCITY: lambda: self._rad_s(self._last.speed_cycles, 1),
                od.FEEDBACK_ACCELERATION: lambda: self._rad_s(self._last.acceleration_cycles, 2),
                od.FEEDBACK_JUMP: lambda: max(
                    -LARGEST_INTEGER32, min(self._last.jump_cycles, LARGEST_INTEGER32)
                ),
                od.FEEDBACK_SAMPLES: lambda: self._last.samples & U32,
                od.FEEDBACK_NOISE: lambda: _sixteen_bits(limits.noise.rms_cycles, U16),
                od.COUNTER_RECOVERED: lambda: chain.reference.recovered & U32,
                od.COUNTER_SET_RIGHT: lambda: chain.reference.set_right & U32,
                od.COUNTER_ZERO_PULSES: lambda: source.pulses & U32,
            }
        )
        self._status = entry(*od.FEEDBACK_STATUS)
        self._counted = [(entry(*counter), bits) for counter, bits in od.COUNTED.items()]
        self._cycles_per_revolution = entry(*od.ENCODER_CYCLES_PER_REVOLUTION)
        self._interval, self._latest, self._loss = interval, latest, loss
        self.work = 0
        self.reset()

    def reset(self) -> None:
        self._last_raw = 0.0  # the last raw phase before the present sample
        self._loss.reset()

    def count(self, feedback: Feedback) -> None:
        self._last_raw = self._known_raw()
        self.count_between(feedback)

    def count_between(self, feedback: Feedback) -> None:
        """Count the faults of a sample that is not published: another one of its SYNC follows."""
        status = feedback.status
        if not (status & FLAGGED_BITS or self._loss.is_lost):
            return
        self._loss.follow(feedback)
        for counter, bits in self._counted:
            if status & bits:
                counter.value = (counter.value + 1) & U32

    def calibrating(self, working: bool) -> None:
        self.work = CALIBRATING if working else 0
        self._status.value = self._status.value & ~CALIBRATING | self.work

    @property
    def _last(self) -> Feedback:
        return self._latest.feedback or STILL

    def _known_raw(self) -> float:
        raw = self._last.raw_phase
        return raw if raw == raw else self._last_raw

    def _amplitude(self) -> int:
        amplitude = self._last.amplitude
        return min(int(amplitude), U16) if amplitude == amplitude else 0

    def _rad_s(self, per_interval: float, power: int) -> float:
        interval_s = self._interval.sample_s
        if interval_s <= 0.0:
            return 0.0
        rad_per_cycle = 2.0 * math.pi / float(self._cycles_per_revolution.value)
        value = per_interval * rad_per_cycle / interval_s**power
        return max(-LARGEST_REAL32, min(value, LARGEST_REAL32))


def _sixteen_bits(cycles: float, most: int) -> int:
    """``cycles`` in 1/65536 cycle, at most ``most``; 0 for NaN."""
    return 0 if cycles != cycles else min(round(cycles * SIXTEEN_BITS), most)
