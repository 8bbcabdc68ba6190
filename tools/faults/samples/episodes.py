"""Declarations of a machine, kinds of fault, and their episodes, played on a chain sample by sample.

A sample is good, missing (none in its interval), flagged (the interface marks it as bad) or bad without a
flag: of correct amplitude, at a random phase. A kind may also change the instants.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from canfb import Sample, SignalChain
from canfb.signal.chain_config import ChainConfig, ChainLimits
from canfb.signal.limits import PHASE_ERROR_CYCLES, samples_without_harm
from tools.faults.machine import (
    Array,
    Counts,
    Rng,
    accelerations,
    counts,
    phases,
    positions,
    start_speeds,
    table_of,
)

COAST_SAMPLES = 8
MOST_BAD = 3
BEFORE = (14, 31)  # good samples before the fault
AFTER = 48  # samples after its begin: more than the fault and the 32 intervals of doubt
VALID, LOST = 1, 4
States = npt.NDArray[np.int8]


@dataclass(frozen=True)
class Declared:
    """The largest acceleration, cycles per interval^2.

    phase_error     largest error of the phase of a good sample, cycles
    bad_samples     number of successive samples that may be bad without a flag; None: see ``bad``
    samples_per_sync  samples for each SYNC; intervals are sampling intervals
    """

    acceleration: float
    phase_error: float = PHASE_ERROR_CYCLES
    bad_samples: int | None = None
    samples_per_sync: int = 1
    wrong_cycles: ClassVar[float] = 0.5  # error from which a valid position is wrong

    @property
    def bound(self) -> float:
        """Largest acceleration of a legal motion, cycles per interval^2."""
        return self.acceleration

    @property
    def bad(self) -> int:
        """``bad_samples``; default: the number that is harmless at twice the acceleration, 1 to 3."""
        if self.bad_samples is not None:
            return self.bad_samples
        return max(1, min(MOST_BAD, samples_without_harm(2.0 * self.acceleration)))

    @property
    def config(self) -> ChainConfig:
        """The part that a :class:`ChainConfig` can express; :attr:`limits` has all."""
        return ChainConfig(
            coast_samples=COAST_SAMPLES,
            max_acceleration_cycles=self.acceleration,
            phase_error_cycles=self.phase_error,
            bad_samples=self.bad,
        )

    @property
    def limits(self) -> ChainLimits:
        """All limits, to be given to :meth:`SignalChain.set_limits`."""
        return replace(self.config.chain_limits, samples_per_sync=self.samples_per_sync)

    def chain(self) -> SignalChain:
        """A chain for this machine, which coasts for 8 samples, otherwise with defaults."""
        chain = SignalChain(self.config, table_of(self.phase_error))
        chain.set_limits(self.limits)
        return chain


class State(IntEnum):
    GOOD = 0
    MISSING = 1
    FLAGGED = 2
    BAD = 3


@dataclass(frozen=True)
class Kind:
    """A kind of fault.

    draw        (rng, samples): states of the samples of one episode, from the begin of the fault on
    bad         most successive samples that are bad without a flag; None: several such runs in one doubt, or
                more than can be declared
    jitter      uniform jitter of all instants, ±, intervals
    stall       shortest and longest pause before the first sample of the fault, intervals
    """

    draw: Callable[[Rng, int], States]
    bad: int | None = 0
    jitter: float = 0.0
    stall: tuple[float, float] | None = None

    def is_covered(self, declared: Declared) -> bool:
        """Whether the declaration covers this fault, so that no position may be valid and wrong."""
        return self.bad is not None and self.bad <= declared.bad

    @property
    def is_even(self) -> bool:
        return not self.jitter and self.stall is None


def _row(samples: int, *parts: tuple[State, int]) -> States:
    """Runs of samples with these states, then good ones."""
    states = np.repeat([state for state, _ in parts], [count for _, count in parts])[:samples]
    return np.pad(states, (0, samples - len(states))).astype(np.int8)


def _of(state: State, *lengths: int) -> Callable[[Rng, int], States]:
    return lambda rng, samples: _row(samples, (state, int(rng.choice(lengths))))


def _gaps(rng: Rng, samples: int) -> States:
    """Two or three gaps of one or two samples, with one to three good samples between them."""
    parts: list[tuple[State, int]] = []
    for _ in range(int(rng.integers(2, 4))):
        parts += [(State.MISSING, int(rng.integers(1, 3))), (State.GOOD, int(rng.integers(1, 4)))]
    return _row(samples, *parts)


def _two_glitches(rng: Rng, samples: int) -> States:
    first, second = (int(one) for one in rng.integers(1, 4, 2))
    good = max(1, int(rng.integers(2, 12)) - first)
    return _row(samples, (State.BAD, first), (State.GOOD, good), (State.BAD, second))


def _near(rng: Rng, samples: int) -> States:
    """A glitch and missing or flagged samples, in either order, with up to five good samples between them."""
    other = State.MISSING if rng.uniform() < 0.5 else State.FLAGGED
    parts = [(State.BAD, int(rng.integers(1, 4))), (other, int(rng.integers(1, 3)))]
    if rng.uniform() < 0.5:
        parts.reverse()
    return _row(samples, parts[0], (State.GOOD, int(rng.integers(0, 6))), parts[1])


KINDS: dict[str, Kind] = {
    "missing 1": Kind(_of(State.MISSING, 1)),
    "missing 3": Kind(_of(State.MISSING, 3)),
    "gaps close together": Kind(_gaps),
    "flagged 1": Kind(_of(State.FLAGGED, 1)),
    "flagged 2, 3": Kind(_of(State.FLAGGED, 2, 3)),
    "flagged 5": Kind(_of(State.FLAGGED, 5)),
    "one bad": Kind(_of(State.BAD, 1), bad=1),
    "three bad": Kind(_of(State.BAD, 3), bad=3),
    "two glitches": Kind(_two_glitches, bad=None),
    "glitch near a gap": Kind(_near, bad=None),
    "jitter and a glitch": Kind(_of(State.BAD, 1, 2, 3), bad=3, jitter=0.03),
    "jitter": Kind(_of(State.GOOD, 1), jitter=0.03),
    "jitter and a gap": Kind(_of(State.MISSING, 1, 2, 3), jitter=0.03),
    "stall": Kind(_of(State.GOOD, 1), stall=(1.5, 10.0)),
    "stall and jitter": Kind(_of(State.GOOD, 1), jitter=0.03, stall=(1.5, 10.0)),
}


@dataclass(frozen=True)
class Episode:
    """Input of the chain, and the truth: arrays over the samples.

    fault     index of the first sample that may be bad
    truth     true position, cycles; ``instants`` in intervals
    phase     phase of the counts, computed by the chain (unused for missing samples)
    """

    declared: Declared
    fault: int
    instants: Array
    truth: Array
    sine: Counts
    cosine: Counts
    phase: Array
    state: States
    speed: float


@dataclass(frozen=True)
class Published:
    """Output of the chain for each sample: position (cycles) relative to the true count, and status word.

    The status is 0 if there is no output.
    """

    position: Array
    status: npt.NDArray[np.int64]

    @property
    def valid(self) -> npt.NDArray[np.bool_]:
        bits: npt.NDArray[np.bool_] = (self.status & VALID) != 0
        return bits


def draw(kind: Kind, declared: Declared, episodes: int, rng: Rng) -> list[Episode]:
    per_sync = declared.samples_per_sync
    at = rng.integers(*BEFORE, episodes)
    at += -at % per_sync  # missing and flagged concern all samples of a SYNC
    samples = BEFORE[1] + per_sync + AFTER
    samples += -samples % per_sync
    state = np.zeros((episodes, samples), np.int8)
    for n, first in enumerate(at.tolist()):
        state[n, first:] = _spread(kind.draw(rng, samples - first), per_sync)
    instants = np.tile(np.arange(float(samples)), (episodes, 1))
    if kind.jitter:
        instants += 1.0 + rng.uniform(-kind.jitter, kind.jitter, instants.shape)
    if kind.stall is not None:
        pause = rng.uniform(*kind.stall, episodes) - 1.0
        instants += pause[:, None] * (np.arange(samples)[None, :] >= at[:, None])
    u = accelerations(declared.acceleration, rng, at, samples + (0 if kind.is_even else 10))
    speed = start_speeds(rng, episodes, declared.acceleration * samples)
    truth = positions(u, speed, rng, None if kind.is_even else instants)
    sine, cosine = _faulty(state, *counts(truth, rng), rng)
    phase = phases(sine, cosine, table_of(declared.phase_error))
    start = speed.tolist()
    return [
        Episode(declared, one, instants[n], truth[n], sine[n], cosine[n], phase[n], state[n], start[n])
        for n, one in enumerate(at.tolist())
    ]


def _spread(state: States, per_sync: int) -> States:
    """Extend missing and flagged from one sample to all samples of its SYNC."""
    if per_sync == 1:
        return state
    groups = state[: len(state) // per_sync * per_sync].reshape(-1, per_sync)
    for one in (State.FLAGGED, State.MISSING):
        groups[(groups == one).any(axis=1)] = one
    return state


def _faulty(state: States, sine: Counts, cosine: Counts, rng: Rng) -> tuple[Counts, Counts]:
    """The counts with the faults; flagged samples have random counts."""
    replaced = (state == State.BAD) | (state == State.FLAGGED)
    for_all = counts(rng.uniform(size=state.shape), rng)
    return np.where(replaced, for_all[0], sine), np.where(replaced, for_all[1], cosine)


def chain_for(episode: Episode, declared: Declared | None = None) -> SignalChain:
    """A chain that knows the speed of the first sample of this episode."""
    chain = (declared or episode.declared).chain()
    apart = float(episode.instants[1] - episode.instants[0])
    chain.restart(0, float(episode.truth[1] - episode.truth[0]) / apart)
    return chain


def play(
    episode: Episode,
    chain: SignalChain | None = None,
    before: Callable[[SignalChain, int], None] | None = None,
) -> Published:
    """Play an episode on a chain; ``before`` is called before each SYNC, with the number of its sample."""
    chain = chain_for(episode) if chain is None else chain
    per_sync = episode.declared.samples_per_sync
    samples = len(episode.truth)
    position, status = np.zeros(samples), np.zeros(samples, np.int64)
    sine, cosine = episode.sine.tolist(), episode.cosine.tolist()
    state, instants = episode.state.tolist(), episode.instants.tolist()
    clock = instants[per_sync - 1] - per_sync
    for k in range(per_sync - 1, samples, per_sync):
        if before is not None:
            before(chain, k)
        if k >= per_sync and state[k] == State.MISSING:
            said = [chain.miss()]
            clock += per_sync
        else:
            elapsed = (instants[k] - clock) / per_sync
            clock = instants[k]
            earlier = tuple((sine[k - j], cosine[k - j]) for j in range(1, per_sync))
            invalid = state[k] == State.FLAGGED
            feedback = chain.step(Sample(sine[k], cosine[k], elapsed, invalid, earlier=earlier))
            said = [*chain.between, feedback] if earlier and not invalid else [feedback]
        for j, one in enumerate(reversed(said)):
            position[k - j], status[k - j] = one.cycles + one.phase, one.status
    first = per_sync - 1
    offset = round(float(episode.truth[first] - position[first]))
    return Published(position + offset, status)
