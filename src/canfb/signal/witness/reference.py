"""What witnesses do to the position (paper, section 4): withdraw its validity, or find its speed and count.

A pulse that contradicts a valid position may be false: the position is not valid until another pulse decides.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

from canfb.objects import LossCause
from canfb.signal import speeds
from canfb.signal.doubt import SAME_TIME
from canfb.signal.estimator import HALF_CYCLE, Estimator
from canfb.signal.sample import Feedback, Sample
from canfb.signal.supervision import COARSE, COASTING, LOST, VALID
from canfb.signal.tracker import Track
from canfb.signal.witness.witness import CoarseTrack, Pair, Witness
from canfb.signal.witness.zero_pulse import Pulse, PulseVerdict, ZeroPulse


class Reference:
    """Joins coarse track and zero pulse to an estimator; the second position brings its own
    :class:`Witness`.

    had_position  there was a valid position since the start, so a later count is not arbitrary
    range_known   the speed was found since the position was lost: the count may be set
    recovered     number of speeds that witnesses have found
    set_right     number of counts that a zero pulse has corrected
    in_doubt      zero pulses contradict the position, or each other: :meth:`apply` needs every sample
    """

    def __init__(self, estimator: Estimator, coarse: CoarseTrack, zero: ZeroPulse) -> None:
        self.estimator = estimator
        estimator.on_lost = self.position_lost
        estimator.on_speed = self.speed_known
        self.coarse, self.zero = coarse, zero
        self._witnesses: list[Witness] = [coarse]  # those that search for the speed
        self.recovered = self.set_right = 0
        self.restart()

    def restart(self, keep: bool = False) -> None:
        if not keep:
            self.zero.forget()
            self.had_position = self.in_doubt = False
        self.coarse.restart(keep)
        self.slipped()

    def position_lost(self) -> None:
        self.in_doubt = False
        self.zero.forget_doubts()
        self.slipped()

    def speed_known(self) -> None:
        self._speed_known = True
        self._first_pulse: Pulse | None = None  # the last one, and the searches, were at another speed
        for witness in self._witnesses:
            witness.restart_search()

    def join(self, second: Witness) -> None:
        self._witnesses = [self.coarse, second]

    def missed(self) -> None:
        self.slipped() if self.estimator.lost else self.coarse.restart_search()

    def slipped(self) -> None:
        self.range_known = self._range_from_zero = self._speed_known = False
        self.coarse.disagreeing = 0
        self._first_pulse = None
        self._shortest, self._longest = math.inf, 0.0  # sampling interval since then
        self._all_taken = True  # all samples between the last coarse track and this sample were used
        self.coarse.restart_search()

    def counted(self, elapsed: float) -> None:
        """A sample was taken this long after the one before."""
        self._shortest, self._longest = min(self._shortest, elapsed), max(self._longest, elapsed)

    def _is_certain(self, missing: int) -> bool:
        """True if the intervals were even enough for eq. 9 to lack the same cycles in each of them.

        An interval longer by d adds ``missing`` d to the second difference, which with acceleration and phase
        errors must stay below half a cycle.
        """
        declared = self.estimator.declared
        spare = max(0.0, HALF_CYCLE - declared.followed - 4.0 * declared.phase_error)
        return abs(missing) * max(0.0, self._longest - self._shortest) <= spare

    def passed(self, taken: bool) -> None:
        """Note a sample without a coarse track; ``taken``: it was used."""
        self._all_taken &= taken

    def apply(
        self, sample: Sample, track: Track, bits: int, pulse: Pulse | None, time: float, taken: bool
    ) -> tuple[int, int]:
        """Status bits and jump in cycles after this sample; the jump takes effect in the next position.

        ``track`` and ``bits`` are the results of the chain for ``sample`` at ``time``, intervals; ``taken``:
        it and the one before were used. ``pulse`` came since then, or shortly before.
        """
        taken, self._all_taken = taken and self._all_taken, True
        jump, pair, recovered = 0, None, self.recovered
        if sample.coarse_sine is not None and sample.coarse_cosine is not None:
            angle = self.coarse.angle(float(sample.coarse_sine), float(sample.coarse_cosine))
            pair = self.coarse.pair(angle, track.cycles, track.phase, time)
            bits, jump = self._hear_coarse(pair, bits, taken)
        if pulse is not None and jump == 0 and self.recovered == recovered:  # not of the speed before
            bits, jump = self._pulse(pulse, bits, pair)
        if self.in_doubt and bits & VALID:
            bits = bits & ~VALID | COASTING
        return bits, jump

    def _hear_coarse(self, pair: Pair | None, bits: int, taken: bool) -> tuple[int, int]:
        coarse, jump = self.coarse, 0
        if self.estimator.lost or not coarse.proven:
            if pair is None or not taken:
                coarse.restart_search()
            else:
                jump = self.find(coarse, pair)
            if not coarse.proven:  # the machine may turn by whole cycles per interval
                return bits & ~VALID, jump
        if self.estimator.lost:
            return lost_bits(bits), jump
        if not bits & VALID:
            return bits, jump
        if coarse.origin is None and not self.in_doubt:
            coarse.origin = pair
        if pair is not None and coarse.fits(pair):
            coarse.disagreeing = 0
            return bits, 0
        coarse.disagreeing += 1
        if not coarse.disagrees:
            return bits & ~VALID | COARSE | COASTING, 0
        self.estimator.lose(LossCause.REFERENCE)
        return lost_bits(bits) | COARSE, 0

    def find(self, witness: Witness, pair: Pair) -> int:
        """Correct speed and count by a witness; return the jump of the count at the next sample.

        The position is lost if the machine moved in a pause.
        """
        estimator = self.estimator
        if not (estimator.lost and self.range_known) or self._range_from_zero:
            missing = witness.missing_speed(pair)
            if missing is None:
                return 0
            witness.restart_search()
            if missing:
                if not self._is_certain(missing):
                    self.slipped()
                    return 0
                if self.had_position and not estimator.lost:
                    estimator.lose(LossCause.PAUSE)
                estimator.found(0, missing)
                self._first_pulse = None
            self.recovered += bool(missing or estimator.lost)
            witness.proven = self.range_known = True
            self._range_from_zero = False
            if missing or not estimator.lost:
                return 0
        if not self.had_position:  # the first position: any count will do
            witness.origin, witness.proven = pair, True
            estimator.confirm_count()
            return 0
        if witness.origin is None or not witness.firm:
            return 0
        shift, certain = witness.missing_count(pair)
        if shift:
            estimator.found(shift, 0)
        if certain:
            witness.restart_search()
            witness.proven = True
            estimator.confirm_count()
        return shift

    # Zero pulses.

    def pulse(self, after: Track | Feedback, place: float, time: float, elapsed: float) -> Pulse | None:
        """:func:`pulse_between` the last two samples, with the acceleration by the last three; None unless
        both were counted.

        If the machine creeps, samples further back show the direction.
        """
        # The first sample by the estimator: its count may have been corrected with the speed, just now.
        places, (before, _, apart) = self.estimator.places, self.estimator.tracker.places
        if apart - elapsed > SAME_TIME:
            return None
        pulse = pulse_between(before, after, place, time, elapsed, speeds.acceleration(places))
        if pulse.direction or self.estimator.lost:
            return pulse
        return pulse._replace(direction=_creeping(places))

    def _pulse(self, pulse: Pulse, bits: int, pair: Pair | None) -> tuple[int, int]:
        lost = self.estimator.lost
        if lost and not (self.range_known or self._speed_known):
            self._range_from_pulses(pulse)
            return bits, 0
        if not pulse.direction:
            return bits, 0
        if bits & VALID:
            return self._pulse_of_valid(pulse, bits, pair)
        # A pulse whose place was not known before cannot find a lost count.
        if not lost or not self.zero.knows(pulse) or (self.had_position and not self.zero.referenced):
            return bits, 0
        first, self._first_pulse = self._first_pulse, pulse
        is_alone = first is None or not self.zero.agree(first, pulse)
        if is_alone and (self.had_position or self._range_from_zero):
            return bits, 0
        jump = -self.zero.error_cycles(pulse)
        if self._refutes(pair, jump):
            return bits, 0
        if not self.zero.referenced:
            if self._range_from_zero:  # two earlier pulses were whole revolutions from this one
                self.zero.set_place(pulse)
            else:
                self.zero.weigh(pulse)
        self.set_right += jump != 0
        self.estimator.found(jump, 0)
        self.estimator.confirm_count()
        if pair is not None:
            self.coarse.origin = pair._replace(cycles=pair.cycles + jump)
        self.coarse.proven = True
        return bits, jump

    def _pulse_of_valid(self, pulse: Pulse, bits: int, pair: Pair | None) -> tuple[int, int]:
        error = self.zero.error_cycles(pulse)
        if self._refutes(pair, -error):
            return bits, 0
        verdict = self.zero.weigh(pulse)
        if verdict is not PulseVerdict.NOTHING:
            self.in_doubt = verdict is PulseVerdict.CONTRADICTS
        if verdict is PulseVerdict.WRONG:
            self.set_right += 1
            self.estimator.found(-error, 0)
            return bits & ~VALID | COASTING, -error
        if verdict is PulseVerdict.SLIPPED:  # from here on, counting is certain again
            self.position_lost()
            if pair is not None:
                self.coarse.origin = pair
            return lost_bits(bits), 0
        return bits, 0

    def _refutes(self, pair: Pair | None, jump: int) -> bool:
        if not jump or pair is None:
            return False
        away = self.coarse.away_cycles(pair._replace(cycles=pair.cycles + jump))
        return abs(away) > self.coarse.limit_cycles

    def _range_from_pulses(self, pulse: Pulse) -> None:
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
        if len(found) == 1 and self._is_certain(*found):
            self.estimator.found(0, found.pop())
            self.range_known = self._range_from_zero = True
            self.speed_known()


def lost_bits(bits: int) -> int:
    return bits & ~(VALID | COASTING) | LOST


def pulse_between(
    before: Track | Feedback,
    track: Track | Feedback,
    place: float,
    time: float,
    elapsed: float,
    acceleration: float,
) -> Pulse:
    """The zero pulse at the fraction ``place`` (0..1) of the time between two samples, the later at ``time``.

    ``acceleration`` in cycles per interval^2: over one interval, a straight line is off by up to 1/8 of it.
    """
    displacement = (track.cycles - before.cycles) + (track.phase - before.phase)
    bend = acceleration * elapsed * elapsed / 2.0
    position = before.phase + place * displacement - bend * place * (1.0 - place)
    turns = math.floor(position)
    turned_back = abs(displacement) <= abs(bend) + speeds.MOVED_CYCLES  # it may have, between the two
    direction = 0 if turned_back else (1 if displacement > 0.0 else -1)
    return Pulse(before.cycles + turns, position - turns, direction, time - (1.0 - place) * elapsed)


def _creeping(places: Sequence[speeds.Place]) -> int:
    moved = time = step = 0.0
    for later, before in itertools.pairwise(reversed(places)):
        moved += (later[0] - before[0]) + (later[1] - before[1])
        time += later[2]
        step = step or moved / time
        if abs(moved) > speeds.MOVED_CYCLES:
            return int(math.copysign(step * moved * time >= moved * moved / 2.0, moved))
    return 0
