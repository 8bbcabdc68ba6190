"""The usual sample of a chain in one piece: nearly each sample takes this way, and it costs half as much.

A usual sample comes one interval after the one before, brings two counts and no more, keeps all limits, and
nothing is in doubt before it or after it. For any other one the chain has its parts, which are called one
by one; tests/signal/test_usual_step.py compares both, bit for bit.
"""

from __future__ import annotations

import math
from collections import deque
from math import sqrt

from canfb.signal.correction import CorrectionTable, Lines
from canfb.signal.estimator import Estimator
from canfb.signal.feedback import Feedback
from canfb.signal.frozen import FrozenInput
from canfb.signal.recovery.second_listener import SecondListener
from canfb.signal.supervision import VALID, Supervision
from canfb.signal.tracker import Track, Tracker

_new = tuple.__new__  # makes a named tuple in half the time that its own constructor takes


class UsualStep(SecondListener):
    """What a usual sample reads and writes; the chain says when one may come (``_nothing_in_doubt``)."""

    _estimator: Estimator
    _supervision: Supervision
    _frozen: FrozenInput
    _base_status: int  # TABLE_ACTIVE or 0
    _referenced: int  # REFERENCED or 0
    _tracker: Tracker
    _places: deque[tuple[int, float, float]]  # of the estimator
    _coefficients: tuple[float, float, float, float, float]
    _bounds: tuple[float, float, float, float]
    _entries: int  # of the table; 0 for the identity
    _lines: Lines

    def __init__(self) -> None:
        self._nothing_in_doubt = False
        self._status = VALID  # of a usual sample
        self._stands = False  # the counts repeat, and the machine stands still
        self._samples = 0
        self._clock = 0.0  # sampling intervals since the start
        self._speed = 0.0
        self._sine = self._cosine = math.nan  # counts of the last sample
        self._last: Feedback | None = None
        self._before: Track | Feedback | None = None  # the last sample, if it was taken

    @property
    def begun(self) -> bool:
        """There was a sample since the start."""
        return self._tracker.started

    def repeats(self, sine: float, cosine: float) -> bool:
        """``sine`` and ``cosine`` are the counts of the last sample, before conditioning."""
        return sine == self._sine and cosine == self._cosine

    def _use_table(self, table: CorrectionTable | None) -> None:
        """Correct by this table from the next sample on."""
        self._nothing_in_doubt = False
        self._table = table
        self._entries, self._lines = (0, ()) if table is None else (len(table), table.lines())

    def _forget_sample(self) -> None:
        """The next sample is the first of its kind."""
        self._nothing_in_doubt = False
        self._last = self._before = None
        self._sine = self._cosine = math.nan
        self._speed = 0.0

    def _look_again(self, feedback: Feedback) -> None:
        """After ``feedback``: may the next sample be a usual one?"""
        estimator = self._estimator
        in_doubt = estimator.in_doubt or self._reference.in_doubt or self._second is not None
        self._stands = self._frozen.stands
        faulty = self._supervision.after_fault or (self._frozen.repeats and not self._stands)
        if feedback.status & VALID and not (in_doubt or faulty or estimator.searches):
            self._nothing_in_doubt = True
            self._places, self._bounds = self._estimator.places, self._supervision.bounds
            self._status = VALID | self._base_status | self._referenced

    def _count_repeats(self, repeated: bool) -> None:
        """The counts of a machine that stood still are the same again, or others."""
        if repeated:
            self._frozen.repeated(0.0)  # the speed counts at the first repeat only
        else:
            self._frozen.moved()
            self._stands = False

    def usual(self, sine: float, cosine: float, elapsed: float = 1.0) -> Feedback | None:
        """:meth:`SignalChain.step` for these counts if the sample is a usual one; else None, nothing changed.

        ``elapsed`` in intervals. The arithmetic is that of :func:`raw_phase` (Table 1) and
        :meth:`CorrectionTable.correct`.
        """
        repeated = sine == self._sine and cosine == self._cosine
        if not self._nothing_in_doubt or (repeated and not self._stands):
            return None
        offset_s, gain_s, offset_c, factor_c, skew = self._coefficients
        lowest, highest, smallest, largest = self._bounds
        s = (sine - offset_s) * gain_s
        c = (cosine - offset_c) * factor_c - s * skew
        amplitude = sqrt(s * s + c * c)
        if not (  # a chained comparison takes longer
            lowest < sine
            and sine < highest
            and lowest < cosine
            and cosine < highest
            and smallest <= amplitude
            and amplitude <= largest
        ):
            return None
        if c > 0.0 and -c <= s <= c:
            raw = 0.125 * (s / c)
            if raw < 0.0:
                raw += 1.0
            raw = raw + 0.0 if raw != 1.0 else 0.0
        elif c < 0.0 and c <= s <= -c:
            raw = 0.5 + 0.125 * (s / c)
        elif s > 0.0:
            raw = 0.25 - 0.125 * (c / s)
        elif s < 0.0:
            raw = 0.75 - 0.125 * (c / s)
        else:
            return None
        phase = raw
        if self._entries:
            place = raw * self._entries
            index = int(place)
            first, slope = self._lines[index]
            phase = first + (place - index) * slope
            if phase < 0.0:
                phase += 1.0
            if phase >= 1.0:
                phase -= 1.0
        tracker = self._tracker
        residual = tracker.advance(phase) if elapsed == 1.0 else self._estimator.advance_over(phase, elapsed)
        if residual < 0.0:
            return None
        if self._stands:
            self._count_repeats(repeated)
        cycles, speed = tracker.cycles, tracker.step_cycles
        self._places.append((cycles, phase, elapsed))
        self._sine, self._cosine = sine, cosine
        self._clock += elapsed
        self._samples = samples = self._samples + 1
        acceleration, self._speed = speed - self._speed, speed
        self._last = self._before = last = _new(
            Feedback,
            (
                s,
                c,
                amplitude,
                raw,
                cycles,
                phase,
                residual,
                self._status,
                speed,
                acceleration,
                0,
                samples,
            ),
        )
        return last
