"""Alarm and warnings of CiA 406 (6503h, 6505h, 6506h), and their EMCY.

The alarm is EMCY 7300h: the position is not valid. Its five bytes: the status word 2011:01 (2 bytes), the
cause of the loss as in 2012:10 (1), 2012:12 up to 255 (1), 0. The cause is 0 until the position is lost; the
loss then has an EMCY of its own.
"""

from __future__ import annotations

from collections.abc import Callable

from canfb import objects as od
from canfb.cia301.codes import EmergencyCode, ErrorRegister
from canfb.device.core import NEVER
from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary
from canfb.module.objects.publication import LastLoss, Latest
from canfb.signal.sample import Feedback
from canfb.signal.supervision import LOST, REFERENCED, SECOND_POSITION, VALID

REGISTER = ErrorRegister.GENERIC | ErrorRegister.DEVICE_PROFILE
SHORTEST_S = 0.1  # from one end of the alarm to the next: at most ten pairs of EMCY per second


class PositionAlarm:
    """Reports the alarm at once, but its end no sooner than 0.1 s after the last end."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self.reset()

    def reset(self) -> None:
        self.active = self._said_lost = False
        self._ended_s = -NEVER

    def report(self, valid: bool, status: int, now: float, loss: LastLoss) -> None:
        if not valid:
            lost = bool(status & LOST) and not self._said_lost
            if lost or not self.active:
                self.active, self._said_lost = True, lost
                why = bytes((int(loss.cause), min(loss.bad_samples, 0xFF))) if lost else b""
                self._node.emergency(
                    EmergencyCode.SENSOR, REGISTER, status.to_bytes(2, "little") + why, now, again=lost
                )
        elif now - self._ended_s >= SHORTEST_S:
            self.active = self._said_lost = False
            self._ended_s = now
            self._node.clear_emergency(EmergencyCode.SENSOR, now)


FREQUENCY, AMPLITUDE_LOW, NOT_REFERENCED, DISAGREES, DRIFT = (1 << n for n in (0, 1, 5, 12, 13))  # 6505h
EVERY_SAMPLE = FREQUENCY | AMPLITUDE_LOW | DISAGREES | DRIFT  # warnings that each sample can begin or end
CODES = {  # EMCY of each warning
    FREQUENCY: od.EncoderEmergency.FREQUENCY,
    AMPLITUDE_LOW: od.EncoderEmergency.AMPLITUDE_LOW,
    NOT_REFERENCED: od.EncoderEmergency.NOT_REFERENCED,
    DISAGREES: od.EncoderEmergency.SECOND_POSITION,
    DRIFT: od.EncoderEmergency.DRIFT,
}
NEAR_LIMIT = 0.8  # residual over this part of the limit
AMPLITUDE_RESERVE = 1.15  # amplitude below this multiple of the lowest accepted one
WARNINGS = 0x6505
NO_STATUS = -1  # no status word


class Warnings:
    """Object 6505h, computed when it is read, and an EMCY for each warning in 2004:01.

    A warning is reported with the sample that causes it, and ends when it was absent for 2004:02 (ms); there
    is none without a valid position. :meth:`follow` must get samples whose residual is above ``near_cycles``,
    whose amplitude is below ``reserve_counts``, or whose status word is not ``usual_status``.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        node: Node,
        latest: Latest,
        expects_pulse: Callable[[], bool],
        residual_limit: Callable[[], float],
        drift_at_limit: Callable[[], bool],
    ) -> None:
        """``expects_pulse()``: a zero pulse is wired. ``residual_limit()``: the one in force, cycles.

        ``drift_at_limit()``: the adaptation cannot follow further; :meth:`look_again` after a change of it.
        """
        self._node, self._expects_pulse = node, expects_pulse
        self._residual_limit, self._drift_at_limit = residual_limit, drift_at_limit
        self._status = dictionary.entry(*od.FEEDBACK_STATUS)  # a valid sample may be out of date
        self._low = dictionary.entry(*od.ENCODER_LOWEST_AMPLITUDE)
        self._mask = dictionary.entry(*od.WARNINGS_BY_EMCY)
        self._hold_ms = dictionary.entry(*od.WARNING_OVER_TIME)
        self._reported = 0
        self._present_s = dict.fromkeys(CODES, 0.0)
        self.near_cycles = self.reserve_counts = 0.0
        self.usual_status = NO_STATUS
        dictionary.entry(WARNINGS).on_read = lambda: self._present(latest.feedback)
        self._mask.on_written = self.look_again

    def reset(self) -> None:
        self._reported = 0
        self.limits_changed()
        self.look_again()

    def look_again(self) -> None:
        self.usual_status = NO_STATUS

    def limits_changed(self) -> None:
        # A reported warning is checked in each sample, so that its end is detected.
        following = bool(self._reported & EVERY_SAMPLE)
        self.near_cycles = -1.0 if following else NEAR_LIMIT * self._residual_limit()
        self.reserve_counts = AMPLITUDE_RESERVE * self._low.value

    def follow(self, feedback: Feedback, now: float) -> None:
        self.usual_status = feedback.status
        if not feedback.status & VALID:
            return
        present = self._present(feedback)
        enabled = present & self._mask.value
        for bit, code in CODES.items():
            if enabled & bit:
                self._present_s[bit] = now
                if not self._reported & bit:
                    self._reported |= bit
                    self._node.emergency(code, REGISTER, present.to_bytes(2, "little"), now)
            elif self._reported & bit and self._is_over(bit, now):
                self._reported &= ~bit
                self._node.clear_emergency(code, now)
        self.limits_changed()

    def _is_over(self, bit: int, now: float) -> bool:
        if bit == NOT_REFERENCED or not self._mask.value & bit:
            return True
        hold_s: float = self._hold_ms.value / 1000.0
        return now - self._present_s[bit] >= hold_s

    def _present(self, last: Feedback | None) -> int:
        unreferenced = last is None or not last.status & REFERENCED
        warnings = NOT_REFERENCED if unreferenced and self._expects_pulse() else 0
        if last is None or not self._status.value & VALID:
            return warnings
        found = {
            FREQUENCY: last.residual > NEAR_LIMIT * self._residual_limit(),
            AMPLITUDE_LOW: last.amplitude < AMPLITUDE_RESERVE * self._low.value,
            DISAGREES: last.status & SECOND_POSITION,
            DRIFT: self._drift_at_limit(),
        }
        return warnings | sum(bit for bit, is_there in found.items() if is_there)
