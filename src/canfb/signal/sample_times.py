"""Sample times of the encoder interface (2000:05): how many sampling intervals lie between two samples.

The interface's own clock says it exactly, so the jitter of SYNC and the delays of the bus cost nothing.
Only the ratio of differences enters eq. 9: neither the drift of that clock nor the length of the
interval matters. But a time may be wrong, of another sample, or of a clock that was started again: it is
held against the number of intervals that were counted, against the line through the times before it
(:mod:`canfb.signal.nominal_sync`), and against the receptions.
"""

from __future__ import annotations

import math

from canfb.signal.nominal_sync import NominalSync
from canfb.signal.sample import TICK_S, TICKS
from canfb.signal.usual_scatter import BEYOND, DOUBTED, LEARNED_SAMPLES, UsualScatter

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
# Intervals: a time half an interval from its line is as near to that of another SYNC; receptions of two
# SYNCs, each nearly half an interval off, are apart by more.
LINE_PART, HEARD_PART = 0.5, 0.75
SAME_PACE = 0.002  # of the interval: a limit of acceleration counts with its square
DRIFT = 2e-4  # of two clocks, 100 ppm each
RELOCK = 6  # times in a row that are off the line, and right: SYNC has another rate, or another phase
REPEATED, SUSPECT, RESTARTED, CROWDED = -1.0, -2.0, -3.0, -4.0


