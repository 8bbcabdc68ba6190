"""From a feedback to objects, alarm, warnings, events and the PDOs that are sent with it.

A usual sample is valid, without a fault, and has the status word of the one before. Then only the objects in
the default PDOs are written; all others are computed when they are read.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from canfb import objects as od
from canfb.cia301.codes import NmtState
from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary
from canfb.module.cia406.alarms import PositionAlarm, Warnings
from canfb.module.cia406.profile import ALARM_POSITION, EncoderProfile
from canfb.module.events import EventWatch
from canfb.module.interval import SamplingInterval
from canfb.module.objects.prediction import Prediction
from canfb.module.objects.publication import SIXTEEN_BITS, LastLoss, Latest, Publication
from canfb.module.objects.sample_input import SampleInput
from canfb.module.parameters import Limits
from canfb.signal.chain import SignalChain
from canfb.signal.sample import FLAGGED_BITS, Feedback
from canfb.signal.supervision import COASTING, VALID

FLAGGED_AND_VALID = FLAGGED_BITS | VALID


class Publishing:
    """Passes each :class:`Feedback` to all of these."""

    def __init__(
        self,
        dictionary: Dictionary,
        node: Node,
        interval: SamplingInterval,
        limits: Limits,
        chain: SignalChain,
        parts: SampleInput,
    ) -> None:
        self.latest = Latest(chain)
        self.on_feedback: Callable[[Feedback, float], None] | None = None
        self._node = node
        entry = dictionary.entry
        self._status, self._residual = entry(*od.FEEDBACK_STATUS), entry(*od.FEEDBACK_RESIDUAL)
        self._position, self._fine = entry(*od.POSITION_VALUE), entry(*od.HIGH_PRECISION_POSITION)
        self.profile = EncoderProfile(
            dictionary,
            interval,
            self.latest,
            lambda: node.state is NmtState.OPERATIONAL and not self._status.value & VALID,
        )
        self.warnings = Warnings(
            dictionary,
            node,
            self.latest,
            lambda: parts.expects_pulse,
            lambda: limits.in_force.residual_limit,
            lambda: chain.adaptation.at_limit,
        )
        chain.adaptation.on_limit = self.warnings.look_again
        limits.on_applied = self.warnings.limits_changed
        self.prediction = Prediction(dictionary, self.profile, chain, interval)
        self.loss = LastLoss(dictionary, limits, chain, self.latest, lambda: node.now)
        self.objects = Publication(dictionary, interval, chain, parts, limits, self.latest, self.loss)
        self.alarm = PositionAlarm(node)
        self._chain, self._tracks = chain, chain.tracks
        self.events = EventWatch(dictionary, limits, self.loss)
        self.event_tpdos: list[Callable[[float], None]] = []

    @property
    def last(self) -> Feedback | None:
        return self.latest.feedback

    def publish(self, feedback: Feedback, now: float, send: bool = True) -> None:
        """Write ``feedback`` to the dictionary; ``send`` event-driven TPDOs, alarm and warnings if needed."""
        _, _, amplitude, _, cycles, phase, residual, status, _, _, _, _ = feedback
        latest, warnings, profile = self.latest, self.warnings, self.profile
        usual = status == warnings.usual_status
        if not usual:
            self.objects.count(feedback)
        latest.feedback = feedback
        if usual or status & VALID:
            latest.valid = feedback
        self._status.value = status | self.objects.work
        self._residual.value = int(residual * SIXTEEN_BITS)
        if self._tracks.lag_intervals:
            cycles, phase = latest.place(feedback)
        scale = profile.scale
        binary = scale.binary
        units = cycles * binary + int(phase * scale.binary_factor) if binary else scale.units(cycles, phase)
        self._position.value = self._fine.value = position = (units + scale.offset) % scale.total_range
        if profile.cams.follows and status & VALID:
            profile.cams.follow(position)
        if self.prediction.follows:
            self.prediction.shift(feedback, cycles, phase)
        if not usual:
            self._alarm(feedback, now)
        if send:
            for trigger in self.event_tpdos:
                trigger(now)
        if not usual or residual > warnings.near_cycles or amplitude < warnings.reserve_counts:
            if status != self.events.status:
                self.events.follow(feedback, now)
            warnings.follow(feedback, now)
            if status & FLAGGED_AND_VALID != VALID or self.alarm.active:
                warnings.look_again()
        if self.on_feedback is not None:
            self.on_feedback(feedback, now)

    def _alarm(self, feedback: Feedback, now: float) -> None:
        """6503h and EMCY 7300h; no EMCY while a start is being confirmed."""
        valid = bool(feedback.status & VALID)
        self.profile.alarm(ALARM_POSITION, not valid)
        if valid and not self.alarm.active:
            return
        if self.alarm.active or not self._is_starting(feedback):
            self.alarm.report(valid, feedback.status, now, self.loss)
        if self.events.detailed:
            self.events.fault(feedback, now)

    def _is_starting(self, feedback: Feedback) -> bool:
        """True while sample times or the other sensor have to confirm a start: that is no fault."""
        second = self._chain.second
        waits = second is not None and second.is_waiting
        return waits or (self._chain.searches and not feedback.status & FLAGGED_BITS & ~COASTING)

    def count(self, between: Sequence[Feedback], now: float) -> None:
        for feedback in between:
            self.objects.count_between(feedback)
            if self.events.detailed and not feedback.status & VALID:
                self.events.fault(feedback, now)

    def withhold(self) -> None:
        self._status.value &= ~VALID

    def outdated(self, now: float) -> None:
        self.withhold()
        self.events.outdated(now)
        if self.last is not None:
            self.profile.alarm(ALARM_POSITION, True)
            self.alarm.report(False, self.last.status & ~VALID, now, self.loss)
            self.warnings.look_again()

    def configured(self) -> None:
        self.warnings.look_again()
        self.event_tpdos = self._node.event_tpdos()

    def reset(self) -> None:
        self.latest.forget()
        self.events.reset()
        self.prediction.forget()
        self.profile.reset()
        self.objects.reset()
