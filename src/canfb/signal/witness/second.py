"""Another sensor of the machine as a witness (docs/homing.md). A value may come late, twice, not at all, or
repeat the last one: it is compared one SYNC after its sample, when it is certain.
"""

from __future__ import annotations

from collections import deque

from canfb.signal.second_position import RANGE, SecondSensor, step_increments
from canfb.signal.supervision import COASTING, LOST, RESIDUAL, SECOND_POSITION, VALID
from canfb.signal.tracker import Track
from canfb.signal.witness.reference import Reference, lost_bits
from canfb.signal.witness.witness import PHASE_CYCLES, Pair, SecondScale, Witness, counts_within

MOST_LATE = 3  # intervals by which a value may be late and is still recognised as late
ON_TIME_VALUES = 100  # values in a row that fit their own sample: they are not late
SUDDEN_CYCLES = 0.5  # a value that moved further in one interval, and then repeats, is frozen
STILL_CYCLES = 0.25
STILL_PAIRS = 8


class SecondValues:
    """Unwraps the values of the other sensor, and finds which of them can be used.

    missing       intervals in a row without a certain value
    late          number of missing values: those that come may be late by as many intervals
    most_late     the same, reset only by a value that fits no earlier sample: a doubled value may be late
    is_ambiguous  the sensor may have turned by more than half of its range: its position is not known
    """

    def __init__(self, scale: SecondScale) -> None:
        self._scale = scale
        self.restart()

    def restart(self, keep: bool = False) -> None:
        if not keep:
            self._increments: int | None = None  # unwrapped
        self.missing = self.late = self.most_late = 0
        self._begun = False
        self._on_time = 0  # values in a row that fitted their own sample
        self._step = 0  # change of the value per interval, the last one that was not 0
        self._is_frozen = False
        self._since: Pair | None = None  # the first pair with the present value

    def restart_standstill(self) -> None:
        self._still: Pair | None = None
        self._still_pairs = 0

    def take(self, values: int, increments: int, samples: int) -> int | None:
        """The unwrapped value of an interval; ``values``, ``samples``: their numbers. None: not certain."""
        self.is_ambiguous = False
        if self._begun:
            lacking = max(samples, 1) - max(values, 0)
            self.late = max(0, min(MOST_LATE, self.late + lacking))
            self.most_late = min(MOST_LATE, self.most_late + max(lacking, 0))
        if values != 1:
            self._on_time = 0
            self.missing += 1
            return None
        before = increments if self._increments is None else self._increments
        step = step_increments(before, increments)
        intervals, self.missing = self.missing + 1, 0
        begun, self._begun = self._begun, True
        self.is_ambiguous = max(abs(step), abs(self._step) * intervals) > RANGE // 4
        self._increments = before + step
        if step:
            self._step = step // intervals if begun else 0
            self._is_frozen, self._since = False, None
        else:
            self._is_frozen |= self.turns
        return self._increments

    @property
    def turns(self) -> bool:
        """True if the last step shows that the machine moves."""
        increment = self._scale.step_cycles
        return abs(self._step) * increment > max(SUDDEN_CYCLES, 2.0 * increment)

    def fits(self, fits_earlier: bool) -> None:
        """Note that the last value fits its sample; ``fits_earlier``: an earlier one, too, if it is late."""
        self._on_time += 1
        if not fits_earlier:
            self.most_late = 0
        self.late = 0 if self._on_time >= ON_TIME_VALUES else min(self.late, self.most_late)

    def is_stale(self, pair: Pair, moving: bool) -> bool:
        """True if the value repeats although the machine has moved.

        ``moving``: the position of the pair is right; else only its phase is.
        """
        self._since = since = self._since or pair
        moved = (pair.cycles - since.cycles) + (pair.phase - since.phase)
        if not moving:
            moved -= round(moved)
        allowed = self._scale.step_cycles + STILL_CYCLES + (0.0 if moving else PHASE_CYCLES)
        stale = abs(moved) > allowed
        self._is_frozen |= stale  # until the value changes: phases repeat with each cycle
        return stale or (self._is_frozen and not moving)

    def stands_still(self, pair: Pair) -> bool:
        """True if neither sensor has moved for :data:`STILL_PAIRS` pairs up to this one."""
        first, scale = self._still, self._scale
        if first is not None:
            moved = (pair.cycles - first.cycles) + (pair.phase - first.phase)
            other = abs(scale.moved_cycles(first, pair))
            if abs(moved) <= STILL_CYCLES and other <= max(STILL_CYCLES, 2.0 * scale.step_cycles):
                self._still_pairs += 1
                return self._still_pairs >= STILL_PAIRS
        self._still, self._still_pairs = pair, 1
        return False


