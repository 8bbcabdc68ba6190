"""Comparison with another sensor of the machine; the rules are in docs/homing.md.

It is heard one SYNC later than the sample, when the interval is over and the value is certain. It does
three things. After a start, and while the position is lost, it determines the range of speed, as the coarse
track does. It sets a lost count right where just one count is within the tolerance. And it contradicts a
valid position, which is reported, but does not move it: it is not known which of the two is wrong.
"""

from __future__ import annotations

from collections import deque

from canfb.objects import LossCause
from canfb.signal.recovery.auxiliary_values import MOST_LATE, AuxiliaryValues, CountSearch, Standstill
from canfb.signal.recovery.reference import Reference
from canfb.signal.recovery.speed_search import PHASE_CYCLES, SpeedSearch
from canfb.signal.second_position import Pair, SecondScale, SecondSensor, only_count
from canfb.signal.supervision import COASTING, LOST, RESIDUAL, SECOND_POSITION, VALID
from canfb.signal.tracker import Track

DISAGREEING_VALUES = 3  # this many in a row are a disagreement: a single one may be a fault of the bus
HYSTERESIS = 0.75  # a disagreement ends below this part of the tolerance
PROVISIONAL = 2.0  # times the tolerance, for an offset that was learned in motion
START_SAMPLES = 4  # after a start a position without a value waits so long for one
LONGEST_GAP = 100  # intervals without a value: after that the sensor may count from elsewhere


