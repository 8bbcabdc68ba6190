"""What became of an episode: silent errors, with the proof, and availability.

A position is wrong if it is valid and ``wrong_cycles`` or more from the true one. It is *excused* if there is
a legal motion through all samples so far that nothing flagged (:class:`LegalMotions`), and all of these are
at that position: then the samples are those of a healthy machine that moved so (docs/supervision.md). Every
other wrong position is *silent*: where legal motions to different positions fit, it was guessed.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from tools.faults.samples.episodes import LOST, Episode, Published
from tools.faults.samples.kinds import State
from tools.faults.samples.legal import LegalMotions, least_bound

LEAD = 4  # good samples before the fault, from which the motions are followed


class Cause(Enum):
    EXCUSED = "legal motion"
    GUESSED = "two legal motions, the wrong one"
    ILLEGAL = "no legal motion"
    UNDECIDED = "too many motions to decide"


SILENT = (Cause.GUESSED, Cause.ILLEGAL)


@dataclass(frozen=True)
class Verdict:
    """Of an episode.

    early         not valid, or wrong, before the fault: the episode counts no further
    wrong         the causes of its wrong positions, by sample
    kept          at the end valid and right
    not_valid     samples from the fault on without the valid bit
    lost          at the end
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
    first = per_sync - 1
    early = not valid[first:fault].all() or bool(wrong[:fault].any())
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


def causes(episode: Episode, published: Published, wrong: np.ndarray) -> dict[int, Cause]:
    motions, truth, near = motions_before(episode), motions_before(episode), episode.declared.wrong_cycles
    received = ~np.isin(episode.state, (State.MISSING, State.FLAGGED))
    said = dict.fromkeys(wrong.tolist(), Cause.ILLEGAL)
    for k in range(episode.fault, int(wrong[-1]) + 1):
        if received[k]:
            instant, phase = float(episode.instants[k]), float(episode.phase[k])
            motions.add(instant, phase)
            if truth.paths:
                truth.add(instant, phase)
                here = float(episode.truth[k])
                truth.paths = [path for path in truth.paths if abs(path[-1] - here) < near]
        if k in said and received[k]:
            fits = [abs(path[-1] - published.position[k]) < near for path in motions.paths]
            if any(fits):
                said[k] = Cause.EXCUSED if all(fits) and not truth.paths else Cause.GUESSED
            elif motions.overflow:
                said[k] = Cause.UNDECIDED
    return said


def proof(episode: Episode, published: Published, wrong: int) -> str:
    """The motions that fit all samples up to ``wrong`` that nothing flagged, and the least bound of each."""
    motions = motions_before(episode)
    for k in range(episode.fault, wrong + 1):
        if episode.state[k] not in (State.MISSING, State.FLAGGED):
            motions.add(float(episode.instants[k]), float(episode.phase[k]))
    lines = [f"{len(motions.paths)} legal motions through all samples up to {wrong} that nothing flagged"]
    instants = np.array(motions.instants)
    for path in motions.paths[:10]:
        bound = least_bound(instants, np.array(path), episode.declared.phase_error)
        end = path[-1] - float(episode.truth[wrong])
        lines.append(
            f"  ends {end:+.3f} cycles from the truth; least bound of a motion through it {bound:.4f}"
        )
    return "\n".join(lines)
