"""Episodes of one kind of fault, drawn as arrays, and played on a chain sample by sample."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from canfb import SignalChain
from canfb.signal.sample import Sample
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
from tools.faults.samples.kinds import Declared, Kind, State

BEFORE = (14, 31)  # good samples before the fault
AFTER = 48  # good ones after its begin: more than the 32 intervals of doubt, and a fault
VALID, LOST = 1, 4


@dataclass(frozen=True)
class Episode:
    """What the chain gets, and what is true: arrays over the samples, one interval apart where not given.

    fault     index of the first sample that may be bad
    truth     cycles; ``instants`` in intervals
    phase     of the counts, as the chain computes it (of missing samples as well: not used)
    """

    declared: Declared
    fault: int
    instants: Array
    truth: Array
    sine: Counts
    cosine: Counts
    phase: Array
    state: npt.NDArray[np.int8]
    speed: float


@dataclass(frozen=True)
class Published:
    """What the chain said of each sample: position (cycles) minus that of the true count, and status word.

    A sample without one has the status 0.
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
    at += -at % per_sync  # what is missing or flagged is so for all samples of a SYNC
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


def _spread(state: npt.NDArray[np.int8], per_sync: int) -> npt.NDArray[np.int8]:
    """What is missing or flagged concerns a SYNC: all its samples, if one of them."""
    if per_sync == 1:
        return state
    whole = len(state) // per_sync * per_sync
    groups = state[:whole].reshape(-1, per_sync)
    for one in (State.FLAGGED, State.MISSING):
        groups[(groups == one).any(axis=1)] = one
    return state


def _faulty(state: npt.NDArray[np.int8], sine: Counts, cosine: Counts, rng: Rng) -> tuple[Counts, Counts]:
    """The counts with the faults in them; flagged samples have any counts."""
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
    """Through the public interface of the chain; ``before`` is called before each SYNC, with its sample."""
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