START_SAMPLES = 4  # samples after a start for which a position waits for the first value
LONGEST_GAP = 100  # intervals without a value; after that the sensor may have another origin


class SecondPosition:
    """Compares another sensor with the position of a chain.

    The chain calls :meth:`apply` for each sample, and the receiver of the sensor calls :meth:`hear` between
    two of these calls.
    """

    def __init__(self, sensor: SecondSensor, reference: Reference) -> None:
        self.sensor = sensor
        self._reference = reference
        scale = SecondScale(sensor, reference.zero.cycles_per_revolution)
        self.witness, self._values = Witness(scale), SecondValues(scale)
        reference.join(self.witness)
        self.restart()
        self.witness.proven = reference.had_position  # a position before the sensor is trusted

    def restart(self, keep: bool = False) -> None:
        self.witness.restart(keep)
        self._values.restart(keep)
        self._waited = self._samples_since_start = 0
        self.difference_cycles: float | None = None
        """Other sensor minus position; None while that is not known."""
        self._forget_sample()

    def _forget_sample(self) -> None:
        self._place: tuple[Track, int, float] | None = None  # the last sample: place, status bits, time
        self._before: deque[Track] = deque(maxlen=MOST_LATE)  # places of the samples before it
        self._samples = 0  # samples since :meth:`hear`
        self._all_taken = True  # the earlier samples of the same SYNC were used
        self._heard: int | None = None
        self._restart_search()

    @property
    def is_waiting(self) -> bool:
        """True while there are too few samples since the start to know whether the machine turns."""
        return not self.witness.proven and self._samples_since_start <= 2 * START_SAMPLES

    def _restart_search(self) -> None:
        self.witness.restart_search()
        self._values.restart_standstill()

    def hear(self, values: int, increments: int) -> None:
        """As :meth:`canfb.signal.chain.SignalChain.hear_second`."""
        heard = self._values.take(values, increments, self._samples)
        if self._values.missing > LONGEST_GAP or self._values.is_ambiguous:
            self._forget_origin()
            self._restart_search()
        self._heard = heard if self._samples == 1 else None
        self._samples = 0

    def _forget_origin(self) -> None:
        self.witness.forget()
        self.difference_cycles = None

    def apply(
        self,
        track: Track,
        bits: int,
        jump: int,
        time: float,
        taken: bool,
        alone: bool,
        newest: bool = True,
    ) -> tuple[int, int]:
        """Status bits and jump in cycles after a sample at ``time``, intervals.

        ``taken``: the sample was used. ``alone``: no coarse track determines the speed. ``newest``: of the
        samples of a SYNC.
        """
        taken = taken and self._all_taken and not bits & (RESIDUAL | COASTING)
        if not newest:  # it has no value
            self._all_taken = taken
            self._shift(jump)
            return self._bits(bits), jump
        self._all_taken = True
        lost = self._reference.estimator.lost
        was_lost = self._place is not None and bool(self._place[1] & LOST)
        if not taken or lost != was_lost:
            self._restart_search()
        self._samples += 1
        if not bits & COASTING:  # while sample times have to confirm the start, a value cannot
            self._samples_since_start += 1
        heard, self._heard = self._heard, None
        if heard is not None and self._place is not None:
            place, place_bits, place_time = self._place
            pair = Pair(place.cycles, place.phase, heard, place_time)
            if lost:
                if (
                    alone
                    and jump == 0
                    and taken
                    and was_lost
                    and not self._values.is_stale(pair, moving=False)
                    and not (self._reference.range_known and self._is_open(pair))
                ):
                    jump = self._reference.find(self.witness, pair)
            elif place_bits & VALID or not self.witness.proven:
                self._judge(pair, taken and not self._reference.in_doubt, alone)
        elif not lost:
            self._wait()
        if self._place is not None:
            self._before.append(self._place[0])
        self._place = track, bits, time
        self._shift(jump)
        return self._bits(bits), jump

    def _shift(self, jump: int) -> None:
        if jump:
            self._before = deque((_shifted(one, jump) for one in self._before), maxlen=MOST_LATE)
            if self._place is not None:
                track, bits, time = self._place
                self._place = _shifted(track, jump), bits, time

    def _wait(self) -> None:
        if not (self.witness.proven or self._values.turns):
            self._waited += 1
            self.witness.proven = self._waited > START_SAMPLES

    def missed(self, bits: int) -> int:
        self._forget_sample()
        return self._bits(bits)

    def _bits(self, bits: int) -> int:
        witness = self.witness
        if bits & LOST or self._reference.estimator.lost:
            if witness.disagrees:
                self._forget_origin()  # the sensor may be wrong itself, so it must not correct a count
            witness.disagreeing = 0
            return bits if bits & LOST else lost_bits(bits)
        if not witness.proven:
            return bits & ~VALID
        if not witness.disagrees:
            return bits
        if self.sensor.invalidates and bits & VALID:
            bits = bits & ~VALID | COASTING
        return bits | SECOND_POSITION

    def _judge(self, pair: Pair, taken: bool, alone: bool) -> None:
        witness, values = self.witness, self._values
        if witness.proven:
            if values.is_stale(pair, moving=True):
                values.restart_standstill()
            else:
                self._compare(pair)
        elif not taken or not alone:
            witness.proven = not alone  # proven by the coarse track, if there is one
        elif values.is_stale(pair, moving=False):
            self._wait()
        else:
            self._waited = 0
            self._reference.find(witness, pair)

    def _compare(self, pair: Pair) -> None:
        witness, values = self.witness, self._values
        witness.origin = witness.origin or pair
        # The offset is final at the first standstill, or once the zero pulse is known.
        may_learn = not (witness.firm or witness.disagrees)
        if may_learn and (values.stands_still(pair) or self._reference.zero.referenced):
            witness.origin, witness.firm = pair, True
        self.difference_cycles = witness.away_cycles(pair)
        if witness.fits(pair):
            earlier = self._earlier(pair, values.most_late)
            values.fits(len(earlier) < values.most_late or any(map(witness.fits, earlier)))
            witness.disagreeing = 0
        elif not any(map(witness.fits, self._earlier(pair, values.late))):
            witness.disagreeing += 1

    def _earlier(self, pair: Pair, late: int) -> list[Pair]:
        """The pairs of a value with the last ``late`` samples before its own, from which it may be."""
        return [pair._replace(cycles=one.cycles, phase=one.phase) for one in [*reversed(self._before)][:late]]

    def _is_open(self, pair: Pair) -> bool:
        """True if the count depends on whether the value is late."""
        limit = self.witness.limit_cycles + PHASE_CYCLES
        away = map(self.witness.away_cycles, (pair, *self._earlier(pair, self._values.most_late)))
        here, *earlier = (counts_within(one, limit) for one in away)
        return len(here) == 1 and any(counts and counts != here for counts in earlier)


def _shifted(track: Track, cycles: int) -> Track:
    return track._replace(cycles=track.cycles + cycles)
