"""Sample times of the encoder interface (2000:05): how many sampling intervals lie between two samples.

The interface's own clock says it exactly, so the jitter of SYNC and the delays of the bus cost nothing.
Only the ratio of differences enters eq. 9: neither the drift of that clock nor the length of the
interval matters. But a time may be wrong, of another sample, or of a clock that was started again: it is
held against the number of intervals that were counted.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import median

from canfb.signal.usual_scatter import LEARNED_SAMPLES, UsualScatter

TICK_S = 1e-7  # 2000:05
TICKS = 1 << 32
HALF_TICKS = TICKS // 2
OLDEST = 64.0  # intervals: a time that lies no further back is that of an earlier sample
CLOSEST = 0.25  # intervals: samples closer together would give a poor speed
EARLIER_TIMES = 3  # in a row that go on with the count of SYNCs, after the first: the clock was set back
SPARE_BEFORE, SPARE_AFTER = 0.5, 0.95  # intervals, around the number that was counted
CLOSE = 0.35  # interval: sample time and reception agree, and a late PDO would not
NOMINAL = 0.05  # interval: so near to what was counted, no reception is asked
SPARE_S, SPARE_PART = 0.5e-3, 0.3  # seconds and intervals: a bus and a host delay a PDO by this much
# A time may be wrong by no more than this, in cycles at the speed of the machine, without a second opinion:
# with the residual limit of 1/3 it is less than half a cycle.
SLIP_CYCLES = 0.15
MOST_PACES, PACES_TOGETHER = 32, 8  # intervals
SAME_PACE = 0.02  # of the interval
REPEATED, SUSPECT, RESTARTED, CROWDED = -1.0, -2.0, -3.0, -4.0


class SampleTimes:
    """Turns sample times into elapsed intervals, and judges them.

    ``interval_s`` is the nominal sampling interval, seconds; while it is 0.0, the median of those that are
    seen takes its place: the interface knows its pace better than anybody who hears of it.
    """

    __slots__ = (
        "_earlier",
        "_earlier_counted",
        "_earlier_times",
        "_heard",
        "_jitter",
        "_last",
        "_odd_s",
        "_pace_s",
        "_paces_s",
        "_received_s",
        "_suspect",
        "_suspected",
        "_synced_s",
        "_until_pace",
        "interval_s",
        "passed",
    )

    def __init__(self) -> None:
        self.interval_s = 0.0
        self.passed = 1.0
        """Intervals since the last sample that was taken, by a time that is RESTARTED, if it is right."""
        self.reset()

    def reset(self) -> None:
        """:meth:`forget`, and what is usual: it may be another interface, or another bus."""
        self._jitter = UsualScatter()  # of the sample times
        self._heard = UsualScatter()  # of the sample times against the receptions of SYNC
        self._pace_s = 0.0  # the interval, while nobody says how long it is: the median of
        self._paces_s: deque[float] = deque(maxlen=MOST_PACES)
        self._until_pace = 0  # samples until it is looked at again
        self.forget()

    def forget(self) -> None:
        """The next time is the first one."""
        self._last: int | None = None
        self._received_s: float | None = None  # when that was received
        self._synced_s: float | None = None  # when its SYNC was
        self._odd_s: float | None = None  # a time after that was off by so much
        self._suspect: int | None = None
        self._suspected = 0.0  # intervals counted up to it
        self._earlier: int | None = None  # the last time that was REPEATED
        self._earlier_counted = 0.0  # intervals counted up to it
        self._earlier_times = 0  # this many continued the count

    @property
    def unit_s(self) -> float:
        """The interval in which elapsed times are given, seconds; 0.0 before it is known."""
        return self.interval_s or self._pace_s

    def _follow_pace(self) -> None:
        """With each sample at first, then now and then."""
        if self._until_pace:
            self._until_pace -= 1
        elif self._paces_s:
            pace_s = median(self._paces_s)
            known = len(self._paces_s)
            self._until_pace = known if known == MOST_PACES else PACES_TOGETHER * (known > PACES_TOGETHER)
            if abs(pace_s - self._pace_s) > SAME_PACE * pace_s:
                self._pace_s = pace_s

    def in_turn(self, time_100ns: int, received_s: float | None, synced_s: float | None) -> float:
        """:meth:`elapsed` for the next sample in turn, if there is no need to look closely; else 0.0.

        It deviates by less than usual from one interval, by its own clock and by that of the receptions.
        """
        last, unit, jitter, heard = self._last, self._pace_s, self._jitter, self._heard
        if last is None or self.interval_s or not self._until_pace or jitter.learned < LEARNED_SAMPLES:
            return 0.0
        ticks = time_100ns - last
        if ticks <= 0:
            return 0.0
        passed_s = ticks * TICK_S
        intervals = passed_s / unit
        uneven_s = abs((intervals - 1.0) * unit)
        if uneven_s > jitter.limit_s or uneven_s > NOMINAL * unit:
            return 0.0
        if synced_s is not None and self._synced_s is not None:
            error_s = abs(passed_s - (synced_s - self._synced_s))
            if heard.learned < LEARNED_SAMPLES or error_s > heard.limit_s:
                return 0.0
            heard.learn(error_s)
        jitter.learn(uneven_s)
        self._until_pace -= 1
        self._paces_s.append(passed_s)
        self._last, self._received_s, self._synced_s = time_100ns, received_s, synced_s
        return intervals

    def elapsed(
        self,
        time_100ns: int,
        counted: float,
        received_s: float | None = None,
        synced_s: float | None = None,
        speed_cycles: float = 0.0,
    ) -> float:
        """Intervals since the last sample that was taken, above 0; or what is wrong with this time.

        ``counted`` intervals have passed by the count of SYNCs; the sample was received at
        ``received_s`` and the SYNC that it answers at ``synced_s``, seconds, None if that is not known.
        ``speed_cycles`` is that of the machine, cycles per interval: a time that is off by more than
        usual is a bad one only where this would cost the cycle count. REPEATED: it is that of the last
        sample or of one before. SUSPECT: it fits nothing, the next time must show whether it or the
        clock is wrong; the sample is not to be used. CROWDED: a new sample, so near to the last one that it
        would give a poor speed. RESTARTED: the clock was, and how long the
        interval was cannot be known.
        """
        last = self._last
        if last is None:
            self._accept(time_100ns, received_s, synced_s)
            return counted
        ticks = (time_100ns - last) % TICKS
        if ticks >= HALF_TICKS:
            ticks -= TICKS
        if not self.unit_s:
            if not 0 < ticks < HALF_TICKS:
                return REPEATED
            self._pace_s = ticks * TICK_S / counted
        if not self.interval_s:
            self._follow_pace()
        unit = self.unit_s
        intervals = ticks * TICK_S / unit
        apart = self._apart_s(received_s)
        error_s = self._error_s(ticks * TICK_S, received_s, synced_s)
        # The receptions say how long it was even where SYNCs came too near together to count well.
        least = CLOSEST if counted < 1.5 or error_s < CLOSE * unit else counted - SPARE_BEFORE
        agrees = error_s <= SPARE_S + SPARE_PART * unit
        nominal = abs(intervals - counted) <= NOMINAL  # also where a simulation is slower than true time
        in_turn = least <= intervals <= counted + SPARE_AFTER and (agrees or nominal or apart is None)
        if in_turn or (agrees and intervals > counted):  # or there were SYNCs that were not received
            whole = round(intervals) if agrees and intervals > counted + 0.5 else counted
            uneven_s = (intervals - whole) * unit
            self.passed = intervals
            odd = self._judge(uneven_s, ticks, synced_s, SLIP_CYCLES * unit, abs(speed_cycles))
            if odd == RESTARTED and self._is_explained(error_s, SLIP_CYCLES * unit, abs(speed_cycles)):
                odd = 0.0
            if odd != SUSPECT:
                self._accept(time_100ns, received_s, synced_s)
            if not (odd or self.interval_s):
                self._paces_s.append(ticks * TICK_S / counted)
            return odd or intervals
        if agrees and 0.0 < intervals < CLOSEST:
            return CROWDED
        if -OLDEST <= intervals < least:
            return self._repeated(time_100ns, counted, unit, received_s)
        self.passed = intervals
        return self._doubted(time_100ns, counted, unit, received_s)

    def _error_s(self, by_time_s: float, received_s: float | None, synced_s: float | None) -> float:
        """By how much the time contradicts the receptions; a late one of either does not make it wrong."""
        apart = self._apart_s(received_s)
        if apart is None:
            return math.inf
        error_s = abs(by_time_s - apart)
        if synced_s is not None and self._synced_s is not None:
            error_s = min(error_s, abs(by_time_s - (synced_s - self._synced_s)))
        return error_s

    def _is_explained(self, error_s: float, slip: float, speed_cycles: float) -> bool:
        """Two times in a row contradict the even pace equally, but one of the receptions was as uneven.

        As far as it could cost the count, or within what is usual: the master or the interface was late,
        and no clock was set.
        """
        usual_s = min(self._jitter.limit_s, self._heard.limit_s)
        return error_s * speed_cycles <= slip or error_s <= usual_s

    def _apart_s(self, received_s: float | None) -> float | None:
        """Seconds between the receptions of the last sample that was taken and of this one."""
        return None if received_s is None or self._received_s is None else received_s - self._received_s

    def _judge(
        self, uneven_s: float, ticks: int, synced_s: float | None, slip: float, speed_cycles: float
    ) -> float:
        """Is a time off by more than usual, and would that cost the count? 0.0: no; SUSPECT or RESTARTED.

        By its distance from the last one, ``uneven_s`` from a whole number of intervals, or by the
        receptions of both SYNCs, whichever is the sharper witness. A second one that is off by as much
        as the one before: the clock was set.
        """
        jitter, heard, before = self._jitter, self._heard, self._odd_s
        unit = self.unit_s
        off_s, limit_s, witness = uneven_s, jitter.limit_of(unit), jitter
        error_s = None
        if synced_s is not None and self._synced_s is not None:
            error_s = ticks * TICK_S - (synced_s - self._synced_s)
            heard_s = heard.limit_of(unit)
            # Equally sharp, as at the start: right if one of them agrees; the SYNC or the host may be late.
            if heard_s < limit_s or (heard_s == limit_s and abs(error_s) < abs(off_s)):
                off_s, limit_s, witness = error_s, heard_s, heard
        if not abs(off_s) > limit_s:
            jitter.learn(abs(uneven_s))
            if error_s is not None:
                heard.learn(abs(error_s))
            return 0.0
        witness.refuse(abs(off_s))
        if abs(off_s) * speed_cycles <= slip:
            return 0.0
        self._odd_s = off_s
        return RESTARTED if before is not None and abs(off_s - before) <= limit_s else SUSPECT

    def _accept(self, time_100ns: int, received_s: float | None, synced_s: float | None = None) -> None:
        self._last, self._received_s, self._suspect = time_100ns, received_s, None
        self._synced_s, self._odd_s = synced_s, None

    def _repeated(self, time_100ns: int, counted: float, unit: float, received_s: float | None) -> float:
        """An earlier sample; unless all that come are earlier ones, and as far apart as they are counted."""
        earlier, self._earlier = self._earlier, time_100ns
        since, self._earlier_counted = counted - self._earlier_counted, counted
        apart = 0.0 if earlier is None else (time_100ns - earlier) % TICKS * TICK_S / unit
        goes_on = since > 0.0 and apart > 0.0 and abs(apart - since) <= SPARE_AFTER
        self._earlier_times = self._earlier_times + 1 if goes_on else 0
        if self._earlier_times < EARLIER_TIMES:
            return REPEATED
        self._accept(time_100ns, received_s)
        self._earlier_times = 0
        return RESTARTED

    def _doubted(self, time_100ns: int, counted: float, unit: float, received_s: float | None) -> float:
        suspect, self._suspect = self._suspect, time_100ns
        since, self._suspected = counted - self._suspected, counted
        if suspect is None or since <= 0.0:
            return SUSPECT
        ticks = (time_100ns - suspect) % TICKS
        if abs(ticks * TICK_S / unit - since) > SPARE_AFTER:
            return SUSPECT
        # Two times in a row agree with each other and not with the last good one.
        self._accept(time_100ns, received_s)
        return RESTARTED
