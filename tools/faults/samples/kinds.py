"""What is declared of a machine, and the kinds of fault: what happens to each sample from the fault on.

A sample is good, missing (no sample came in its interval), flagged (the interface says that it is bad) or bad
without a sign of it: of the right amplitude, with any phase. A kind may also change the instants.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from canfb import CorrectionTable, SignalChain
from canfb.signal.chain_config import ChainConfig, ChainLimits
from canfb.signal.limits import PHASE_ERROR_CYCLES, samples_without_harm
from tools.faults.machine import Rng, table_of

COAST_SAMPLES = 8
MOST_BAD = 3
States = npt.NDArray[np.int8]


@dataclass(frozen=True)
class Declared:
    """The largest acceleration, cycles per interval^2.

    phase_error     largest error of the phase of a good sample, cycles
    bad_samples     how many neighbouring samples may be bad without a sign of it; None: see ``bad``
    samples_per_sync  intervals are those from sample to sample
    """

    acceleration: float
    phase_error: float = PHASE_ERROR_CYCLES
    bad_samples: int | None = None
    samples_per_sync: int = 1
    wrong_cycles: ClassVar[float] = 0.5  # a valid position that is off by that much is wrong

    @property
    def bound(self) -> float:
        """Of a legal motion, cycles per interval^2."""
        return self.acceleration

    def chain(self) -> SignalChain:
        return make_chain(self, table_of(self.phase_error))

    @property
    def bad(self) -> int:
        """``bad_samples``, by default as many as cannot do harm at twice the acceleration, 1 to 3."""
        if self.bad_samples is not None:
            return self.bad_samples
        return max(1, min(MOST_BAD, samples_without_harm(2.0 * self.acceleration)))


def config_of(declared: Declared) -> ChainConfig:
    """As far as a :class:`ChainConfig` can say it: the rest is in :func:`limits_of`."""
    return ChainConfig(
        coast_samples=COAST_SAMPLES,
        max_acceleration_cycles=declared.acceleration,
        phase_error_cycles=declared.phase_error,
        bad_samples=declared.bad,
    )


def limits_of(declared: Declared) -> ChainLimits:
    """All limits, to be given to :meth:`SignalChain.set_limits`."""
    return replace(config_of(declared).chain_limits, samples_per_sync=declared.samples_per_sync)


def make_chain(declared: Declared, table: CorrectionTable | None = None) -> SignalChain:
    """A chain for this machine: coasts for 8 samples, otherwise the defaults."""
    chain = SignalChain(config_of(declared), table)
    chain.set_limits(limits_of(declared))
    return chain


class State(IntEnum):
    GOOD = 0
    MISSING = 1
    FLAGGED = 2
    BAD = 3


@dataclass(frozen=True)
class Kind:
    """A kind of fault.

    draw        the states of the samples of one episode, from the one where the fault begins: (rng, samples)
    bad         the most neighbouring samples that are bad without a sign of it; None: more than one row of
                them in one doubt, or more than can be declared
    jitter      of all instants, intervals, uniform
    stall       a pause of so many intervals before the first sample of the fault: shortest and longest
    """

    name: str
    draw: Callable[[Rng, int], States]
    bad: int | None = 0
    jitter: float = 0.0
    stall: tuple[float, float] | None = None

    def is_covered(self, declared: Declared) -> bool:
        """What is declared holds during this fault, so that no position may be valid and wrong."""
        return self.bad is not None and self.bad <= declared.bad

    @property
    def is_even(self) -> bool:
        return not self.jitter and self.stall is None


def _row(samples: int, *parts: tuple[State, int]) -> States:
    """Samples of these states, one after the other, then good ones."""
    states = np.repeat([state for state, _ in parts], [count for _, count in parts])[:samples]
    return np.pad(states, (0, samples - len(states))).astype(np.int8)


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


KINDS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
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
        Kind("jitter", _of(State.GOOD, 1), jitter=0.03),
        Kind("jitter and a gap", _of(State.MISSING, 1, 2, 3), jitter=0.03),
        Kind("stall", _of(State.GOOD, 1), stall=(1.5, 10.0)),
        Kind("stall and jitter", _of(State.GOOD, 1), jitter=0.03, stall=(1.5, 10.0)),
    )
}
