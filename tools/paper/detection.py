"""Claims on error detection: section 4, and the claims of section 5 on cables."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from canfb import max_acceleration, track
from canfb.simulation import faults
from canfb.simulation.faults import Fault, Samples, Signal
from tools.faults.machine import Motion, exact_table
from tools.paper.claim import Claim, Effort, Verdict, grouped, percent, verdict
from tools.paper.plant import (
    CYCLES_PER_REVOLUTION,
    USUAL,
    FloatArray,
    Way,
    bare,
    cycles_per_sample,
    followed,
    sampled,
    turning,
)
from tools.paper.tracking import RATE_HZ, SLOW_RATE_HZ, TOP_RPM, is_right, largest_acceleration

LIMIT = 1.0 / 3.0
CRUISE = 20.3  # cycles per sample before an acceleration


def two_thirds(effort: Effort) -> Iterator[Claim]:
    formula = max_acceleration(CYCLES_PER_REVOLUTION, RATE_HZ, LIMIT)
    found = largest_acceleration(lambda way, result: is_right(way, result) and bool(result.ok.all()))
    part = found / max_acceleration(CYCLES_PER_REVOLUTION, RATE_HZ)
    yield Claim(
        "two-thirds",
        f"{100 * part:.1f} %: {grouped(found)} rad/s² is the largest that is not flagged "
        f"({grouped(formula)} by the formula)",
        verdict(0.66 < part < 0.67 and abs(found / formula - 1.0) < 1e-4),
    )


class Accelerated(NamedTuple):
    """Results for each sample of a machine that accelerates for some time."""

    flagged: npt.NDArray[np.bool_]
    residual: FloatArray
    error: FloatArray

    @property
    def wrong(self) -> npt.NDArray[np.bool_]:
        return np.abs(self.error) > 0.5


def accelerated(change: float, samples: int = 60) -> Accelerated:
    """Constant speed with `samples` of this change of speed (cycles per sample); 12 bits, noise."""
    cruise = np.concatenate([[0.0], np.full(100, CRUISE / 100), np.zeros(20)])
    way = Way.from_steps(np.concatenate([cruise, np.full(samples, change), np.zeros(40)]))
    result = followed(USUAL, way, np.random.default_rng(11))
    return Accelerated(~result.ok, result.residual, way.error(result.cycles, result.phase))


def too_fast(effort: Effort) -> Iterator[Claim]:
    samples = 60
    between = accelerated(0.42, samples)
    allowed = max_acceleration(CYCLES_PER_REVOLUTION, SLOW_RATE_HZ)
    yield Claim(
        "between-limits",
        f"{0.42 * 2 * allowed:.0f} rad/s² at 1 kHz (0.42 cycle): {between.wrong.sum()} wrong positions, "
        f"{between.flagged.sum()} of {samples} samples flagged",
        verdict(not between.wrong.any() and int(between.flagged.sum()) == samples),
    )
    beyond = accelerated(0.58, samples)
    behind = float(beyond.error[-2] - beyond.error[-1])
    yield Claim(
        "beyond-half",
        f"{0.58 * 2 * allowed:.0f} rad/s² at 1 kHz (0.58 cycle): {beyond.flagged.sum()} of {samples} samples "
        "flagged, the first with the first wrong position; with each of them the speed falls behind by one "
        f"more cycle per sample, by {behind:.0f} in the end",
        verdict(
            int(beyond.flagged.sum()) == samples
            and int(np.argmax(beyond.flagged)) <= int(np.argmax(beyond.wrong))
            and abs(behind - samples) < 1.5
        ),
    )
    yield _far_beyond(effort)


def _far_beyond(effort: Effort) -> Claim:
    """The residual is folded: for an acceleration of 2/3 to 4/3 cycle it is below the limit again."""
    steady = float(np.median(accelerated(0.9).residual[123:181]))
    rng = np.random.default_rng(12)
    changes = rng.uniform(2 / 3, 4 / 3, effort.cases)
    sudden = float(np.mean([is_silent(onset(a, rng.uniform(), 0.0)) for a in changes]))
    # The acceleration rises by less than 1/3 between samples, so that it cannot skip 1/3..2/3.
    gentle = float(np.mean([is_silent(onset(a, rng.uniform(), a / 0.3)) for a in changes]))
    return Claim(
        "beyond-two-thirds",
        "from 2/3 to 4/3 cycle the steady residual is below 1/3 again "
        f"({steady:.2f} at 0.9): only the onset can be flagged. Not flagged in time: "
        f"{percent(sudden, 2)} of sudden onsets, {percent(gentle, 2)} where the acceleration itself rises by "
        "at most 0.3 cycle from sample to sample",
        verdict(0.4 < sudden < 0.75 and gentle == 0.0 and 0.08 < steady < 0.12, Verdict.LIMITED),
    )


def onset(change: float, fraction: float, rise: float) -> FloatArray:
    """Positions around the onset of an acceleration, `fraction` of an interval after sample 5.

    `change` in cycles per sample²; it is reached after `rise` sampling intervals, linearly.
    """
    begin = 5.0 + fraction
    motion = Motion(start=0.37)
    if rise > 0.0:
        motion.jerks += [(begin, change / rise), (begin + rise, -change / rise)]
    else:
        motion.pieces.append((begin, change))
    return motion.at(np.arange(30))


def is_silent(position: FloatArray) -> bool:
    """Whether a position was wrong before anything was flagged."""
    whole = np.floor(position)
    result = track(position - whole)
    wrong = result.cycles != (whole - whole[0]).astype(np.int64)
    return bool(wrong.any() and result.ok[: int(np.argmax(wrong)) + 1].all())


def never_forgets(effort: Effort) -> Iterator[Claim]:
    """Claims on the effect of one bad sample at 2000 rpm and 1 kHz."""
    samples, at, glitch = 1300, 500, 0.3
    rng = np.random.default_rng(13)
    way = Way.from_steps(turning(cycles_per_sample(TOP_RPM, SLOW_RATE_HZ), samples))
    sine, cosine = sampled(USUAL, way, rng)
    sine[at], cosine[at] = USUAL.sample(way.phase[at] + glitch, rng)
    result = bare(sine, cosine, exact_table(USUAL.tracks))
    error = way.error(result.cycles, result.phase)
    later = abs(float(error[at + 1001] - error[at + 1]))
    flagged = int(np.count_nonzero(~result.ok))
    first = int(np.argmax(~result.ok)) - at
    yield Claim(
        "never-forgets",
        f"one sample off by {glitch} cycle: flagged {flagged} time, {first} sample later; after 1000 samples "
        f"the position is {later:.0f} cycles further off",
        verdict(abs(later - 1000.0) < 0.01 and flagged == 1 and 0 <= first <= 2),
    )


CABLE_FAULTS: dict[str, Fault] = {
    "sine dead": faults.open_track(Signal.SINE),
    "cosine dead": faults.open_track(Signal.COSINE),
    "tracks joined": faults.joined_tracks(),
    "tracks swapped": faults.swapped_tracks(),
    "sine inverted": faults.inverted_tracks(Signal.SINE),
}


def cables(effort: Effort) -> Iterator[Claim]:
    """Claims on faults of the cables, in motion and at standstill, detected by eq. 12 only."""
    rng = np.random.default_rng(14)
    turning = {name: _detected(fault, effort.cases, 83.3, rng) for name, fault in CABLE_FAULTS.items()}
    standing = float(np.mean([_detected(f, effort.cases, 0.0, rng) for f in CABLE_FAULTS.values()]))
    dead = min(turning[name] for name in ("sine dead", "cosine dead", "tracks joined"))
    mirrored = min(turning[name] for name in ("tracks swapped", "sine inverted"))
    yield Claim(
        "cables",
        f"by the residual alone, within 20 samples, at random speeds up to ±2000 rpm and 1 kHz: "
        f"{', '.join(f'{name} {percent(part, 2)}' for name, part in turning.items())} (swapped and inverted "
        f"tracks are those of a machine that turns the other way). At standstill {percent(standing, 2)}: "
        "amplitude has to be watched too",
        verdict(0.9 < dead < 0.99 and 0.45 < mirrored < 0.7 and 0.05 < standing < 0.3, Verdict.LIMITED),
    )


def _detected(fault: Fault, cases: int, top_speed: float, rng: np.random.Generator) -> float:
    """Part of the faults, beginning at random phases, that are flagged within 20 samples."""
    found = 0
    table = exact_table(USUAL.tracks)
    for _ in range(cases):
        speed = rng.uniform(-top_speed, top_speed)
        way = Way.from_steps(turning(speed, 60), float(rng.uniform()))
        at = len(way) - 40
        samples = Samples.of(*sampled(USUAL, way, rng))
        faulty = fault.inject(samples, at, len(samples), np.random.default_rng(0))
        result = bare(faulty.sine, faulty.cosine, table)
        assert result.ok[:at].all()
        found += not result.ok[at : at + 20].all()
    return found / cases
