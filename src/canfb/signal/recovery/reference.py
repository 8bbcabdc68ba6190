"""What the coarse track and the zero pulse say of the position (paper, section 4).

Eq. 9 started on a turning machine, or after a fault, counts with a speed that lacks whole
cycles per interval. The coarse track, or two zero pulses, determine how many; the next zero pulse
sets the cycle count right. Every jump of the position is reported.

A pulse that contradicts a valid position may be false. The position is not valid then until
another pulse settles it: by agreeing with the position, or with the first one.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

from canfb.objects import LossCause
from canfb.signal import speeds
from canfb.signal.estimator import Estimator
from canfb.signal.feedback import Feedback
from canfb.signal.recovery.coarse import CoarseTrack
from canfb.signal.recovery.zero_pulse import Edge, PulseVerdict, ZeroPulse
from canfb.signal.sample import Sample
from canfb.signal.supervision import COARSE, COASTING, LOST, VALID
from canfb.signal.tracker import Track

DISAGREEING_SAMPLES = 3  # this many in a row, and the position is lost
EXACT_CYCLES = 0.5  # a coarse track better than that needs no zero pulse
MOVED_CYCLES = 0.05  # what the errors of two phases do not show: twice the largest one, and once more as much


class Pulse(NamedTuple):
    """A zero pulse: time in sampling intervals since the start, and the position at which it came.

    ``direction`` of the machine there: 1, -1, or 0: not known.
    """

    time: float
    cycles: int
    phase: float
    direction: int = 1


class Reference:
    """Joins coarse track and zero pulse to a :class:`Estimator`."""

    def __init__(self, recovery: Estimator, coarse: CoarseTrack, zero: ZeroPulse) -> None:
        self._estimator = recovery
        recovery.on_lost = self.position_lost
        recovery.on_speed = self.speed_known
        self._passed = 0.0  # since the last coarse track, before this sample; below 0: not all were taken
        self.coarse = coarse
        self.zero = zero
        self.recovered = 0
        """Number of speeds recovered by the coarse track."""
        self.set_right = 0
        """How often a zero pulse found the count wrong and set it right."""
        self.had_position = False
        """There was a valid position since the start: its count is not that of the next one found."""
        self.restart()

    @property
    def recovery(self) -> Estimator:
        """What they are joined to."""
        return self._estimator

    @property
    def range_known(self) -> bool:
        """Since the position was lost, its speed was found to be right: a zero pulse may set the count."""
        return self._range_known

    @range_known.setter
    def range_known(self, known: bool) -> None:
        self._range_known = known

    def restart(self, keep: bool = False) -> None:
        """After a start: the machine may be turning. ``keep``: the position goes on from before."""
        if not keep:
            self.coarse.forget()
            self.zero.forget()
            self.had_position = self.in_doubt = False
            """Zero pulses contradict the position, or each other: :meth:`apply` is to see every sample."""
        self._proven = False  # the coarse track has confirmed the range of speed since the start
        self._range_known = False  # ... since the position was lost
        self._begin_search()

    def passed(self, elapsed: float, taken: bool) -> None:
        """A sample without a coarse track of its own, ``elapsed`` after the one before."""
        self._passed = self._passed + elapsed if taken and self._passed >= 0.0 else -1.0

    def apply(
        self, sample: Sample, track: Track, bits: int, pulse: Pulse | None, elapsed: float
    ) -> tuple[int, int]:
        """Status bits and jump in cycles after this sample; the jump shows in the next position.

        ``track`` and ``bits`` are what the chain made of ``sample``, ``elapsed`` intervals after the one
        before; 0.0 if either of the two was not taken. ``pulse`` came since then, or shortly before.
        """
        elapsed = elapsed + self._passed if elapsed and self._passed >= 0.0 else 0.0
        self._passed = 0.0
        was_lost = self._estimator.lost
        jump = 0
        angle: float | None = None
        if sample.coarse_sine is not None and sample.coarse_cosine is not None:
            angle = self.coarse.angle(sample.coarse_sine, sample.coarse_cosine)
            bits, jump = self._compare(angle, track, bits, elapsed)
        if pulse is not None and jump == 0:
            bits, jump = self._pulse(pulse, track, bits, angle)
        if self._estimator.lost and not was_lost:
            self.position_lost()
        if self.in_doubt and bits & VALID:
            bits = bits & ~VALID | COASTING
        return bits, jump

    def pulse(
        self, before: Track | Feedback, after: Track | Feedback, place: float, time: float, elapsed: float
    ) -> Pulse:
        """:func:`pulse_between` the last two samples, with the acceleration by the last three.

        Of a machine that creeps, samples further back show the direction.
        """
        places = self._estimator.places
        pulse = pulse_between(before, after, place, time, elapsed, speeds.acceleration(places))
        if pulse.direction or self._estimator.lost:
            return pulse
        return pulse._replace(direction=_creeping(places))

    def position_lost(self) -> None:
        """The position has been lost: what pulses said of its count does not matter any more."""
        self.in_doubt = False
        self.zero.forget_doubts()
        self._begin_search()

    def speed_known(self) -> None:
        """A lost position is counted at the speed of the machine: a zero pulse may set the count."""
        self._speed_known = True

    def missed(self) -> None:
        """A sample did not come."""
        self.slipped() if self._estimator.lost else self.coarse.restart_search()

    def slipped(self) -> None:
        """A sample of a lost position was not taken, or over the limit: its speed is not known any more."""
        self._begin_search()

    def _begin_search(self) -> None:
        self._range_known = self._range_from_zero = self._speed_known = False
        self._disagreeing = 0
        self._first_pulse: Pulse | None = None
        self._passed = 0.0
        self.coarse.restart_search()

    def _compare(self, angle: float | None, track: Track, bits: int, elapsed: float) -> tuple[int, int]:
        lost = self._estimator.lost
        if self._proven and not lost:
            return self._check(angle, track, bits), 0
        jump = 0
        if elapsed == 0.0:  # this sample was not taken
            self.coarse.restart_search()
        elif not (lost and self._range_known):
            missing = self.coarse.search(angle, track.cycles, track.phase, elapsed)
            if missing is not None and angle is not None:
                if (
                    not lost
                    and self.coarse.aligned
                    and self.coarse.disagrees(angle, track.cycles, track.phase)
                ):
                    return self._contradicted(bits), 0  # it did not stand still in the pause
                jump = self._range_found(missing, angle, track)
        # Before the coarse track has confirmed the speed, a turning machine looks like one at rest.
        return (bits if self._proven else bits & ~VALID), jump

    def _range_found(self, missing: int, angle: float, track: Track) -> int:
        coarse = self.coarse
        jump = coarse.nearest_cycles(angle, track.cycles, track.phase) - track.cycles if coarse.aligned else 0
        if missing or (jump and self._estimator.lost):
            self._estimator.found(jump if self._estimator.lost else 0, missing)
        if missing or self._estimator.lost:
            self.recovered += 1
        self._range_known = self._proven = True
        if not self._estimator.lost:
            coarse.align(angle, track.cycles, track.phase)
            return 0
        exact = coarse.limit_revolutions * coarse.cycles_per_revolution < EXACT_CYCLES
        # A count that was lost is not known again where the coarse track was never aligned with it.
        known = coarse.aligned or self.zero.referenced
        if (exact and known) or not (known or self.had_position):
            self._estimator.confirm_count()  # or there was no position yet that could be lost
        return jump

    def _check(self, angle: float | None, track: Track, bits: int) -> int:
        if not bits & VALID:
            return bits
        if angle is not None and not self.coarse.aligned and not self.in_doubt:
            self.coarse.align(angle, track.cycles, track.phase)
        if not self.coarse.disagrees(angle, track.cycles, track.phase):
            self._disagreeing = 0
            return bits
        self._disagreeing += 1
        if self._disagreeing >= DISAGREEING_SAMPLES:
            return self._contradicted(bits)
        return bits & ~VALID | COARSE | COASTING

    def _contradicted(self, bits: int) -> int:
        self._disagreeing = 0
        self._estimator.lose(LossCause.REFERENCE)
        return bits & ~(VALID | COASTING) | COARSE | LOST

    def _pulse(self, pulse: Pulse, track: Track, bits: int, angle: float | None) -> tuple[int, int]:
        lost = self._estimator.lost
        if lost and not (self._range_known or self._speed_known):
            self._range_from_pulses(pulse)
            return bits, 0
        if not pulse.direction:
            return bits, 0
        edge = Edge(pulse.cycles, pulse.phase, pulse.direction > 0)
        if bits & VALID:
            return self._pulse_of_valid(edge, track, bits, angle)
        if not lost or not self.zero.knows(edge):
            return bits, 0
        jump = -self.zero.error_cycles(edge)
        if self._refutes(angle, track, jump):
            return bits, 0
        if not self.zero.referenced:
            if self._range_from_zero:  # two pulses before were whole revolutions from this one
                self.zero.set_place(edge)
            else:
                self.zero.weigh(edge)
        self.set_right += jump != 0
        self._estimator.found(jump, 0)
        self._estimator.confirm_count()
        if angle is not None:
            self.coarse.align(angle, track.cycles + jump, track.phase)
        self._proven = True
        return bits, jump

    def _pulse_of_valid(self, edge: Edge, track: Track, bits: int, angle: float | None) -> tuple[int, int]:
        error = self.zero.error_cycles(edge)
        if self._refutes(angle, track, -error):
            return bits, 0
        verdict = self.zero.weigh(edge)
        if verdict is not PulseVerdict.NOTHING:
            self.in_doubt = verdict is PulseVerdict.CONTRADICTS
        if verdict is PulseVerdict.WRONG:
            self.set_right += 1
            self._estimator.found(-error, 0)
            return bits & ~VALID | COASTING, -error
        if verdict is PulseVerdict.SLIPPED:  # what is counted from here is certain again
            self._estimator.on_lost()
            if angle is not None:
                self.coarse.align(angle, track.cycles, track.phase)
            return bits & ~VALID | LOST, 0
        return bits, 0

    def _refutes(self, angle: float | None, track: Track, jump: int) -> bool:
        """True if the coarse track shows that the pulse that asks for this jump is false."""
        if not jump or angle is None or not self.coarse.aligned:
            return False
        cycles = track.cycles + jump
        away = self.coarse.nearest_cycles(angle, cycles, track.phase) - cycles
        return abs(away) > self.coarse.limit_revolutions * self.coarse.cycles_per_revolution

    def _range_from_pulses(self, pulse: Pulse) -> None:
        """Two pulses are -1, 0 or 1 revolution apart; what the count lacks to that is the missing speed."""
        first, self._first_pulse = self._first_pulse, pulse
        if first is None or pulse.time - first.time < 1.0:
            return
        intervals = pulse.time - first.time
        counted = (pulse.cycles - first.cycles) + (pulse.phase - first.phase)
        found = set()
        for turns in (-1, 0, 1):
            missing = (turns * self.zero.cycles_per_revolution - counted) / intervals
            if abs(missing - round(missing)) * intervals < 1.0:
                found.add(round(missing))
        if len(found) == 1:
            self._estimator.found(0, found.pop())
            self._range_known = self._range_from_zero = True


def pulse_between(
    before: Track | Feedback,
    track: Track | Feedback,
    place: float,
    time: float,
    elapsed: float,
    acceleration: float,
) -> Pulse:
    """The zero pulse at the fraction ``place`` (0..1) of the time between two samples, the later at ``time``.

    ``acceleration`` in cycles per interval^2: a straight line would be up to 1/8 of it off, in one interval.
    """
    way = (track.cycles - before.cycles) + (track.phase - before.phase)
    bend = acceleration * elapsed * elapsed / 2.0
    position = before.phase + place * way - bend * place * (1.0 - place)
    turns = math.floor(position)
    turned_back = abs(way) <= abs(bend) + MOVED_CYCLES  # between the two, perhaps
    direction = 0 if turned_back else (1 if way > 0.0 else -1)
    return Pulse(time - (1.0 - place) * elapsed, before.cycles + turns, position - turns, direction)


def _creeping(places: Sequence[speeds.Place]) -> int:
    """The direction of a machine that takes several samples for :data:`MOVED_CYCLES`; 0: it may turn back."""
    moved = time = step = 0.0
    for later, before in itertools.pairwise(reversed(places)):
        moved += (later[0] - before[0]) + (later[1] - before[1])
        time += later[2]
        step = step or moved / time
        if abs(moved) > MOVED_CYCLES:
            return int(math.copysign(step * moved * time >= moved * moved / 2.0, moved))
    return 0
