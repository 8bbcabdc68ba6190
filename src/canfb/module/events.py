"""Changes of state of a node and of a module, as events: a line for a log, and values for programs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from canfb import objects as od
from canfb.cia301.codes import NmtState, emergency_text
from canfb.device.core import Application, Groups
from canfb.device.od.dictionary import Dictionary
from canfb.device.storage.kept import ParameterGroup
from canfb.module.objects.publication import LastLoss
from canfb.module.parameters import Limits
from canfb.objects import PositionState
from canfb.signal.correction import Correction
from canfb.signal.sample import FAULT_BITS, Feedback
from canfb.signal.supervision import AMPLITUDE, MISSED, REFERENCED, RESIDUAL, SECOND_POSITION

Value = bool | float | int | str | list[str] | None


class EventKind(StrEnum):
    """Kinds of events; the values are the names for programs."""

    NMT = "nmt"
    SYNC_FOUND = "sync_found"
    SYNC_LOST = "sync_lost"
    FIRST_SAMPLE = "first_sample"
    POSITION = "position"
    SECOND_POSITION = "second_position"
    TABLE = "table"
    SAVED = "saved"
    SAVE_FAILED = "save_failed"
    FAULT = "fault"  # of a single sample, if detailed
    EMCY = "emcy"  # repeats another event, if detailed


@dataclass(frozen=True, slots=True)
class Event:
    """``text``, and ``values`` for programs, at ``time_s`` on the clock of `now`."""

    kind: EventKind
    time_s: float
    text: str
    values: Mapping[str, Value] = field(default_factory=dict)


class NodeEvents(Application):
    """Calls ``on_event`` with the events of any node; ``detailed``: each EMCY, too."""

    def __init__(self) -> None:
        self.on_event: Callable[[Event], None] | None = None
        self.detailed = False

    def state_changed(self, old: NmtState, new: NmtState, now: float, why: str) -> None:
        boot_up = old is NmtState.INITIALISING
        name = new.name.replace("_", "-")
        text = f"{'boot-up, ' if boot_up else ''}{name}{': ' if why else ''}{why}"
        self._report(EventKind.NMT, now, text, state=name, boot_up=boot_up, reason=why or None)

    def emergency_sent(self, code: int, register: int, detail: bytes, now: float) -> None:
        if self.detailed:
            words = emergency_text(code, od.EMERGENCY_TEXTS)
            text = f"EMCY {code:04X}h sent ({words}), 1001h {register:02X}h, detail {detail.hex(' ')}"
            self._report(EventKind.EMCY, now, text, code=code, register=register, detail=detail.hex())

    def parameters_saved(self, saved: Groups, forgotten: Groups, now: float) -> None:
        self._parameters(EventKind.SAVED, saved, "saved", now, dropped=False)
        what = "dropped; the next reset loads the defaults"
        self._parameters(EventKind.SAVED, forgotten, what, now, dropped=True)

    def saving_failed(self, groups: Groups, reason: str, now: float) -> None:
        self._parameters(EventKind.SAVE_FAILED, groups, f"not saved ({reason})", now, reason=reason)

    def _parameters(self, kind: EventKind, groups: Groups, what: str, now: float, **values: Value) -> None:
        names = [group.name.lower() for group in groups if group is not ParameterGroup.OPERATING_TIME]
        if names:
            self._report(kind, now, f"parameters {what}: {', '.join(names)}", groups=names, **values)

    def _report(self, kind: EventKind, now: float, text: str, **values: Value) -> None:
        if self.on_event is not None:
            self.on_event(Event(kind, now, text, values))


NO_STATUS = -1  # no status word
ANOTHER_RATE = 0.05  # relative change of the SYNC rate that is an event


class EventWatch(NodeEvents):
    """Adds the events of a module: SYNC, first sample, position, table; ``detailed``: single faults.

    :meth:`follow` must get each sample whose status word is not ``status``, and no other.
    ``unconfirmed()`` returns why a position without a fault is not valid yet, "": not known.
    """

    def __init__(self, dictionary: Dictionary, limits: Limits, loss: LastLoss) -> None:
        super().__init__()
        self.unconfirmed: Callable[[], str] = lambda: ""
        self._limits, self._loss, entry = limits, loss, dictionary.entry
        self._low, self._high = entry(*od.ENCODER_LOWEST_AMPLITUDE), entry(*od.ENCODER_HIGHEST_AMPLITUDE)
        self._difference, self._tolerance = entry(*od.SECOND_DIFFERENCE), entry(*od.SECOND_TOLERANCE)
        self._rate_hz = 0.0
        self._corrected = False
        self.reset()

    def reset(self) -> None:
        self.status = NO_STATUS
        self._sampled = self._disagrees = False
        self._state: PositionState | None = None
        self._causes = 0
        self._not_valid_s = 0.0
        self._was_valid = False  # the position was valid at some time

    def state_changed(self, old: NmtState, new: NmtState, now: float, why: str) -> None:
        self._rate_hz = 0.0
        self.reset()
        super().state_changed(old, new, now, why)

    def synced(self, interval_s: float, now: float) -> None:
        """SYNC has the interval ``interval_s``; not called for each SYNC."""
        known = self._rate_hz
        if not interval_s or abs(known * interval_s - 1.0) <= ANOTHER_RATE:
            return
        self._rate_hz = 1.0 / interval_s
        text = f"SYNC now at {self._rate_hz:.6g} Hz" if known else f"SYNC found, {self._rate_hz:.6g} Hz"
        self._report(EventKind.SYNC_FOUND, now, text, rate_hz=self._rate_hz)

    def sync_lost(self, synced_s: float, now: float) -> None:
        """No SYNC and no sample for 2010:06 periods, since ``synced_s``."""
        if self._rate_hz:
            self._rate_hz, silent_s = 0.0, now - synced_s
            text = f"SYNC lost, none for {_time(silent_s)}"
            self._report(EventKind.SYNC_LOST, now, text, silent_s=silent_s)

    def follow(self, feedback: Feedback, now: float) -> None:
        before, self.status = self.status, feedback.status
        if self.on_event is None:
            return
        if not (self._sampled or feedback.status & MISSED):
            self._sampled = True
            values = {"sine_counts": feedback.sine, "cosine_counts": feedback.cosine}
            self._report(EventKind.FIRST_SAMPLE, now, f"first sample, {_amplitude(feedback)}", **values)
        self._causes |= feedback.status & FAULT_BITS
        state = od.position_state(feedback.status)
        if state is not self._state:
            self._changed(state, feedback, now)
        elif before != NO_STATUS and feedback.status & ~before & REFERENCED:
            text = "referenced to the zero pulse"
            self._report(EventKind.POSITION, now, text, state=state, referenced=True)
        disagrees = bool(feedback.status & SECOND_POSITION)
        if disagrees is not self._disagrees:
            self._disagrees = disagrees
            self._second(disagrees, now)

    def _second(self, disagrees: bool, now: float) -> None:
        away, text = self._difference.current(), "second position disagrees no longer"
        if disagrees:
            tolerance = self._tolerance.value
            text = f"second position disagrees: {away:+.4g} revolutions, tolerance {tolerance:.4g}"
        known = None if math.isnan(away) else away
        self._report(EventKind.SECOND_POSITION, now, text, disagrees=disagrees, difference_revolutions=known)

    def outdated(self, now: float) -> None:
        if self._state is PositionState.VALID:
            self._state, self.status, self._not_valid_s = PositionState.NOT_VALID, NO_STATUS, now
            text = "position not valid: no sample"
            self._report(EventKind.POSITION, now, text, state=self._state)

    def fault(self, feedback: Feedback, now: float) -> None:
        if (faults := od.fault_words(feedback.status)) and self.on_event is not None:
            text = f"sample {feedback.samples}: {', '.join(self._reasons(feedback, feedback.status))}"
            self._report(EventKind.FAULT, now, text, sample=feedback.samples, faults=faults)

    def table(self, correction: Correction, now: float) -> None:
        table, before = correction.table, self._corrected
        self._corrected = table is not None
        if table is not None:
            text = f"table in force: {len(table)} entries, CRC {table.crc32:08X}h"
            self._report(EventKind.TABLE, now, text, entries=len(table), crc32=table.crc32)
        elif before:
            self._report(EventKind.TABLE, now, "table in force: none, the identity", entries=0, crc32=0)

    def _changed(self, state: PositionState, feedback: Feedback, now: float) -> None:
        before, self._state = self._state, state
        if state is PositionState.VALID:
            self._causes = 0
            text = f"position valid again, after {_time(now - self._not_valid_s)}"
            text, self._was_valid = text if self._was_valid else "position valid", True
        else:
            if before in (None, PositionState.VALID):
                self._not_valid_s = now
            text = f"position {state}: {self._why_not_valid(state, feedback)}"
        lost = state is PositionState.LOST
        self._report(
            EventKind.POSITION,
            now,
            text,
            state=str(state),
            faults=od.fault_words(feedback.status | self._causes),
            status=feedback.status,
            residual_cycles=None if math.isnan(feedback.residual) else feedback.residual,
            residual_limit_cycles=self._limits.in_force.residual_limit,
            sample=feedback.samples,
            cause=self._loss.cause.name.lower() if lost else None,
        )

    def _why_not_valid(self, state: PositionState, feedback: Feedback) -> str:
        faults = ", ".join(self._reasons(feedback, self._causes))
        if state is PositionState.LOST:
            return f"{faults}{'; ' if faults else ''}{self._loss.cause.text}; see canfb why"
        if state is PositionState.COASTING:
            return faults or self.unconfirmed() or "not confirmed yet"
        return faults or "no reference yet"

    def _reasons(self, feedback: Feedback, bits: int) -> list[str]:
        limit, residual = self._limits.in_force.residual_limit, feedback.residual
        over = f"residual {residual:.3f} over {limit:.3f} cycle"
        # In doubt, a sample with a small residual may still contradict those before it.
        fits_not = f"residual {residual:.3f} cycle, within {limit:.3f}: contradicts the samples before"
        figures = {
            RESIDUAL: over if residual >= limit else fits_not,
            AMPLITUDE: f"{_amplitude(feedback)} outside of {self._low.value} to {self._high.value}",
        }
        known = {bit: words for bit, words in figures.items() if bit & feedback.status}
        return [known.get(bit, words) for bit, words in od.FAULT_WORDS.items() if bits & bit]


def _amplitude(feedback: Feedback) -> str:
    amplitude = feedback.amplitude
    return f"amplitude {amplitude:.0f} counts" if math.isfinite(amplitude) else "no amplitude"


def _time(seconds: float) -> str:
    return f"{seconds:.3g} s" if seconds >= 1.0 else f"{seconds * 1e3:.3g} ms"
