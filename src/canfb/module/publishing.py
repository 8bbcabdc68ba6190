"""What becomes of a feedback: objects, alarm, warnings, and the PDOs that go out with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from canfb import objects as od
from canfb.cia301.cob import is_valid
from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary
from canfb.device.pdo.pdo import EVENT_DRIVEN
from canfb.module.cia406.position_alarm import PositionAlarm
from canfb.module.cia406.profile import EncoderProfile
from canfb.module.cia406.profile_warnings import Warnings
from canfb.module.event_watch import EventWatch
from canfb.module.interval import SamplingInterval
from canfb.module.latest import Latest
from canfb.module.objects.last_loss import LastLoss
from canfb.module.objects.prediction import Prediction
from canfb.module.objects.publication import Publication
from canfb.module.objects.sample_input import SampleInput
from canfb.module.parameters import Limits
from canfb.signal.chain import SignalChain
from canfb.signal.feedback import Feedback
from canfb.signal.supervision import VALID

TPDOS = (1, 2, 3, 4)
ON_EVENT = EVENT_DRIVEN | {0}  # transmission types; 0 goes out at the SYNC after the event


class Publishing:
    """Takes each :class:`Feedback` of the chain to all who want to know of it, in this order.

    2011h and 2012h (Publication), the encoder profile, the shift to the nominal SYNC (Prediction), EMCY
    7300h (PositionAlarm), event-driven TPDOs, events and warnings.
    """

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
        self._dictionary, self._node = dictionary, node
        self.profile = EncoderProfile(dictionary, interval, self.latest)
        self.warnings = Warnings(
            dictionary,
            node,
            lambda: self.last,
            lambda: parts.expects_pulse,
            lambda: limits.in_force.residual_limit,
        )
        limits.on_applied = self.warnings.limits_changed
        self.prediction = Prediction(dictionary, self.profile, chain, interval)
        self.loss = LastLoss(dictionary, limits, chain, lambda: node.now)
        self.objects = Publication(dictionary, interval, chain, parts, limits, self.latest, self.loss)
        self.alarm = PositionAlarm(node)
        self._chain = chain
        self.events = EventWatch(dictionary, limits, self.loss)
        self.event_tpdos: list[Callable[[float], None]] = []

    @property
    def last(self) -> Feedback | None:
        """The last feedback, None before the first one."""
        return self.latest.feedback

    def publish(self, feedback: Feedback, now: float, send: bool = True) -> None:
        """Into the dictionary, and out if there is something new to say."""
        self.objects.publish(feedback)
        self.latest.feedback = feedback
        if feedback.status & VALID:
            self.latest.valid = feedback
        self.profile.publish(feedback)
        if self.prediction.follows:
            self.prediction.shift(feedback)
        status, warnings = feedback.status, self.warnings
        if self.alarm.active or not status & VALID:
            self._alarm(status, now)
            if self.events.detailed:
                self.events.fault(feedback, now)
        if send:
            for trigger in self.event_tpdos:
                trigger(now)
        if (
            status != warnings.status
            or feedback.residual > warnings.near_cycles
            or feedback.amplitude < warnings.reserve_counts
        ):
            if status != self.events.status:
                self.events.follow(feedback, now)
            warnings.follow(feedback, now)
        if self.on_feedback is not None:
            self.on_feedback(feedback, now)

    def _alarm(self, status: int, now: float) -> None:
        second = self._chain.second
        if self.alarm.active or second is None or not second.is_waiting:
            self.alarm.report(bool(status & VALID), status, now, self.loss)

    def count(self, between: Sequence[Feedback], now: float) -> None:
        """Samples that were taken before the one to publish, in the same interval of SYNC."""
        for feedback in between:
            self.objects.count(feedback)
            if self.events.detailed and not feedback.status & VALID:
                self.events.fault(feedback, now)

    def withhold(self) -> None:
        """What the dictionary holds is not valid any more, until the next sample."""
        self.objects.withhold()

    def outdated(self, now: float) -> None:
        """What the dictionary holds is not the position any more: not valid, with its alarm."""
        self.objects.withhold()
        self.events.outdated(now)
        if self.last is not None and not self.alarm.active:
            self.alarm.report(False, self.last.status & ~VALID, now, self.loss)

    def extrapolate(self) -> None:
        """A SYNC, before its TPDOs are sampled."""
        if self.last is not None:
            self.prediction.extrapolate(self.last)

    def configured(self) -> None:
        """PDO parameters or the NMT state have changed: which TPDOs go out with a sample."""
        self.warnings.look_again()
        self.event_tpdos = [
            self._node.tpdo_trigger(number) for number in TPDOS if self._is_event_tpdo(number)
        ]

    def _is_event_tpdo(self, number: int) -> bool:
        cob_id, kind = (self._dictionary.entry(od.TPDO + number - 1, subindex).value for subindex in (1, 2))
        return is_valid(cob_id) and kind in ON_EVENT

    def reset_alarms(self) -> None:
        """After a reset, also of the communication only, no error is active."""
        self.alarm.reset()
        self.warnings.reset()

    def reset(self) -> None:
        """After a reset of the node: no feedback."""
        self.latest.forget()
        self.events.reset()
        self.prediction.forget()
        self.profile.reset()
        self.objects.reset()
