"""The position from the feedback module, as the drive receives it: supervised, unwrapped, differentiated."""

from __future__ import annotations

import math
from collections import deque
from enum import IntFlag
from statistics import median

from canfb.device.od.dictionary import Dictionary

U32_RANGE = 1 << 32
SENSOR_CODES = 0x7300  # EMCY codes 73xxh are those of a sensor (CiA 301, table of error codes).
MOST_OPEN = 256


class Wrong(IntFlag):
    """The present errors of the feedback, bits of 2111:01."""

    STATUS = 0x01
    MISSING = 0x02
    EMERGENCY = 0x04
    RANGE = 0x08
    STEP = 0x10


class FeedbackInput:
    """Takes 60E4:01 with its status word 2110:01, once for each RPDO.

    A position is used if the status word is as 2110:02 and :03 require, if it is within its range (2110:05),
    and if the step from the last one, wrapped to ± half the range, is possible. The first one is taken as
    -range/2..range/2, so that a machine slightly below zero is not at the far end. Until then the feedback is
    missing.
    """

    def __init__(self, dictionary: Dictionary) -> None:
        entry = dictionary.entry
        self._value, self._status = entry(0x60E4, 1), entry(0x2110, 1)
        self._mask, self._expected = entry(0x2110, 2), entry(0x2110, 3)
        self._range, self._tolerated = entry(0x2110, 5), entry(0x2110, 6)
        self._largest = entry(0x2110, 9)
        self._increments, self._turns = entry(0x60E6, 1), entry(0x60EB, 1)
        self._wrong, self._used, self._missed = (entry(0x2111, sub) for sub in (1, 2, 3))
        entry(0x2110, 4)  # the residual of the module, mapped for reading only
        self.position = 0  # Increments of the feedback, unwrapped.
        self.reset()

    @property
    def wrong(self) -> Wrong:
        return Wrong(self._wrong.value)

    def reset(self) -> None:
        self._wrong.value = Wrong.MISSING
        self.lose()

    def lose(self) -> None:
        """No position can arrive: the feedback is missing. An error reported by EMCY persists."""
        self._wrong.value = self.wrong & Wrong.EMERGENCY | Wrong.MISSING
        self._last: int | None = None
        self._since_pdo = 0  # SYNCs since the last PDO
        self._open = 0  # SYNCs after the one of the last used position: no position for them yet
        self._syncs: list[float] = [math.nan]  # times of the last used SYNC and of the open ones, at most 256
        self.speed = 0.0  # Revolutions per second, mean over the last interval, in true time.

    @property
    def increments_per_revolution(self) -> float:
        return float(self._increments.value / max(1, self._turns.value))

    @property
    def revolutions(self) -> float:
        return self.position / self.increments_per_revolution

    @property
    def status(self) -> int:
        return int(self._status.value)

    def sync(self, received_s: float) -> None:
        self._since_pdo += 1
        self._open += 1
        self._syncs.append(received_s)
        if len(self._syncs) > MOST_OPEN:
            del self._syncs[1]
        if self._since_pdo > 1:
            self._missed.value = (self._missed.value + 1) & 0xFFFFFFFF
        if self._since_pdo - 1 > self._tolerated.value:
            self._wrong.value |= Wrong.MISSING

    def emergency(self, code: int) -> None:
        if code == 0:
            self._wrong.value &= ~Wrong.EMERGENCY
        elif code & 0xFF00 == SENSOR_CODES:
            self._wrong.value |= Wrong.EMERGENCY

    def boot_up(self) -> None:
        self._wrong.value &= ~Wrong.EMERGENCY
        self._wrong.value |= Wrong.MISSING
        self._last = None

    def take(self, largest_speed: float, interval_s: float, *, supervised: bool) -> bool:
        """Evaluate the PDO in the dictionary; True if its position is used.

        ``largest_speed`` (revolutions/s) bounds the step; a larger one is a fault if ``supervised``, else a
        restart, as after a preset.
        """
        self._since_pdo = 0
        self._wrong.value &= Wrong.EMERGENCY
        if self._status.value & self._mask.value != self._expected.value & self._mask.value:
            self._wrong.value |= Wrong.STATUS
            return False
        raw, full = self._value.value & 0xFFFFFFFF, self._range.value or U32_RANGE
        if raw >= full:
            self._wrong.value |= Wrong.RANGE
            return False
        return self._step(raw, full, largest_speed, interval_s, supervised)

    def _step(self, raw: int, full: int, largest_speed: float, interval_s: float, supervised: bool) -> bool:
        known = self._last is not None
        if self._last is None:
            self.position = raw - full if raw >= (full + 1) // 2 else raw
            step = 0
        else:
            step = (raw - self._last + full // 2) % full - full // 2
        bound = self._bound(largest_speed, interval_s) * max(1, self._open)
        too_far = 0.0 < bound < abs(step)
        if known and self._open == 0:
            if not too_far:  # more positions than SYNCs, or the last one was assigned to a later SYNC
                self.position += step
                self._last = raw
            return False
        if too_far and supervised:
            self._wrong.value |= Wrong.STEP
            self._last = None  # the next accepted position restarts the count
            return False
        self.position += step
        self._last = raw
        if known and not too_far and interval_s > 0.0:
            self._differentiate(step / self.increments_per_revolution, interval_s)
        else:
            self.speed, self._open, self._syncs = 0.0, 0, self._syncs[-1:]
        self._used.value = (self._used.value + 1) & 0xFFFFFFFF
        return True

    def _differentiate(self, step: float, interval_s: float) -> None:
        """Speed from a step in revolutions, over the true time between the two SYNCs.

        If positions are late or lost, the number of intervals that changes the speed least is taken.
        """
        begin = self._syncs[0]

        def speed_over(intervals: int) -> float:
            passed = self._syncs[intervals] - begin
            return step / (passed if passed > 0.0 else intervals * interval_s)

        most = len(self._syncs) - 1
        intervals = min(range(most, 0, -1), key=lambda count: abs(speed_over(count) - self.speed))
        self.speed = speed_over(intervals)
        self._open = most - intervals
        del self._syncs[:intervals]

    def _bound(self, largest_speed: float, interval_s: float) -> float:
        if self._largest.value:
            return float(self._largest.value)
        return 2.0 * largest_speed * interval_s * self.increments_per_revolution


RECENT = 15  # intervals of the median: more than half of them must have a new rate


class SyncInterval:
    """Median time between two SYNCs, insensitive to pauses and late SYNCs; 0.0 before the second one."""

    def __init__(self) -> None:
        self.last_s: float | None = None
        self._apart: deque[float] = deque(maxlen=RECENT)

    @property
    def seconds(self) -> float:
        return median(self._apart) if self._apart else 0.0

    def event(self, now: float) -> None:
        last, self.last_s = self.last_s, now
        if last is not None and now > last:
            self._apart.append(now - last)
