"""Verdict on an episode: silent errors, with the proof, and availability.

A position is wrong if it is valid and ``wrong_cycles`` or more from the true one. It is *excused* if at least
one legal motion fits all unflagged samples so far (:class:`LegalMotions`), and all such motions lead to that
position: the samples are then those of a healthy machine with this motion (docs/supervision.md). Every
other wrong position is *silent*; if legal motions to different positions fit, it was guessed.

Linear programming decides whether samples can be those of a machine within its limits. Nodes are the instants
of the samples, and virtual instants about one interval apart where samples are missing. A motion is legal if
twice the second divided differences of its nodes are at most the bound B; it fits the samples if it is within
the phase error of each. This file shares no code with the estimator.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt
from scipy.optimize import linprog

from tools.faults.machine import Array
from tools.faults.samples.episodes import LOST, Episode, Published, State

LEAD = 4  # good samples before the fault with which the motions begin
HOLE = 1.5  # intervals between two samples beyond which virtual nodes are inserted
SLACK = 1e-7  # accuracy of the solver
MOST_PATHS = 3000


def nodes_of(instants: Array) -> tuple[Array, npt.NDArray[np.int64]]:
    """Instants of all nodes, and the indices of the nodes at samples."""
    gaps = np.diff(instants)
    parts = np.where(gaps > HOLE, np.rint(gaps), 1.0).astype(np.int64)
    places = np.concatenate(([0], np.cumsum(parts)))
    return np.interp(np.arange(places[-1] + 1), places, instants), places


def difference_rows(nodes: Array) -> Array:
    """Matrix that converts positions at the nodes to twice their second divided differences."""
    count = len(nodes) - 2
    rows = np.zeros((max(0, count), len(nodes)))
    for n in range(count):
        at = nodes[n : n + 3]
        for k, one in enumerate(at):
            rows[n, n + k] = 2.0 / float(np.prod(one - np.delete(at, k)))
    return rows


def least_bound(instants: Array, samples: Array, phase_error: float | Array) -> float:
    """The least bound B of a motion within ``phase_error`` of these positions, cycles per interval^2.

    ``instants``, intervals, must increase; shapes (n,), for ``phase_error`` a number or (n,).
    0.0 for two samples or fewer.
    """
    nodes, places = nodes_of(instants)
    rows = difference_rows(nodes)
    if not len(rows):
        return 0.0
    reference = np.polynomial.Polynomial.fit(instants, samples, min(1, len(samples) - 1))
    rest = samples - reference(instants)
    column = -np.ones((len(rows), 1))
    constraints = np.vstack((np.hstack((rows, column)), np.hstack((-rows, column))))
    low, high = np.full(len(nodes) + 1, -np.inf), np.full(len(nodes) + 1, np.inf)
    low[places], high[places], low[-1] = rest - phase_error, rest + phase_error, 0.0
    cost = np.zeros(len(nodes) + 1)
    cost[-1] = 1.0
    result = linprog(
        cost,
        A_ub=constraints,
        b_ub=np.zeros(len(constraints)),
        bounds=np.column_stack((low, high)),
        method="highs",
    )
    if not result.success:
        raise RuntimeError(f"the solver found nothing: {result.message}")
    return float(result.fun)


def is_legal(instants: Array, samples: Array, phase_error: float, bound: float) -> bool:
    return least_bound(instants, samples, phase_error) <= bound + SLACK


def window(instants: Sequence[float], to: float, phase_error: float, bound: float) -> tuple[Array, float]:
    """Weights of the last samples for the predicted position at ``to``, and the largest distance of a sample.

    ``instants`` of the last two samples, increasing.
    """
    first, second = instants
    weights = np.array([(to - second) / (first - second), (to - first) / (second - first)])
    reach = bound * (to - first) * (to - second) / 2.0
    return weights, reach + phase_error * (1.0 + float(np.abs(weights).sum()))


class LegalMotions:
    """All legal motions through the unflagged samples, starting from a known motion.

    A sample is checked by its residual, as in eq. 12; samples around a hole by the linear program.
    So an estimator that checks the windows of all samples publishes one of these motions.
    """

    def __init__(self, phase_error: float, bound: float) -> None:
        self._phase_error, self._bound = phase_error, bound
        self.instants: list[float] = []
        self.paths: list[tuple[float, ...]] = []
        self.overflow = False
        self._run = 0  # samples since the last hole
        self._checked_from = 0  # first sample for the linear program while the run is short

    def begin(self, instants: Sequence[float], positions: Sequence[float]) -> None:
        self.instants, self.paths = list(instants), [tuple(positions)]
        self._run, self._checked_from = len(instants), 0

    def add(self, instant: float, phase: float) -> None:
        weights, radius = window(self.instants[-2:], instant, self._phase_error, self._bound)
        if instant - self.instants[-1] > HOLE:
            if self._run >= 2:
                self._checked_from = len(self.instants) - 2
            self._run = 0
        self._run += 1
        self.instants.append(instant)
        near_hole = self._run <= 2 and len(self.instants) > self._run
        paths = []
        for path in self.paths:
            centre = float(np.dot(weights, path[-2:]))
            first = math.ceil(centre - radius - SLACK - phase)
            for count in range(first, math.floor(centre + radius + SLACK - phase) + 1):
                one = (*path, count + phase)
                if not near_hole or self._fits(one):
                    paths.append(one)
            if len(paths) > MOST_PATHS:
                self.overflow = True
                paths = paths[:MOST_PATHS]
        if self._run > 2:  # motions with equal last samples have the same future: keep one
            paths = list({one[-2:]: one for one in reversed(paths)}.values())
        self.paths = paths

    def _fits(self, path: tuple[float, ...]) -> bool:
        at = slice(self._checked_from, None)
        instants, samples = np.array(self.instants[at]), np.array(path[at])
        return is_legal(instants, samples, self._phase_error, self._bound)


class Cause(Enum):
    EXCUSED = "legal motion"
    GUESSED = "two legal motions, the wrong one"
    ILLEGAL = "no legal motion"
    UNDECIDED = "too many motions to decide"


SILENT = (Cause.GUESSED, Cause.ILLEGAL)


@dataclass(frozen=True)
class Verdict:
    """Verdict on an episode.

    early         not valid, or wrong, before the fault: the episode is not evaluated further
    wrong         causes of its wrong positions, by sample
    kept          valid and right at the end
    not_valid     number of samples from the fault on without the valid bit
    lost          lost at the end
    """

    early: bool
    wrong: dict[int, Cause]
    kept: bool
    not_valid: int
    lost: bool

    @property
    def silent(self) -> bool:
        return any(one in SILENT for one in self.wrong.values())

    @property
    def excused(self) -> bool:
        return bool(self.wrong) and not self.silent


def judge(episode: Episode, published: Published) -> Verdict:
    per_sync, fault = episode.declared.samples_per_sync, episode.fault
    valid = published.valid
    wrong = valid & (np.abs(published.position - episode.truth) >= episode.declared.wrong_cycles)
    newest = slice(per_sync - 1 + (fault // per_sync) * per_sync, None, per_sync)
    early = not valid[per_sync - 1 : fault].all() or bool(wrong[:fault].any())
    return Verdict(
        early=early,
        wrong=causes(episode, published, np.flatnonzero(wrong)) if wrong.any() and not early else {},
        kept=bool(valid[-1] and not wrong[-1]),
        not_valid=int((~valid)[newest].sum()),
        lost=bool(published.status[-1] & LOST),
    )


def motions_before(episode: Episode) -> LegalMotions:
    declared, begin = episode.declared, slice(episode.fault - LEAD, episode.fault)
    right = episode.phase + np.rint(episode.truth - episode.phase)
    motions = LegalMotions(declared.phase_error, declared.bound)
    motions.begin(episode.instants[begin].tolist(), right[begin].tolist())
    return motions


def received(episode: Episode, last: int) -> Iterator[tuple[int, float, float]]:
    """Number, instant and phase of samples from the fault to ``last``, without missing and flagged ones."""
    for k in range(episode.fault, last + 1):
        if episode.state[k] not in (State.MISSING, State.FLAGGED):
            yield k, float(episode.instants[k]), float(episode.phase[k])


def causes(episode: Episode, published: Published, wrong: np.ndarray) -> dict[int, Cause]:
    motions, truth, near = motions_before(episode), motions_before(episode), episode.declared.wrong_cycles
    said = dict.fromkeys(wrong.tolist(), Cause.ILLEGAL)
    for k, instant, phase in received(episode, int(wrong[-1])):
        motions.add(instant, phase)
        if truth.paths:
            truth.add(instant, phase)
            here = float(episode.truth[k])
            truth.paths = [path for path in truth.paths if abs(path[-1] - here) < near]
        if k in said:
            fits = [abs(path[-1] - published.position[k]) < near for path in motions.paths]
            if any(fits):
                said[k] = Cause.EXCUSED if all(fits) and not truth.paths else Cause.GUESSED
            elif motions.overflow:
                said[k] = Cause.UNDECIDED
    return said


def proof(episode: Episode, wrong: int) -> str:
    """The motions that fit all unflagged samples up to ``wrong``, and the least bound of each."""
    motions = motions_before(episode)
    for _, instant, phase in received(episode, wrong):
        motions.add(instant, phase)
    lines = [f"{len(motions.paths)} legal motions through all samples up to {wrong} that nothing flagged"]
    instants = np.array(motions.instants)
    for path in motions.paths[:10]:
        bound = least_bound(instants, np.array(path), episode.declared.phase_error)
        end = path[-1] - float(episode.truth[wrong])
        lines.append(
            f"  ends {end:+.3f} cycles from the truth; least bound of a motion through it {bound:.4f}"
        )
    return "\n".join(lines)