class AuxiliaryEncoder:
    """Joins another sensor to the position of a chain.

    For each sample the chain calls :meth:`apply`, and whoever hears the sensor calls :meth:`hear` between
    that of one sample and that of the next.
    """

    def __init__(self, sensor: SecondSensor, reference: Reference, begun: bool = False) -> None:
        """``begun``: there is a position already, and it is believed."""
        self.sensor = sensor
        self._reference = reference
        self._scale = SecondScale(sensor, reference.coarse.cycles_per_revolution)
        one, tolerance = self._scale.increment_cycles, self._scale.tolerance_cycles
        self._firm_limit_cycles = tolerance + one
        self._provisional_limit_cycles = PROVISIONAL * tolerance + one
        self._values = AuxiliaryValues(self._scale)
        self._search = SpeedSearch(1.0, 2.0 * tolerance, one)  # the other sensor drives the machine
        self._first: Pair | None = None  # of the search
        self._standstill = Standstill(self._scale)
        self._count = CountSearch(self._scale)
        self._had_position = begun
        self.restart(known=begun)
        self._proven = begun

    def restart(self, keep: bool = False, known: bool = False) -> None:
        """After a start. ``keep``: the position goes on from before; ``known``: it was there, but is lost."""
        if not keep:
            self._origin: Pair | None = None  # where both stand for the same place
            self._firm = False  # that was learned at standstill, or with a reference
        self._had_position = known or (keep and self._had_position)
        self._paused = keep and self._had_position
        self._proven = False  # the speed is known to be right
        self._waited = self._samples_since_start = 0
        self._time = 0.0
        self.disagrees = False
        """The last values contradict the position."""
        self.difference_cycles: float | None = None
        """How much further the other sensor stands than the position; None while that is not known."""
        self._values.restart(keep)
        self.interrupt()

    def interrupt(self) -> None:
        """What was counted since the last sample is unknown."""
        self._place: tuple[Track, int, float] | None = None  # the last sample: place, status bits, time
        self._before: deque[Track] = deque(maxlen=MOST_LATE)  # places of the samples before it
        self._samples = 0  # since a value was heard
        self._passed, self._all_taken = 0.0, True  # of the earlier samples of the same SYNC
        self._heard: int | None = None
        self._disagreeing = 0
        self._restart_search()

    @property
    def is_waiting(self) -> bool:
        """Since the start there were too few samples yet to know whether the machine turns."""
        return not self._proven and self._samples_since_start <= 2 * START_SAMPLES

    def _restart_search(self) -> None:
        self._search.restart()
        self._first = None
        self._standstill.restart()
        self._count.restart()

    def hear(self, values: int, increments: int) -> None:
        """An interval is over in which so many ``values`` came, the last one ``increments``.

        With just one it belongs to the last sample. ``values`` -1: it is not certain which ones they were.
        """
        heard = self._values.take(values, increments)
        if self._values.missing > LONGEST_GAP:
            self._forget_origin()
        if self._values.is_ambiguous:
            self._forget_origin()
            self._restart_search()
        self._heard = heard if self._samples == 1 else None
        self._samples = 0

    def _forget_origin(self) -> None:
        self._origin = self.difference_cycles = None
        self._firm = self.disagrees = False
        self._disagreeing = 0

    def apply(
        self,
        track: Track,
        bits: int,
        jump: int,
        elapsed: float,
        taken: bool,
        alone: bool,
        newest: bool = True,
    ) -> tuple[int, int]:
        """Status bits and jump in cycles after a sample, ``elapsed`` intervals after the one before.

        ``track``, ``bits`` and ``jump`` are what the chain and its references made of it; ``taken``: it was
        there and good. ``alone``: no coarse track determines the speed. ``newest``: of the samples of a SYNC.
        """
        if not newest:
            return self._pass_over(bits, jump, elapsed, taken)
        elapsed += self._passed
        taken = taken and self._all_taken
        self._passed, self._all_taken = 0.0, True
        lost = self._reference.recovery.lost
        was_lost = self._place is not None and bool(self._place[1] & LOST)
        taken = taken and not bits & (RESIDUAL | COASTING)
        if not taken or lost != was_lost:
            self._restart_search()
        self._samples += 1
        if not bits & COASTING:  # sample times have yet to confirm the start: no value can before
            self._samples_since_start += 1
        heard, self._heard = self._heard, None
        if heard is not None and self._place is not None:
            place, place_bits, time = self._place
            pair = Pair(place.cycles, place.phase, heard, time)
            if lost:
                if alone and jump == 0 and taken and was_lost:
                    jump = self._recover(pair)
            elif place_bits & VALID or not self._proven:
                self._judge(pair, taken and not self._reference.in_doubt, alone)
        elif not lost:
            self._wait()
        self._time += elapsed
        if self._place is not None:
            self._before.append(self._place[0])
        self._place = track, bits, self._time
        if jump:
            self._shift(jump)
        if bits & VALID and self._had_position and self._proven and not self.disagrees:
            return bits, jump  # nearly always
        return self._bits(bits), jump

    def _pass_over(self, bits: int, jump: int, elapsed: float, taken: bool) -> tuple[int, int]:
        """A sample that is not the newest of its SYNC: no value belongs to it."""
        self._passed += elapsed
        self._all_taken &= taken and not bits & (RESIDUAL | COASTING)
        if jump:
            self._shift(jump)
        return self._bits(bits), jump

    def _shift(self, jump: int) -> None:
        """The count was corrected: the places of earlier samples go along."""
        self._before = deque((_shifted(one, jump) for one in self._before), maxlen=MOST_LATE)
        if self._place is not None:
            track, bits, time = self._place
            self._place = _shifted(track, jump), bits, time

    def _wait(self) -> None:
        """A sample without a value that says something."""
        if not self._proven:
            self._waited += 1
            self._proven = self._waited > START_SAMPLES

    def missed(self, bits: int) -> int:
        """Status bits of a sampling interval without a sample."""
        self._passed, self._all_taken = 0.0, True
        self._place = self._heard = None
        self._samples = 0
        self._before.clear()
        self._restart_search()
        return self._bits(bits)

    def _bits(self, bits: int) -> int:
        if bits & LOST:
            if self.disagrees:
                self._forget_origin()  # it may be wrong itself, and does not set a count right
            self._disagreeing = 0
            return bits
        if not self._proven:
            return bits & ~VALID
        self._had_position |= bool(bits & VALID)
        if not self.disagrees:
            return bits
        if self.sensor.invalidates and bits & VALID:
            bits = bits & ~VALID | COASTING
        return bits | SECOND_POSITION

    # A position that is not lost.

    def _judge(self, pair: Pair, taken: bool, alone: bool) -> None:
        if not self._proven:
            if not taken or not alone:
                self._proven = not alone  # the coarse track proves it
                return
            self._prove(pair)
        elif self._values.is_stale(pair, moving=True):
            self._standstill.restart()
        else:
            self._compare(pair)

    def _prove(self, pair: Pair) -> None:
        """After a start a turning machine looks like one at rest, until this sensor has confirmed it."""
        if self._values.is_stale(pair, moving=False):
            self._wait()
            return
        self._waited = 0
        missing = self._missing(pair)
        if missing is None:
            return
        recovery, reference = self._reference.recovery, self._reference
        self._restart_search()
        if missing:
            if self._paused:
                recovery.lose(LossCause.PAUSE)  # it did not stand still in the pause
            recovery.found(0, missing)
            reference.recovered += 1
        self._proven = not recovery.lost

    def _missing(self, pair: Pair) -> int | None:
        """What the counted speed lacks, cycles per interval; None as long as that is not certain."""
        if self._first is None:
            self._first = pair
        first, scale = self._first, self._scale
        moved, ahead = scale.moved_cycles(first, pair), scale.difference_cycles(first, pair)
        return self._search.feed(pair.time, ahead, moved)

    def _compare(self, pair: Pair) -> None:
        if self._origin is None:
            self._origin = pair
        if not self._firm:
            self._learn(pair)
        self.difference_cycles = self._scale.difference_cycles(self._origin, pair)
        limit = self._limit_cycles * (HYSTERESIS if self.disagrees else 1.0)
        fits_earlier = self._values.late > 0 and self._fits_earlier(pair, limit)
        if abs(self.difference_cycles) <= limit:
            self.disagrees, self._disagreeing = False, 0
            self._values.fits(fits_earlier)
        elif not fits_earlier:
            self._disagreeing += 1
            self.disagrees |= self._disagreeing >= DISAGREEING_VALUES

    @property
    def _limit_cycles(self) -> float:
        return self._firm_limit_cycles if self._firm else self._provisional_limit_cycles

    def _fits_earlier(self, pair: Pair, limit: float) -> bool:
        """Values are missing since they were last on time: this one may belong to an earlier sample."""
        places = list(self._before)[-self._values.late :]
        return self._origin is not None and any(
            abs(self._scale.difference_cycles(self._origin, Pair(cycles, phase, *pair[2:]))) <= limit
            for cycles, phase, _, _ in places
        )

    def _learn(self, pair: Pair) -> None:
        """The offset is that at the first standstill, or where the zero pulse is known."""
        if not self.disagrees and (self._standstill.feed(pair) or self._reference.zero.referenced):
            self._origin, self._firm = pair, True

    # A position that is lost.

    def _recover(self, pair: Pair) -> int:
        """The jump of the count, with the next sample."""
        reference, recovery = self._reference, self._reference.recovery
        if self._values.is_stale(pair, moving=False):
            return 0
        if not reference.range_known:
            missing = self._missing(pair)
            if missing is None:
                return 0
            self._restart_search()
            if missing:
                recovery.found(0, missing)
            reference.range_known = True
            reference.recovered += 1
            if missing:
                return 0
        if self._origin is None or not self._firm:
            if not self._had_position:  # there was no position yet that could be lost
                recovery.confirm_count()
                self._proven, self._origin = True, pair
            return 0
        return self._set_count(pair, self._origin)

    def _set_count(self, pair: Pair, origin: Pair) -> int:
        difference = self._scale.difference_cycles(origin, pair)
        recovery = self._reference.recovery
        if only_count(difference, self._limit_cycles + PHASE_CYCLES) is None:
            self._count.restart()
            jump = 0 if abs(difference) <= self._limit_cycles else round(difference)
            if jump:  # near it, but which of several counts is not known
                recovery.found(jump, 0)
            return jump
        shift_cycles = self._count.feed(difference, self._limit_cycles + PHASE_CYCLES)
        if shift_cycles is None:
            return 0
        self._restart_search()
        if shift_cycles:
            recovery.found(shift_cycles, 0)
        recovery.confirm_count()
        self._proven = True
        return shift_cycles


def _shifted(track: Track, cycles: int) -> Track:
    return track._replace(cycles=track.cycles + cycles)