class SampleTimes:
    """Turns sample times into elapsed intervals, and judges them.

    ``sync_interval_s`` is the nominal interval of SYNC, seconds, which a module sets for several samples in
    one; while it is 0.0, that of ``nominal_sync`` takes its place: the interface knows its pace best.
    """

    __slots__ = (
        "_earlier",
        "_earlier_counted",
        "_earlier_times",
        "_heard",
        "_jitter",
        "_last",
        "_late_s",
        "_late_spare_s",
        "_odd_s",
        "_off_line",
        "_on_line",
        "_pace_s",
        "_received_s",
        "_suspect",
        "_suspected",
        "_synced_s",
        "nominal_sync",
        "passed",
        "sync_interval_s",
    )

    def __init__(self) -> None:
        self.sync_interval_s = 0.0
        self.nominal_sync = NominalSync()
        """The line through the times that were taken."""
        self.passed = 1.0
        """Intervals since the last sample that was taken, by a time that is RESTARTED, if it is right."""
        self.reset()

    def reset(self) -> None:
        """:meth:`forget`, and what is usual: it may be another interface, or another bus."""
        self._jitter = UsualScatter()  # of the sample times around their line
        self._on_line = False  # until then the jitter is that of the first times around theirs
        self._heard = UsualScatter()  # of the sample times against the receptions of SYNC
        self._pace_s = 0.0  # the interval, while nobody says how long it is
        self.nominal_sync.forget()
        self.forget()

    def forget(self) -> None:
        """The next time is the first one."""
        self.nominal_sync.restart()
        self._off_line = 0  # times in a row
        self._last: int | None = None
        self._received_s: float | None = None  # when that was received
        self._synced_s: float | None = None  # when its SYNC was
        self._late_s = 0.0  # so late the host took it, at least, by the sample times; 0 with receive times
        self._late_spare_s = 0.0  # and so much more at most: the drift of two clocks while frames waited
        self._odd_s: float | None = None  # the deviation of a SUSPECT time after it, seconds
        self._suspect: int | None = None
        self._suspected = 0.0  # intervals counted up to it
        self._earlier: int | None = None  # the last time that was REPEATED
        self._earlier_counted = 0.0  # intervals counted up to it
        self._earlier_times = 0  # this many continued the count

    @property
    def unit_s(self) -> float:
        """The interval in which elapsed times are given, seconds; 0.0 before it is known."""
        return self.sync_interval_s or self._pace_s

    def _follow_pace(self) -> None:
        """Speeds are in intervals: they get another unit only where the interval is another one."""
        pace_s = self.nominal_sync.period_ticks * TICK_S
        if abs(pace_s - self._pace_s) > SAME_PACE * pace_s:
            self._pace_s = pace_s

    def in_turn(self, time_100ns: int, received_s: float | None, synced_s: float | None) -> float:
        """:meth:`elapsed` for the next sample in turn, if there is no need to look closely; else 0.0.

        It deviates by less than usual from its line, by its own clock and by that of the receptions.
        """
        last, line, unit, jitter = self._last, self.nominal_sync, self._pace_s, self._jitter
        if last is None or self.sync_interval_s:
            return 0.0
        if not line.seen or jitter.learned < LEARNED_SAMPLES:
            return 0.0
        ticks, period, proved = time_100ns - last, line.period_ticks, received_s is not None
        passed_s = ticks * TICK_S
        intervals = passed_s / unit
        off = ticks - line.lead_ticks - period
        off_s = abs(off) * TICK_S
        if (
            abs(intervals - 1.0) > NOMINAL
            or off_s > (jitter.limit_s if proved else jitter.ever_s)
            or off_s > LINE_PART * unit
            or abs(period * TICK_S - unit) > SAME_PACE * period * TICK_S  # as in _follow_pace
        ):
            return 0.0
        late_s = 0.0
        if synced_s is not None and self._synced_s is not None:
            heard = self._heard
            later_s = synced_s - self._synced_s + self._late_s - passed_s
            error_s = abs(later_s)
            most_s = HEARD_PART * unit if proved else math.inf
            if heard.learned < LEARNED_SAMPLES or error_s > heard.limit_s or error_s > most_s:
                return 0.0
            if not proved:
                if -later_s > heard.ever_s + self._late_spare_s:
                    return 0.0
                # As in _lateness_s.
                late_s = max(0.0, later_s - DRIFT * passed_s)
                self._late_spare_s = self._spare_s(passed_s, late_s)
            heard.learn(error_s)
        jitter.learn(off_s)
        line.follow(off)
        self._off_line = 0
        self._last, self._received_s, self._synced_s = time_100ns, received_s, synced_s
        self._late_s = late_s
        return intervals

    def elapsed(
        self,
        time_100ns: int,
        counted: float,
        received_s: float | None = None,
        synced_s: float | None = None,
        speed_cycles: float = 0.0,
        extra: bool = False,
    ) -> float:
        """Intervals since the last sample that was taken, above 0; or what is wrong with this time.

        ``counted`` intervals have passed by the count of SYNCs; the sample was received at
        ``received_s`` and the SYNC that it answers at ``synced_s``, seconds, None if that is not known.
        ``synced_s`` alone is when SYNC was taken, by a host that may have been late.
        ``speed_cycles`` is that of the machine, cycles per interval: a time that is off by more than
        usual is a bad one only where this would cost the cycle count. ``extra``: a SYNC too many came since
        the last one, and the sample may answer it: off the line its time says nothing of the line.

        REPEATED: it is that of the last sample or of one before. SUSPECT: it fits nothing, the next time must
        show whether it or the clock is wrong; the sample is not to be used. CROWDED: a new sample, so near to
        the last one that it would give a poor speed. RESTARTED: the clock was, and how long the interval was
        cannot be known.
        """
        last = self._last
        if last is None:
            if self.sync_interval_s and not self.nominal_sync.period_ticks:
                self.nominal_sync.expect(self.sync_interval_s / TICK_S)
            self._accept(time_100ns, received_s, synced_s)
            return counted
        ticks = (time_100ns - last) % TICKS
        if ticks >= HALF_TICKS:
            ticks -= TICKS
        if not self.unit_s:
            if not 0 < ticks < HALF_TICKS:
                return REPEATED
            self._pace_s = ticks * TICK_S / counted
        if not self.sync_interval_s and self.nominal_sync.period_ticks:
            self._follow_pace()
        unit = self.unit_s
        intervals = ticks * TICK_S / unit
        apart = self._apart_s(received_s)
        error_s = self._error_s(ticks * TICK_S, received_s, synced_s)
        late_s = self._lateness_s(ticks, received_s, synced_s)
        spare_s = self._spare_s(ticks * TICK_S, late_s)
        # The receptions say how long it was even where SYNCs came too near together to count well, and so
        # does the line after a SYNC that was late.
        goes_on = counted < 1.5 or error_s < CLOSE * unit or not self._is_off(ticks, counted)
        least = CLOSEST if goes_on else counted - SPARE_BEFORE
        agrees = error_s <= SPARE_S + SPARE_PART * unit
        nominal = abs(intervals - counted) <= NOMINAL  # also where a simulation is slower than true time
        in_turn = least <= intervals <= counted + SPARE_AFTER and (agrees or nominal or apart is None)
        witnessed = intervals >= CLOSEST and self._is_witnessed(ticks, counted, received_s, synced_s)
        if witnessed:
            self.passed = intervals
            if self.nominal_sync.seen:
                self.nominal_sync.skip(ticks)
            self._accept(time_100ns, received_s, synced_s, late_s, spare_s)
            return intervals
        if in_turn or (agrees and intervals > counted):  # or there were SYNCs that were not received
            whole = counted
            if agrees and intervals > counted + 0.5:
                whole = max(
                    counted,
                    round((self._synced_apart_s(synced_s) or self._apart_s(received_s) or 0.0) / unit),
                )
            self.passed = intervals
            skips = extra and self._is_off(ticks, whole)
            odd = self._judge(ticks, whole, synced_s, received_s is not None, abs(speed_cycles), not skips)
            if odd == RESTARTED:
                moved = self._is_explained(error_s, SLIP_CYCLES * unit, abs(speed_cycles))
                self._restart(time_100ns, received_s, synced_s)
                return intervals if moved else RESTARTED
            if not odd:
                if skips:
                    self.nominal_sync.skip(ticks)
                else:
                    self._follow(ticks, whole if self.nominal_sync.seen else counted)
                self._accept(time_100ns, received_s, synced_s, late_s, spare_s)
            return odd or intervals
        if 0.0 < intervals < CLOSEST:
            return CROWDED
        if -OLDEST <= intervals < least:
            return self._repeated(time_100ns, counted, unit, received_s)
        self.passed = intervals
        return self._doubted(time_100ns, counted, unit, received_s)

    def _follow(self, ticks: int, whole: float) -> None:
        """The line goes on through a time that is right, or begins again where none lies on it any more."""
        line = self.nominal_sync
        self._off_line = self._off_line + 1 if self._is_off(ticks, whole) else 0
        if self._off_line >= RELOCK:
            self._off_line = 0
            line.restart()
        line.take(ticks, whole)
        if not self._on_line:
            self._on_line = line.seen > 0
            self._jitter.begin([abs(off) * TICK_S for off in line.first_off_ticks])

    def _is_off(self, ticks: int, whole: float) -> bool:
        return abs(self._off_s(ticks, whole)) > self._jitter.limit_of(self.unit_s, LINE_PART)

    def _off_s(self, ticks: int, whole: float) -> float:
        """How much later a time is than its line has it, ``whole`` intervals after the last one."""
        line = self.nominal_sync
        if not line.period_ticks:
            return ticks * TICK_S - whole * self.unit_s
        return line.off_ticks(ticks, whole) * TICK_S

    def _error_s(self, by_time_s: float, received_s: float | None, synced_s: float | None) -> float:
        """By how much the time contradicts the receptions; a late one of either does not make it wrong."""
        apart = self._apart_s(received_s)
        if apart is None:
            return math.inf
        error_s = abs(by_time_s - apart)
        synced_apart_s = self._synced_apart_s(synced_s)
        return error_s if synced_apart_s is None else min(error_s, abs(by_time_s - synced_apart_s))

    def _synced_apart_s(self, synced_s: float | None) -> float | None:
        """Seconds between the SYNCs of both; where the last one was taken late, as if it had not been."""
        if synced_s is None or self._synced_s is None:
            return None
        return synced_s - self._synced_s + self._late_s

    def _lateness_s(self, ticks: int, received_s: float | None, synced_s: float | None) -> float:
        """How late the SYNC of this sample was taken, at least, by a host that does not say when it came.

        By the sample times, since one that was taken in time. So frames that wait for a host that stalls
        are known to have waited, and the first one behind them is not taken for one after so short a time.
        """
        apart_s = self._synced_apart_s(synced_s)
        if received_s is not None or apart_s is None:
            return 0.0
        passed_s = ticks * TICK_S
        return max(0.0, apart_s - passed_s - DRIFT * passed_s)

    def _spare_s(self, passed_s: float, late_s: float) -> float:
        """By how much more the SYNC of this sample may have been taken late, where it or the last one waited.

        Two clocks, each of which is off by DRIFT, say how late it was, since the last one that was in time.
        """
        waited = late_s > self._heard.ever_s or self._late_s > self._heard.ever_s
        return self._late_spare_s + 2.0 * DRIFT * passed_s if waited else 0.0

    def _is_witnessed(
        self, ticks: int, counted: float, received_s: float | None, synced_s: float | None
    ) -> bool:
        """The interval is not ``counted`` long, and both clocks say so: SYNC was late, or some were not sent.

        The receptions are further from the count than they ever were from a time, and from this time no
        further than that. So a host that is late all the time witnesses nothing. Nor does one that is later
        than ever once, by a little: without receive times they are further by more than is usual.
        """
        heard, synced_apart_s = self._heard, self._synced_apart_s(synced_s)
        if heard.learned < LEARNED_SAMPLES or synced_apart_s is None:
            return False
        if not self._is_off(ticks, counted):
            return False
        most_s = heard.limit_s if received_s is None else heard.ever_s
        error_s = abs(ticks * TICK_S - synced_apart_s)
        return error_s <= heard.ever_s and most_s < abs(ticks * TICK_S - counted * self.unit_s) - error_s

    def _is_explained(self, error_s: float, slip: float, speed_cycles: float) -> bool:
        """Two times in a row are off the line equally, but the receptions were as uneven: no clock was set.

        As far as it could cost the count, or within what is usual; or the receptions are off the line
        themselves by more than ever, and from the times by no more than ever.
        """
        usual_s = min(self._jitter.limit_s, self._heard.limit_s)
        moved = error_s <= self._heard.ever_s < abs(self._odd_s or 0.0) - error_s
        return moved or error_s * speed_cycles <= slip or error_s <= usual_s

    def _apart_s(self, received_s: float | None) -> float | None:
        """Seconds between the receptions of the last sample that was taken and of this one."""
        return None if received_s is None or self._received_s is None else received_s - self._received_s

    def _judge(
        self,
        ticks: int,
        whole: float,
        synced_s: float | None,
        proved: bool,
        speed_cycles: float,
        learns: bool,
    ) -> float:
        """Is a time off by more than usual, and would that cost the count? 0.0: no; SUSPECT or RESTARTED.

        From its line, ``whole`` intervals after the last one, or by the receptions of both SYNCs, whichever
        is the sharper witness. Receptions that are not ``proved`` may be late, and make no time right. But
        a time that they contradict, and that is further off than any before by a quarter, is none of a late
        SYNC; nor is one that is later than they allow by more than they ever were late, as no host takes a
        SYNC before it comes. A second one that is off by as much as the one before: the clock was set. Each
        witness learns what is usual to it.
        """
        jitter, heard, before, unit = self._jitter, self._heard, self._odd_s, self.unit_s
        off_s, limit_s, witness = self._off_s(ticks, whole), jitter.limit_of(unit, LINE_PART), jitter
        synced_apart_s = self._synced_apart_s(synced_s)
        if synced_apart_s is not None and self._late_s <= unit:  # frames that wait say nothing of the next
            error_s = ticks * TICK_S - synced_apart_s
            heard_s = heard.limit_of(unit, HEARD_PART) if proved else heard.limit_of(unit, math.inf)
            # How late a SYNC was that waited is known as well as two clocks ran alike meanwhile.
            ever_s = heard.ever_s + self._late_spare_s
            # Equally sharp, as at the start: right if one of them agrees; the SYNC or the host may be late.
            sharper = heard_s < limit_s or (heard_s == limit_s and abs(error_s) < abs(off_s))
            if proved and sharper:
                jitter.see(off_s, limit_s)
                off_s, limit_s, witness = error_s, heard_s, heard
            elif not proved and error_s > ever_s and heard.learned >= LEARNED_SAMPLES:
                off_s, limit_s, witness = error_s, ever_s, heard
            elif not heard.see(error_s, heard_s) and not proved:
                limit_s = max(limit_s, jitter.limit_s) * DOUBTED / BEYOND
        usual = witness.see(off_s, limit_s) if learns else abs(off_s) <= limit_s
        if usual or abs(off_s) * speed_cycles <= SLIP_CYCLES * unit:
            return 0.0
        self._odd_s = off_s
        return RESTARTED if before is not None and abs(off_s - before) <= limit_s else SUSPECT

    def _accept(
        self,
        time_100ns: int,
        received_s: float | None,
        synced_s: float | None,
        late_s: float = 0.0,
        spare_s: float = 0.0,
    ) -> None:
        self._last, self._received_s, self._suspect = time_100ns, received_s, None
        self._synced_s, self._odd_s = synced_s, None
        self._late_s, self._late_spare_s = late_s, spare_s

    def _restart(self, time_100ns: int, received_s: float | None, synced_s: float | None = None) -> None:
        """The clock was started again or set, or SYNC is on another grid: a line begins here."""
        self.nominal_sync.restart()
        self._accept(time_100ns, received_s, synced_s)

    def _repeated(self, time_100ns: int, counted: float, unit: float, received_s: float | None) -> float:
        """An earlier sample; unless all that come are earlier ones, and as far apart as they are counted."""
        earlier, self._earlier = self._earlier, time_100ns
        since, self._earlier_counted = counted - self._earlier_counted, counted
        apart = 0.0 if earlier is None else (time_100ns - earlier) % TICKS * TICK_S / unit
        goes_on = since > 0.0 and apart > 0.0 and abs(apart - since) <= SPARE_AFTER
        self._earlier_times = self._earlier_times + 1 if goes_on else 0
        if self._earlier_times < EARLIER_TIMES:
            return REPEATED
        self._restart(time_100ns, received_s)
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
        self._restart(time_100ns, received_s)
        return RESTARTED
