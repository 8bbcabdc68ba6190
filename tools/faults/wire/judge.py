"""The judge: compares every position that the module sends as valid with the true one.

Rules: the correct positions, by the cause of the frame (times in T, true receive times):

J1  an ADC PDO: the position of its sample, of the newest sample received, or of the last SYNC.
    For an old PDO also the true position at the nominal time of the last SYNC (P5).
J2  SYNC s (synchronous PDOs), or a foreign PDO after it: the sample of the previous SYNC (FRESH), or of s.
    If a late host and a missed SYNC look alike (P2 in README.md), also the newest sample received.
    With 2013h, the position at the SYNC itself, or one period after the sample (docs/latency.md).
J3  a timer, an SDO read, NMT: the newest sample received, if not older than FRESH; else the true
    position at that instant. So a frozen position is wrong once the machine has moved.
J4  a sample time with an undetectable error (P4): also the position at that time; at a SYNC also a sample
    that is as close to the nominal time of the previous SYNC.

A position is correct if it is within half a cycle of one of these. A frame with bit 0 and no correct position
is **valid and wrong**. No latency is allowed. Frames without bit 0 are never wrong.
"""

import math
import struct
from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

from tools.faults.machine import within_half
from tools.faults.wire import physics
from tools.faults.wire.line import TICK_S, Event, Line, Plan, Sent
from tools.faults.wire.setups import (
    CYCLES_PER_REVOLUTION,
    EMCY_ID,
    RANGE_CYCLES,
    SDO_TX,
    TPDO1_ID,
    UNITS_PER_CYCLE,
)

VALID, LOST = 1 << 0, 1 << 2
FRESH = 3.0  # largest age of a position: 2 periods (2010:06), and one for late SYNC, PDO and host
START = 12.0  # time until a position must be valid: a coarse track is found at rest
SEARCH = 64  # most samples of a start with sample times and 2010:02 (docs/supervision.md)
ACCELERATION_MARGIN = 0.15  # tolerance of 2011:09, cycles/T^2
RESIDUAL_LIMIT = 1.0 / 3.0  # default of 2010:01
LIMIT_MARGIN = 0.06  # margin of a narrowed limit, and noise, cycles/T^2
MEMORY = 8  # most recent samples of which 2011:09 may be the acceleration
ACCELERATION_ID = 0x380 + 32
START_NODE, RESET_NODE = bytes([1]), bytes([129])
EMCY_WINDOW_S, EMCY_LIMIT = 0.1, 10


@dataclass
class Shown:
    """One position with its status, and its error against the nearest correct position."""

    now: float
    what: str
    position: float
    status: int
    residual: float
    error: float
    pdo: Event | None  # the ADC PDO that made the module send it
    newest: int  # newest sample that the module has received

    @property
    def valid(self) -> bool:
        return bool(self.status & VALID)


@dataclass
class Verdict:
    outcome: str = "kept"  # wrong, physics, lost, flagged, kept
    wrong: int = 0  # positions valid and wrong
    first_wrong: Shown | None = None
    early: int = 0  # positions not valid before the fault
    not_valid: int = 0
    after_start: int = 0  # positions not valid later than a start may take
    acceleration_wrong: int = 0
    emergencies: int = 0  # most EMCY within EMCY_WINDOW_S
    right_at_end: bool = False
    unanswered: int = 0  # SYNCs on the bus without a synchronous TPDO after them


