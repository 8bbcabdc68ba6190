"""What happens in a node and in a module, as events: changes of state, never a look at each sample.

An :class:`Event` is a line of a log and the same for programs. :class:`NodeEvents` makes those that any
node has: its NMT state, its errors, what it saves. :class:`EventWatch` adds those of a module: SYNC, first
sample, the state of the position with all faults since it was valid, the table. It is called where a state
changes; what it costs when nobody has set ``on_event`` is one comparison a change.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from canfb import objects as od
from canfb.cia301.codes import emergency_text
from canfb.cia301.nmt import NmtState
from canfb.device.application import Application, Groups
from canfb.device.od.dictionary import Dictionary
from canfb.device.storage.image import ParameterGroup
from canfb.module.objects.publication import LastLoss
from canfb.module.parameters import Limits
from canfb.signal.correction import Correction
from canfb.signal.feedback import FAULT_BITS, Feedback
from canfb.signal.supervision import AMPLITUDE, MISSED, REFERENCED, RESIDUAL, SECOND_POSITION


class EventKind(StrEnum):
    """What has happened; the value is the name that programs read."""

    NMT = "nmt"
    SYNC_FOUND = "sync_found"
    SYNC_LOST = "sync_lost"
    FIRST_SAMPLE = "first_sample"
    POSITION = "position"
    SECOND_POSITION = "second_position"
    TABLE = "table"
    SAVED = "saved"
    SAVE_FAILED = "save_failed"
    FAULT = "fault"
    EMCY = "emcy"


DETAILS = frozenset({EventKind.FAULT, EventKind.EMCY})
"""What comes with single samples, or repeats what another event says."""


@dataclass(frozen=True, slots=True)
class Event:
    """Something that has happened in a node.

    kind    what it was
    time_s  when, seconds on the clock of `now`
    text    in words, without the node
    values  the same for programs: names and plain values
    """

    kind: EventKind
    time_s: float
    text: str
    values: Mapping[str, bool | float | int | str | list[str] | None] = field(default_factory=dict)


class NodeEvents(Application):
    """Calls ``on_event`` with each :class:`.Event`; without it nothing is made.

    ``detailed``: each EMCY, too.
    """

    def __init__(self) -> None:
        self.on_event: Callable[[Event], None] | None = None
        self.detailed = False

    def state_changed(self, old: NmtState, new: NmtState, now: float, why: str) -> None:
        """A change of the NMT state, and ``why`` if it was not commanded."""
        boot_up = "boot-up, " if old is NmtState.INITIALISING else ""
        name = new.name.replace("_", "-")
        text = f"{boot_up}{name}{': ' if why else ''}{why}"
        self._report(EventKind.NMT, now, text, state=name, boot_up=bool(boot_up), reason=why or None)

    def emergency_sent(self, code: int, register: int, detail: bytes, now: float) -> None:
        """An EMCY goes out."""
        if self.detailed:
            words = emergency_text(code, od.EMERGENCY_TEXTS)
            text = f"EMCY {code:04X}h sent ({words}), 1001h {register:02X}h, detail {detail.hex(' ')}"
            self._report(EventKind.EMCY, now, text, code=code, register=register, detail=detail.hex())

    def parameters_saved(self, saved: Groups, forgotten: Groups, now: float) -> None:
        """Parameters were saved, or their defaults loaded."""
        for groups, what in ((saved, "saved"), (forgotten, "dropped, the defaults come with the next reset")):
            names = [group.name.lower() for group in groups if group is not ParameterGroup.OPERATING_TIME]
            if names:
                text = f"parameters {what}: {', '.join(names)}"
                self._report(EventKind.SAVED, now, text, groups=names, dropped=groups is forgotten)

    def saving_failed(self, groups: Groups, reason: str, now: float) -> None:
        """Parameters could not be saved, or their defaults not loaded: the store has what it had."""
        names = [group.name.lower() for group in groups if group is not ParameterGroup.OPERATING_TIME]
        if names:
            text = f"parameters not saved ({reason}): {', '.join(names)}"
            self._report(EventKind.SAVE_FAILED, now, text, groups=names, reason=reason)

    def _report(
        self, kind: EventKind, now: float, text: str, **values: bool | float | int | str | list[str] | None
    ) -> None:
        if self.on_event is not None:
            self.on_event(Event(kind, now, text, values))


NO_STATUS = -1  # no status word
ANOTHER_RATE = 0.05  # relative change of the SYNC rate that is an event


class EventWatch(NodeEvents):
    """Calls ``on_event`` with each :class:`.Event`; without it nothing is made.

    ``detailed``: single faults, too, and each EMCY. For the hot path: :meth:`follow` must see each sample
    whose status word is not :attr:`status`, and nothing else.
    """

    def __init__(self, dictionary: Dictionary, limits: Limits, loss: LastLoss) -> None:
        super().__init__()
        self.unconfirmed: Callable[[], str] = lambda: ""
        """Why a position without a fault is not valid yet, in words; "" if it is not known."""
        self.status = NO_STATUS
        self._limits, self._loss = limits, loss
        self._low, self._high = (
            dictionary.entry(*one) for one in (od.ENCODER_LOWEST_AMPLITUDE, od.ENCODER_HIGHEST_AMPLITUDE)
        )
        self._difference, self._tolerance = (
            dictionary.entry(*one) for one in (od.SECOND_DIFFERENCE, od.SECOND_TOLERANCE)
        )
        self._rate_hz = 0.0
        self._corrected = False
        self.reset()

    def reset(self) -> None:
        """After a reset of the node: no sample."""
        self.status = NO_STATUS
        self._sampled = self._disagrees = False
        self._state: od.PositionState | None = None
        self._causes = 0
        self._not_valid_s = 0.0
        self._was_valid = False  # the position, at any time

    def state_changed(self, old: NmtState, new: NmtState, now: float, why: str) -> None:
        """A change of the NMT state, and ``why`` if it was not commanded.

        The next SYNC and the next sample are the first.
        """
        self._rate_hz = 0.0
        self.reset()
        super().state_changed(old, new, now, why)

    def synced(self, interval_s: float, now: float) -> None:
        """SYNCs come as expected, at this interval; not called with each of them."""
        known = self._rate_hz
        if not interval_s or abs(known * interval_s - 1.0) <= ANOTHER_RATE:
            return
        self._rate_hz = 1.0 / interval_s
        text = f"SYNC now at {self._rate_hz:.6g} Hz" if known else f"SYNC found, {self._rate_hz:.6g} Hz"
        self._report(EventKind.SYNC_FOUND, now, text, rate_hz=self._rate_hz)

    def sync_lost(self, synced_s: float, now: float) -> None:
        """No SYNC and no sample for 2010:06 periods, since ``synced_s``."""
        if self._rate_hz:
            self._rate_hz = 0.0
            silent_s = now - synced_s
            self._report(
                EventKind.SYNC_LOST, now, f"SYNC lost, none for {_time(silent_s)}", silent_s=silent_s
            )

    def follow(self, feedback: Feedback, now: float) -> None:
        """The status word is another one now."""
        before, self.status = self.status, feedback.status
        if self.on_event is None:
            return
        if not (self._sampled or feedback.status & MISSED):
            self._sampled = True
            values = {"sine_counts": feedback.sine, "cosine_counts": feedback.cosine}
            self._report(EventKind.FIRST_SAMPLE, now, f"first sample, {self._amplitude(feedback)}", **values)
        self._causes |= feedback.status & FAULT_BITS
        state = od.position_state(feedback.status)
        if state is not self._state:
            self._changed(state, feedback, now)
        elif before != NO_STATUS and feedback.status & ~before & REFERENCED:
            self._report(
                EventKind.POSITION, now, "referenced to the zero pulse", state=state, referenced=True
            )
        if bool(feedback.status & SECOND_POSITION) is not self._disagrees:
            self._second(not self._disagrees, now)

    def _second(self, disagrees: bool, now: float) -> None:
        """The other sensor contradicts the position, or does so no longer."""
        self._disagrees = disagrees
        away, tolerance = self._difference.current(), self._tolerance.value
        if disagrees:
            text = f"second position disagrees: {away:+.4g} revolutions, tolerance {tolerance:.4g}"
        else:
            text = "second position disagrees no longer"
        known = None if math.isnan(away) else away
        self._report(EventKind.SECOND_POSITION, now, text, disagrees=disagrees, difference_revolutions=known)

    def outdated(self, now: float) -> None:
        """What was published is not the position any more, and nothing takes its place."""
        if self._state is od.PositionState.VALID:
            self._state, self.status, self._not_valid_s = od.PositionState.NOT_VALID, NO_STATUS, now
            self._report(
                EventKind.POSITION, now, "position not valid: no SYNC and no sample", state=self._state
            )

    def fault(self, feedback: Feedback, now: float) -> None:
        """A sample without a valid position, if `detailed`."""
        if (faults := od.fault_words(feedback.status)) and self.on_event is not None:
            text = f"sample {feedback.samples}: {', '.join(self._reasons(feedback, feedback.status))}"
            self._report(EventKind.FAULT, now, text, sample=feedback.samples, faults=faults)

    def table(self, correction: Correction, now: float) -> None:
        """A table, or none, has come into force."""
        table, before = correction.table, self._corrected
        self._corrected = table is not None
        if self.on_event is None:
            return
        if table is not None:
            text = f"table in force: {len(table)} entries, CRC {table.crc32:08X}h"
            self._report(EventKind.TABLE, now, text, entries=len(table), crc32=table.crc32)
        elif before:
            self._report(EventKind.TABLE, now, "table in force: none, the identity", entries=0, crc32=0)

    def _changed(self, state: od.PositionState, feedback: Feedback, now: float) -> None:
        """Another state of the position; a reason is all that went wrong since it was valid."""
        before, self._state = self._state, state
        if state is od.PositionState.VALID:
            self._causes = 0
            again = f" again, after {_time(now - self._not_valid_s)}" if self._was_valid else ""
            text, reasons, self._was_valid = f"position valid{again}", [], True
        else:
            if before in (None, od.PositionState.VALID):
                self._not_valid_s = now
            reasons = self._reasons(feedback, self._causes)
            if state is od.PositionState.LOST:
                text = f"position lost: {'; '.join(self._loss_words(reasons))}"
            else:
                text = f"position {state}: {', '.join(reasons) or self._without_fault(state)}"
        residual = feedback.residual if feedback.residual == feedback.residual else None
        self._report(
            EventKind.POSITION,
            now,
            text,
            state=str(state),
            faults=od.fault_words(feedback.status | self._causes),
            status=feedback.status,
            residual_cycles=residual,
            residual_limit_cycles=self._limits.in_force.residual_limit,
            sample=feedback.samples,
            cause=self._loss.cause.name.lower() if state is od.PositionState.LOST else None,
        )

    def _loss_words(self, reasons: list[str]) -> list[str]:
        """Faults, cause and advice of a loss."""
        cause = self._loss.cause
        return [*[", ".join(reasons)] * bool(reasons), cause.text, "see canfb why"]

    def _without_fault(self, state: od.PositionState) -> str:
        if state is od.PositionState.COASTING:
            return self.unconfirmed() or "not confirmed yet"
        return "no reference yet"

    def _reasons(self, feedback: Feedback, bits: int) -> list[str]:
        """In words; with figures where they are those of this sample."""
        limit, residual = self._limits.in_force.residual_limit, feedback.residual
        over = f"residual {residual:.3f} over {limit:.3f} cycle"
        # In doubt, a sample whose residual is small may still contradict those before it.
        fits_not = f"residual {residual:.3f} cycle, within {limit:.3f}: contradicts the samples before"
        figures = {
            RESIDUAL: over if residual >= limit else fits_not,
            AMPLITUDE: f"{self._amplitude(feedback)} outside of {self._low.value} to {self._high.value}",
        }
        now = feedback.status
        return [
            figures.get(bit, words) if now & bit else words
            for bit, words in od.FAULT_WORDS.items()
            if bits & bit
        ]

    def _amplitude(self, feedback: Feedback) -> str:
        amplitude = feedback.amplitude
        return f"amplitude {amplitude:.0f} counts" if math.isfinite(amplitude) else "no amplitude"


def _time(seconds: float) -> str:
    return f"{seconds:.3g} s" if seconds >= 1.0 else f"{seconds * 1e3:.3g} ms"
