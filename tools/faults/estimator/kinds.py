"""The kinds of fault: what happens to each sample of an episode from its fault on.

A sample is good, missing (no sample came in its interval), flagged (the interface says that it is bad) or bad
without a sign of it: of the right amplitude, with any phase. A kind may also change the instants.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from tools.faults.estimator.declared import Declared
from tools.faults.estimator.machine import Rng

States = npt.NDArray[np.int8]


class State(IntEnum):
    """Of one sample."""

    GOOD = 0
    MISSING = 1
    FLAGGED = 2
    BAD = 3
    SWAPPED = 4
    FROZEN = 5


@dataclass(frozen=True)
class Kind:
    """A kind of fault.

    draw        the states of the samples of one episode, from the one where the fault begins: (rng, samples)
    bad         the most neighbouring samples that are bad without a sign of it; None: more than one row of
                them in one doubt, or more than can be declared
    lasting     the fault stays to the end: only positions that are valid and wrong count
    jitter      of all instants, intervals, uniform
    stall       a pause of so many intervals before the first sample of the fault: shortest and longest
    """

    name: str
    draw: Callable[[Rng, int], States]
    bad: int | None = 0
    lasting: bool = False
    jitter: float = 0.0
    stall: tuple[float, float] | None = None

    def is_covered(self, declared: Declared) -> bool:
        """What is declared holds during this fault, so that no position may be valid and wrong."""
        return self.bad is not None and self.bad <= declared.bad


def _row(samples: int, *parts: tuple[State, int]) -> States:
    """Samples of these states, one after the other, then good ones."""
    states = np.zeros(samples, np.int8)
    at = 0
    for state, length in parts:
        states[at : at + length] = state
        at += length
    return states


def _of(state: State, *lengths: int) -> Callable[[Rng, int], States]:
    return lambda rng, samples: _row(samples, (state, int(rng.choice(lengths))))


def _gaps(rng: Rng, samples: int) -> States:
    """Two or three gaps of one or two samples, one to three good ones between them."""
    parts: list[tuple[State, int]] = []
    for _ in range(int(rng.integers(2, 4))):
        parts += [(State.MISSING, int(rng.integers(1, 3))), (State.GOOD, int(rng.integers(1, 4)))]
    return _row(samples, *parts)


def _two_glitches(rng: Rng, samples: int) -> States:
    first, second = (int(one) for one in rng.integers(1, 4, 2))
    good = max(1, int(rng.integers(2, 12)) - first)
    return _row(samples, (State.BAD, first), (State.GOOD, good), (State.BAD, second))


def _near(rng: Rng, samples: int) -> States:
    """A glitch and missing or flagged samples, up to five good ones between them, in either order."""
    other = State.MISSING if rng.uniform() < 0.5 else State.FLAGGED
    parts = [(State.BAD, int(rng.integers(1, 4))), (other, int(rng.integers(1, 3)))]
    if rng.uniform() < 0.5:
        parts.reverse()
    return _row(samples, parts[0], (State.GOOD, int(rng.integers(0, 6))), parts[1])


def _to_the_end(state: State) -> Callable[[Rng, int], States]:
    return lambda _, samples: np.full(samples, state, np.int8)


KINDS: tuple[Kind, ...] = (
    Kind("missing 1", _of(State.MISSING, 1)),
    Kind("missing 3", _of(State.MISSING, 3)),
    Kind("gaps close together", _gaps),
    Kind("flagged 1", _of(State.FLAGGED, 1)),
    Kind("flagged 2, 3", _of(State.FLAGGED, 2, 3)),
    Kind("flagged 5", _of(State.FLAGGED, 5)),
    Kind("one bad", _of(State.BAD, 1), bad=1),
    Kind("three bad", _of(State.BAD, 3), bad=3),
    Kind("two glitches", _two_glitches, bad=None),
    Kind("glitch near a gap", _near, bad=None),
    Kind("jitter and a glitch", _of(State.BAD, 1, 2, 3), bad=3, jitter=0.03),
    Kind("stays swapped", _to_the_end(State.SWAPPED), bad=None, lasting=True),
    Kind("frozen", _to_the_end(State.FROZEN), bad=None, lasting=True),
    Kind("random", _to_the_end(State.BAD), bad=None, lasting=True),
    Kind("jitter", _of(State.GOOD, 1), jitter=0.03),
    Kind("jitter and a gap", _of(State.MISSING, 1, 2, 3), jitter=0.03),
    Kind("stall", _of(State.GOOD, 1), stall=(1.5, 10.0)),
    Kind("stall and jitter", _of(State.GOOD, 1), jitter=0.03, stall=(1.5, 10.0)),
)
NAMES = tuple(one.name for one in KINDS)
