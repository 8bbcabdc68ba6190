"""The conventional method of the introduction (Fig. 1), compared with that of the paper."""

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from canfb.signal.phase import FloatArray, raw_phases
from canfb.simulation.encoder import Encoder
from tools.paper.claim import Claim, Effort, grouped, verdict
from tools.paper.plant import (
    EXTREME,
    IDEAL,
    USUAL,
    WRONG_CYCLES,
    Way,
    bisected,
    cycles_per_sample,
    followed,
    score,
    turning,
)

RATE_HZ = 1000.0
SPEEDS_RPM = (20.0, 200.0, 2000.0)
OFFSETS_S = (0.1e-6, 1e-6)
MILLION = 1e6
SAMPLES = 1_000_000


def quadrant(sine: FloatArray, cosine: FloatArray) -> FloatArray:
    """Quadrant of the cycle, 0..3, from the signs of the tracks, as two comparators give it."""
    return np.where(sine >= 0.0, np.where(cosine >= 0.0, 0.0, 1.0), np.where(cosine >= 0.0, 3.0, 2.0))


def counted(encoder: Encoder, sampled: FloatArray, shift: float, fix: bool) -> FloatArray:
    """Positions (Fig. 1): an ideal counter of zero crossings, read `shift` cycles after two converters.

    `fix` corrects the count if the quadrants of counter and converters differ.
    """
    tracks = encoder.tracks(sampled + shift)
    # The raw phase wraps where the counter counts, and its error is less than half a cycle.
    cycles = np.rint(sampled + shift - raw_phases(*tracks))
    read = [track.astype(np.float64) for track in encoder.sample(sampled, np.random.default_rng(21))]
    at, seen = quadrant(*tracks), quadrant(*read)
    cycles += fix * (1.0 * ((at == 3.0) & (seen == 0.0)) - ((at == 0.0) & (seen == 3.0)))
    return np.asarray(cycles + raw_phases(*read), np.float64)


def wrong_per_million(encoder: Encoder, rpm: float, shift: float, fix: bool, samples: int) -> float:
    """Wrong positions per 10^6 samples at constant speed, with the counter read `shift` cycles later."""
    # A slightly different speed, so that the samples meet all phases.
    step = cycles_per_sample(rpm, RATE_HZ) + 1e-3 * np.sqrt(2.0)
    position = 0.3 + step * np.arange(samples)
    wrong = np.abs(counted(encoder, position, shift, fix) - position) > WRONG_CYCLES
    return MILLION * float(np.mean(wrong))


def fix_bears(encoder: Encoder, samples: int) -> float:
    """Largest shift between counter and converters, cycles, at which the fix gives no error."""

    def good(shift: float) -> bool:
        return all(wrong_per_million(encoder, 2000.0, s, True, samples) == 0.0 for s in (shift, -shift))

    return bisected(0.0, 0.5, 1e-4, good)


def extremes() -> Iterator[Encoder]:
    """The paper's extreme case with all signs, which determine the quadrants that become narrow."""
    for sine, cosine, error in itertools.product((-0.4, 0.4), (-0.4, 0.4), (-0.2, 0.2)):
        yield replace(
            EXTREME,
            sine_offset=sine,
            cosine_offset=cosine,
            sine_amplitude=1.0 + error,
            cosine_amplitude=1.0 - error,
        )


def conventional(effort: Effort) -> Iterator[Claim]:
    samples = min(SAMPLES, effort.samples)
    plain = {
        (rpm, offset): wrong_per_million(USUAL, rpm, cycles_per_sample(rpm, 1.0) * offset, False, samples)
        for rpm in SPEEDS_RPM
        for offset in (0.0, *OFFSETS_S)
    }
    expected = {key: MILLION * cycles_per_sample(key[0], 1.0) * key[1] for key in plain}
    way = Way.from_steps(turning(cycles_per_sample(SPEEDS_RPM[-1], RATE_HZ), samples))
    ours = score(way, followed(USUAL, way, np.random.default_rng(22))).wrong
    listed = "; ".join(
        f"{rpm:.0f} rpm: {' and '.join(grouped(plain[rpm, offset]) for offset in OFFSETS_S)}"
        for rpm in SPEEDS_RPM
    )
    fits = all(abs(plain[key] - expected[key]) < 300.0 + 0.02 * expected[key] for key in plain)
    yield Claim(
        "conventional-plain",
        f"wrong of 10⁶ samples with 0.1 µs and 1 µs between them, at {listed}; with none, by noise and "
        f"rounding, {plain[2000.0, 0.0]:.0f}. Ours: {ours}",
        verdict(fits and plain[2000.0, 1e-6] > 8e4 and ours == 0),
    )
    few = samples // 20
    bears = fix_bears(IDEAL, few)
    bears_extreme = min(fix_bears(encoder, few) for encoder in extremes())
    below = wrong_per_million(USUAL, 2000.0, 0.2, True, samples)
    beyond = wrong_per_million(IDEAL, 2000.0, 0.3, True, samples)
    yield Claim(
        "conventional-fix",
        f"0.2 cycle apart: {below:.0f} wrong. It tolerates {bears:.3f} cycle "
        f"({1e6 * bears / cycles_per_sample(2000.0, 1.0):.1f} µs at 2000 rpm) with ideal tracks, and down to "
        f"{bears_extreme:.3f} with 40 % offset and 20 % amplitude error; 0.3 cycle apart "
        f"{grouped(beyond)} of 10⁶ are wrong",
        verdict(
            below == 0.0
            and 0.247 < bears < 0.252
            and 0.05 < bears_extreme < 0.2
            and abs(beyond - 1e5) < 3000.0
        ),
    )