class Judge:
    def __init__(self, plan: Plan, line: Line) -> None:
        self._plan, self._line = plan, line
        start = line.positions[0] if line.positions else 0.0
        self._base = start - start % 1.0  # the module begins at cycle count 0
        commands = sorted((at, data) for at, what, data in plan.actions if what == "nmt")
        resets = [place for place, (_, data) in enumerate(commands) if data == RESET_NODE]
        starts = [at for place in resets for at, data in commands[place:] if data == START_NODE]
        self._resets = starts[: len(resets)]  # times from which the module counts from 0 again
        syncs = [event for event in line.events if event.what == "sync"]
        self._sync_times = [event.time for event in syncs]
        self._sync_slots = [event.number for event in syncs]
        self._start = SEARCH if plan.setup.times and plan.options.limit is not None else 0  # in samples
        self._lost = False
        self._last_wrong = 0.0  # time of the last wrong position, T
        self._tolerance = (
            physics.stamp_tolerance(plan.setup, plan.options.interval_s) if plan.setup.times else 0.0
        )
        self._status: int | None = None  # status word of an SDO read
        self.shown: list[Shown] = []
        self.verdict = Verdict()

    def judge(self, sent: list[Sent]) -> Verdict:
        plan, verdict = self._plan, self.verdict
        emergencies: list[float] = []
        for one in sent:
            can_id, data = one.frame.can_id, one.frame.data
            if can_id == TPDO1_ID:
                position, status, residual = struct.unpack("<IHH", data)
                self._see(one, "TPDO", position, status, residual / 65536)
            elif can_id == SDO_TX:
                self._see_sdo(one, data)
            elif can_id == ACCELERATION_ID:
                self._see_acceleration(one, *struct.unpack("<Hf", data))
            elif can_id == EMCY_ID:
                emergencies.append(one.now * plan.options.interval_s)
        counts = (n + 1 - bisect_left(emergencies, at - EMCY_WINDOW_S) for n, at in enumerate(emergencies))
        verdict.emergencies = max(counts, default=0)
        self._conclude()
        if plan.options.tpdo_type == 1 and not plan.actions:
            verdict.unanswered = self._unanswered(sent)
        return verdict

    def _unanswered(self, sent: list[Sent]) -> int:
        """Slots with a SYNC but without the TPDO of type 1; repeated SYNCs count as one."""
        answered = {id(one.cause) for one in sent if one.frame.can_id == TPDO1_ID}
        slots = {event.number for event in self._line.events if id(event) in answered}
        last = max((one.now for one in sent), default=0.0)
        due = {event.number for event in self._line.events if event.what == "sync" and event.time < last}
        return len(due - slots)

    def _conclude(self) -> None:
        verdict, shown = self.verdict, self.shown
        positions = [one for one in shown if one.what == "TPDO"] or shown
        ended_valid = bool(positions) and positions[-1].valid
        verdict.right_at_end = ended_valid and abs(positions[-1].error) <= self._plan.tolerance
        if verdict.wrong:
            excused = self._is_p8() if self._plan.note.startswith("P8") else self._plan.note.startswith("P")
            excused = excused or physics.unseen(self._plan, self._last_wrong) == "P1"
            verdict.outcome = "physics" if excused or self._is_p7() or self._is_p9() else "wrong"
        elif self._lost or not ended_valid:
            verdict.outcome = "lost"
        elif verdict.not_valid:
            verdict.outcome = "flagged"

    def _is_p8(self) -> bool:
        """Case P8: a step of SYNC within the noise of receive times, detected later or too small."""
        plan = self._plan
        seen_late = plan.note == "P8" or self._last_wrong <= plan.fault + physics.STEP_SYNCS
        return seen_late and not plan.setup.times

    def _is_p7(self) -> bool:
        """Case P7: a PDO answered another SYNC, and a legal motion fits all positions until then."""
        line, shown = self._line, list[tuple[float, float]]()
        if self._plan.setup.times or not physics.answers_another(line):
            return False
        for _, one in self._samples():
            if one.pdo and one.now <= self._last_wrong:
                heard = self._last_sync(one.pdo.time)
                due = math.floor(one.pdo.time) - 1  # slot n is due at n + 1
                shown.append((max(heard, due, line.sample_slots[one.pdo.number]), one.position))
        return self._is_legal(shown)

    def _is_p9(self) -> bool:
        """Case P9: sample times have undetectable errors, and a legal motion fits the positions at them."""
        line = self._line
        off = [abs(named - time) for named, time in zip(line.named, line.sample_times, strict=True)]
        if not (self._plan.setup.times and 0.0 < max(off, default=0.0) <= self._tolerance):
            return False
        shown = [(line.named[n], one.position) for n, one in self._samples()]
        if servo := self._plan.setup.servo:  # the margin for noise grows with 1 / interval^2
            return self._is_legal(self._with_earlier(shown, servo), servo * servo * LIMIT_MARGIN)
        fastest = max(abs(two - one) for one, two in pairwise(line.positions))
        rounded = 2.0 * fastest * TICK_S / self._plan.options.interval_s  # rounding of sample times
        return self._is_legal(shown, LIMIT_MARGIN + rounded)

    def _with_earlier(self, shown: list[tuple[float, float]], per_sync: int) -> list[tuple[float, float]]:
        """``shown`` with the earlier pairs of each PDO, in the cycle by its speed, except over gaps."""
        pairs = []
        for ((before, x), (named, y)), (n, _) in zip(pairwise(shown), self._samples()[1:], strict=True):
            for k in range(per_sync - 1, 0, -1) if named - before < 1.5 else ():
                ago = k / per_sync
                true = self._plan.motion.at([self._line.sample_times[n] - ago])[0] - self._base
                expected = y - ago * within_half(y - x, RANGE_CYCLES) / (named - before)
                pairs.append((named - ago, expected + within_half(true - expected, 1.0)))
            pairs.append((named, y))
        return pairs

    def _samples(self) -> list[tuple[int, Shown]]:
        """Valid TPDOs with the number of their sample: the one of the ADC PDO, or at a SYNC the newest."""
        valid = (one for one in self.shown if one.what == "TPDO" and one.valid)
        return [(one.newest if one.pdo is None else one.pdo.number, one) for one in valid]

    def _is_legal(self, shown: list[tuple[float, float]], margin: float = LIMIT_MARGIN) -> bool:
        return physics.is_smooth(shown, (self._plan.options.limit or RESIDUAL_LIMIT) + margin, RANGE_CYCLES)

    def _see_sdo(self, one: Sent, data: bytes) -> None:
        _, index, subindex = struct.unpack_from("<BHB", data)
        value = struct.unpack_from("<I", data, 4)[0]
        if (index, subindex) == (0x2011, 1):
            self._status = value & 0xFFFF
        elif index == 0x6004 and self._status is not None and data[0] != 0x80:
            self._see(one, "SDO", value, self._status, 0.0)
            self._status = None

    def _see(self, one: Sent, what: str, units: int, status: int, residual: float) -> None:
        verdict = self.verdict
        if status & LOST and not self._lost:
            self._lost = True  # the count begins with the first valid position
            self._resets[:0] = [one.now] * (not any(shown.valid for shown in self.shown))
        position = units / UNITS_PER_CYCLE
        error = self._error(one, position)
        valid = bool(status & VALID)
        if valid and self._resets and one.now >= self._resets[0]:
            del self._resets[0]
            self._base -= round(error)
            error = self._error(one, position)
        referenced = self._plan.options.extra or self._plan.options.coarse
        if valid and referenced and self._lost and abs(error) > self._plan.tolerance:
            # A zero pulse ends a loss within the revolution.
            error = self._error(one, position, CYCLES_PER_REVOLUTION)
        pdo = one.cause if one.cause is not None and one.cause.what == "pdo" else None
        shown = Shown(one.now, what, position, status, residual, error, pdo, one.newest)
        self.shown.append(shown)
        if not valid:
            if one.newest < 0 or one.now < START:
                return
            verdict.not_valid += 1
            verdict.after_start += one.newest > self._start
            if one.now < self._plan.fault + 1.0:
                verdict.early += 1
        elif abs(error) > self._plan.tolerance:
            verdict.wrong += 1
            self._last_wrong = one.now
            verdict.first_wrong = verdict.first_wrong or shown

    def _error(self, one: Sent, position: float, whole: float = RANGE_CYCLES) -> float:
        """Error of a position against the nearest correct one."""
        truths = self._admissible(one)
        errors = (within_half(position + self._base - truth, whole) for truth in truths)
        return min(errors, key=abs, default=whole)

    def _admissible(self, one: Sent) -> list[float]:
        """Correct positions by rules J1 to J4."""
        line, cause = self._line, one.cause
        late = self._plan.options.answer_s / self._plan.options.interval_s  # 2010:0E
        if cause is not None and cause.what in ("pdo", "part", "extra"):
            slot = self._last_sync(cause.time)
            samples = {cause.number, one.newest, *self._samples_of(slot, slot)}
            true = [line.positions[n] for n in samples] + self._named(samples)
            if cause.number < one.newest:  # an old PDO may fit the sample that is due (P5)
                true += self._plan.motion.at([math.floor(cause.time)]).tolist()
            return true
        if cause is not None and cause.what in ("sync", "foreign"):
            sampled = list(self._samples_of(self._slot_before(cause.number) - int(late), cause.number))
            true = [line.positions[n] for n in sampled] or [
                float(self._plan.motion.at([cause.time - 1.0])[0])
            ]
            plan = self._plan
            if one.newest >= 0 and abs(line.sample_times[one.newest] - cause.number) <= self._tolerance:
                sampled = [*sampled, one.newest]
            if one.newest >= 0 and physics.host_may_be_late(plan.setup, plan.options.interval_s):
                newest = line.sample_times[one.newest]
                true += [line.positions[one.newest], float(plan.motion.at([newest + 1.0])[0])]
            if plan.options.predict:
                after = [line.sample_times[n] + 1.0 for n in sampled]
                true += plan.motion.at([cause.time, *after]).tolist()
            return true + self._named(sampled)
        at = one.now if cause is None else cause.time
        if one.newest >= 0 and at - line.sample_times[one.newest] <= FRESH + late:
            return [line.positions[one.newest], *self._named([one.newest])]
        return [float(self._plan.motion.at([one.now])[0])]

    def _last_sync(self, time: float) -> int:
        """The slot of the last SYNC that the module received up to this time."""
        place = bisect_right(self._sync_times, time) - 1
        return self._sync_slots[place] if place >= 0 else -1

    def _slot_before(self, slot: int) -> int:
        """The slot of the previous SYNC within FRESH; it need not be the previous slot."""
        recent = range(slot - 1, max(slot - int(FRESH), 0) - 1, -1)
        return next((one for one in recent if self._plan.slots[one].produced), slot - 1)

    def _samples_of(self, first_slot: int, last_slot: int) -> range:
        slots = self._line.sample_slots
        return range(bisect_left(slots, first_slot), bisect_right(slots, last_slot))

    def _named(self, samples: Iterable[int]) -> list[float]:
        """Correct positions by rule J4."""
        line, tolerance = self._line, self._tolerance
        stamped, named = self._plan.setup.stamps, []
        for at, time, slot in ((line.named[n], line.sample_times[n], line.sample_slots[n]) for n in samples):
            place = time if stamped else slot + 1.0  # without receive times only the nominal time is known
            if at != time and min(abs(at - time), abs(at - place)) <= tolerance:
                named.append(at)
        return self._plan.motion.at(named).tolist() if named else []

    def _see_acceleration(self, one: Sent, status: int, rad_s2: float) -> None:
        if not status & VALID or one.newest < MEMORY or one.cause is None or one.cause.what != "pdo":
            return
        options = self._plan.options
        per_cycle = 2.0 * 3.141592653589793 / CYCLES_PER_REVOLUTION
        value = rad_s2 / per_cycle * options.interval_s**2
        at = self._line.sample_times[one.newest]
        x = self._plan.motion.at([at - n for n in range(MEMORY + 3)])
        true = [x[n] - 2.0 * x[n + 1] + x[n + 2] for n in range(MEMORY + 1)]
        if not min(true) - ACCELERATION_MARGIN <= value <= max(true) + ACCELERATION_MARGIN:
            self.verdict.acceleration_wrong += 1
