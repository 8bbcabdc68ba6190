"""The usual sample from the dictionary to its PDO in one piece (in the chain: `canfb.signal.usual_step`).

Nearly each sample is one: two counts in time, nothing wrong, nothing to be told but a new position. For any
other one the parts are called one by one; tests/module/test_usual_sample.py compares both, frame by frame.
"""

from __future__ import annotations

from collections.abc import Callable
from math import floor

from canfb import objects as od
from canfb.device.od.dictionary import Dictionary
from canfb.module.cia406.profile import EncoderProfile
from canfb.module.latest import Latest
from canfb.module.objects.publication import FAULTS, SIXTEEN_BITS, U32, Publication
from canfb.module.parameters import Limits
from canfb.module.publishing import Publishing
from canfb.module.tap import Taps
from canfb.signal.chain import SignalChain
from canfb.signal.feedback import Feedback
from canfb.signal.supervision import VALID

NO_FAULT = FAULTS | VALID


class UsualSample:
    """Takes the counts that stand in the dictionary, by the shortest way.

    ``unusual(now)`` takes all that are not usual.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        chain: SignalChain,
        limits: Limits,
        taps: Taps,
        publishing: Publishing,
        unusual: Callable[[float], None],
    ) -> None:
        entry = dictionary.entry
        self._sine, self._cosine, self._flags = (
            entry(*one) for one in (od.SAMPLE_SINE, od.SAMPLE_COSINE, od.SAMPLE_FLAGS)
        )
        self._status, self._residual, self._samples = (
            entry(*one) for one in (od.FEEDBACK_STATUS, od.FEEDBACK_RESIDUAL, od.FEEDBACK_SAMPLES)
        )
        self._position, self._fine = entry(*od.POSITION_VALUE), entry(*od.HIGH_PRECISION_POSITION)
        self._chain, self._limits, self._taps = chain, limits, taps
        self._publishing = publishing
        self._latest: Latest = publishing.latest
        self._objects: Publication = publishing.objects
        self._profile: EncoderProfile = publishing.profile
        self._cams = self._profile.cams
        self._warnings, self._alarm = publishing.warnings, publishing.alarm
        self._prediction = publishing.prediction
        self._interval = limits.interval
        self._unusual = unusual
        self.unconfirmed = 0
        """Samples after a pause that are not called valid yet."""

    def take(self, now: float) -> None:
        """The sample that has come, ``now`` in seconds."""
        limits = self._limits
        if self.unconfirmed or self._taps.open or self._flags.value:
            self._unusual(now)
            return
        if limits.narrowed and not limits.shortest_s < self._interval.measured_s < limits.longest_s:
            limits.follow()
        feedback = self._chain.usual(self._sine.value, self._cosine.value)
        if feedback is None:
            self._unusual(now)
            return
        noise = limits.noise
        if feedback[-1] >= noise.due and noise.take(feedback):
            limits.measured()
        self.publish(feedback, now)

    def publish(self, feedback: Feedback, now: float) -> None:
        """:meth:`Publishing.publish`, which takes all but a valid one without a fault, after another."""
        publishing = self._publishing
        _, _, amplitude, _, cycles, phase, residual, status, speed, acceleration, _, samples = feedback
        scale, warnings = self._profile.scale, self._warnings
        binary = scale.binary
        if (
            status != warnings.status  # another one than before
            or status & NO_FAULT != VALID
            or self._alarm.active
            or self._prediction.follows
            or self._cams.follows
            or not binary
        ):
            publishing.publish(feedback, now)
            return
        latest = self._latest
        latest.feedback = latest.valid = feedback
        self._status.value = status | self._objects.work
        self._residual.value = int(residual * SIXTEEN_BITS)
        self._samples.value = samples & U32
        lag = self._chain.lag_intervals
        if lag:  # as Latest.place
            position = phase + (speed + acceleration * (1.0 + lag) * 0.5) * lag
            turns = floor(position)
            cycles, phase = cycles + turns, position - turns
        units = cycles * binary + int(phase * scale.binary_factor) + scale.offset
        self._position.value = self._fine.value = units % scale.total_range
        for trigger in publishing.event_tpdos:
            trigger(now)
        if residual > warnings.near_cycles or amplitude < warnings.reserve_counts:
            warnings.follow(feedback, now)
        if publishing.on_feedback is not None:
            publishing.on_feedback(feedback, now)
