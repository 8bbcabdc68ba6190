"""One episode of the fault campaign: run it through the chain, and hold the result against the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from canfb.signal.chain import SignalChain
from canfb.signal.sample import Sample
from canfb.simulation.faults import Samples
from tools.faults.chain.classes import FaultClass
from tools.faults.chain.plant import ENCODER, Setting, Turning, motion
from tools.faults.machine import Array

CLEAN_BEFORE = (100, 301)
CLEAN_AFTER = 100  # a short fault
TO_THE_END = 200
HARM_CYCLES = 0.25
SOON_SAMPLES = 3
GLITCH_SAMPLES = 3  # what the chain has to bridge without losing a cycle

VALID, LOST = 1 << 0, 1 << 2
FLAGGED = 1 << 4 | 1 << 5 | 1 << 6 | 1 << 11  # amplitude, clipped, missed, frozen


@dataclass(frozen=True)
class Episode:
    """What the chain was given, what it published, and what was true."""

    start: int
    stop: int
    samples: Samples
    truth: Array
    error: Array  # published position less the true one, cycles
    status: npt.NDArray[np.int64]


def play(fault_class: FaultClass, turning: Turning, rng: np.random.Generator) -> Episode:
    """A clean lead, a fault, and clean samples again if the fault is a short one."""
    start = int(rng.integers(*CLEAN_BEFORE))
    length = fault_class.length(rng)
    stop = start + (TO_THE_END if length is None else length)
    total = stop if length is None else stop + CLEAN_AFTER
    truth = motion(turning, total, rng)
    clean = Samples.of(*ENCODER.sample(truth, rng), adc_bits=ENCODER.adc_bits)
    samples = fault_class.draw(rng).inject(clean, start, stop, rng)
    positions, status = follow(turning.chain(), samples)
    return Episode(start, stop, samples, truth, positions - (truth - turning.offset), status)


def follow(chain: SignalChain, samples: Samples) -> tuple[Array, npt.NDArray[np.int64]]:
    published = [
        chain.step(Sample(s, c)) if delivered else chain.miss()
        for s, c, delivered in zip(
            samples.sine.tolist(), samples.cosine.tolist(), samples.delivered.tolist(), strict=True
        )
    ]
    positions = np.array([one.cycles + one.phase for one in published])
    return positions, np.array([one.status for one in published], dtype=np.int64)


def first_illegal(setting: Setting, samples: Samples, start: int, phases_only: bool = False) -> int:
    """The first sample from ``start`` on that no legal motion can have led to; behind the last: none.

    A motion is legal if it changes its speed by less than the residual limit from sample to sample, and the
    tracks keep the accepted amplitude and the converter's range. The phases p(k) are those of one exactly if
    every second difference is less than the limit away from a whole number: the positions of the
    prediction are it. ``phases_only``: amplitude and converter are not looked at.
    """
    phase, amplitude = setting.phases(samples.sine, samples.cosine)
    limits = setting.config.limits
    inside = samples.delivered & ~np.isnan(phase)
    if not phases_only:
        for track in (samples.sine, samples.cosine):
            inside &= (track > -limits.full_scale_counts) & (track < limits.full_scale_counts - 1)
        inside &= (amplitude >= limits.amplitude_low_counts) & (amplitude <= limits.amplitude_high_counts)
    c = np.diff(phase, 2)
    with np.errstate(invalid="ignore"):
        inside[2:] &= np.abs(np.rint(c) - c) < setting.residual_limit + setting.slack
    return start + int(np.append(inside[start:], False).argmin())


def judge(setting: Setting, episode: Episode) -> dict[str, int]:
    """Hold an episode against the truth.

    false alarms    a clean sample was flagged, or wrong, before the fault: nothing else counts
    faulty          faulty samples
    flagged, soon   the fault was seen, and after at most three samples
    matters, seen   it moves the phase by more than a quarter of a cycle, takes it away, or a wrong position
                    was called valid; and it was flagged
    legal           not flagged, and all samples together are those of a legal motion (:func:`first_illegal`)
    wrong           positions published as valid that are wrong by more than a quarter of a cycle
    silent, beyond  those of them that neither a legal motion nor a report explains: as declared, or beyond it
    lost            at the end the position is called lost
    """
    start, stop, samples = episode.start, episode.stop, episode.samples
    valid = (episode.status & VALID) != 0
    error = np.abs(episode.error)
    if not valid[:start].all() or bool((error[:start] > HARM_CYCLES).any()):
        return {"false alarms": 1}
    unseen = np.flatnonzero(~valid[start:])
    illegal = first_illegal(setting, samples, start)
    wrong = valid & (error > HARM_CYCLES)
    jump = first_illegal(setting, samples, start, phases_only=True)
    unexplained = _unexplained(wrong, start, jump)
    off = _off(setting, episode)
    silent = unexplained if _is_declared(setting, episode, off) else 0
    matters = not (off[start:stop] <= HARM_CYCLES).all() or bool(wrong.any())
    flagged = len(unseen) > 0
    return {
        "faulty": stop - start,
        "flagged": flagged,
        "soon": flagged and int(unseen[0]) <= SOON_SAMPLES,
        "matters": matters,
        "seen": matters and flagged,
        "legal": not flagged and matters and illegal == len(samples),
        "wrong": int(wrong.sum()),
        "silent": silent,
        "beyond": unexplained - silent,
        "lost": bool(episode.status[-1] & LOST),
    }


def _unexplained(wrong: npt.NDArray[np.bool_], start: int, jump: int) -> int:
    """Wrong samples from ``jump`` on, the first one whose phase is not that of a legal motion.

    None if the position was wrong before the last three samples: a motion is carried on as over a glitch.
    """
    carried_on = jump < len(wrong) and wrong[max(start - 1, jump - GLITCH_SAMPLES - 1)]
    return 0 if carried_on else int(wrong[jump:].sum())


def _off(setting: Setting, episode: Episode) -> Array:
    """How far each phase is from the true one, 0..0.5 cycle; NaN where there is none."""
    samples = episode.samples
    phase, _ = setting.phases(samples.sine, samples.cosine)
    away = phase - episode.truth
    return np.where(samples.delivered, np.abs(away - np.rint(away)), np.nan)


def _is_declared(setting: Setting, episode: Episode, off: Array) -> bool:
    """No more samples in a row are bad and not flagged than cannot do harm (docs/supervision.md)."""
    limits = setting.config.chain_limits
    good = (off <= limits.phase_error) | ~episode.samples.delivered | ((episode.status & FLAGGED) != 0)
    bad = np.flatnonzero(~good)
    return not len(bad) or int(bad[-1] - bad[0]) < replace(limits, bad=0).bad_samples
