"""Simulated reference measurements with a known truth, for the tests of this folder."""

from collections.abc import Callable

import numpy as np
import pytest

from canfb import CalibrationError, CorrectionTable
from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.signal.phase import FloatArray, IntArray, raw_phases
from canfb.simulation.encoder import Encoder, Harmonic

CYCLES_PER_REVOLUTION = 2500
RATE_HZ = 1000.0
PERCENT = 0.01


def true_phases(encoder: Encoder, n: int, conditioning: Conditioning = IDENTITY) -> FloatArray:
    """Position in the cycle at raw phase k/n, from the encoder's own equations, continuous."""
    position = np.arange(1 << 15) / (1 << 15)  # between them a straight line is right to 1e-8
    raw = np.unwrap(raw_phases(*conditioning.apply(*encoder.tracks(position))), period=1.0)
    assert np.diff(raw).min() > 0.0
    raw = raw - np.floor(raw[0])
    curve = np.concatenate([raw - 1.0, raw, raw + 1.0])
    cycles = np.concatenate([position - 1.0, position, position + 1.0])
    return np.interp(np.arange(n) / n, curve, cycles)


def table_error(
    table: CorrectionTable, encoder: Encoder, conditioning: Conditioning = IDENTITY
) -> FloatArray:
    """Error of the table in cycles, between its entries too, mean taken off.

    The mean is no error of the table: where phase 0 lies is a convention. The simulation
    counts from the zero crossing of the fundamental, the table from that of the whole track.
    """
    n = 4096
    error = table(np.arange(n) / n) - true_phases(encoder, n, conditioning)
    error = (error - error[0] + 0.5) % 1.0 - 0.5
    return error - error.mean()


def wandering(rpm: float, rng: np.random.Generator, seconds: float = 20.0) -> FloatArray:
    """Positions in cycles at the SYNC rate: a speed that wanders by 3 %."""
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    swing = sum(
        rng.uniform(0.3, 1.0) * np.sin(2.0 * np.pi * (f * time + rng.uniform()))
        for f in rng.uniform(0.1, 3.0, 5)
    )
    speed = rpm / 60.0 * CYCLES_PER_REVOLUTION * (1.0 + 0.03 * swing / np.abs(swing).max())
    return np.cumsum(speed) / RATE_HZ


def paper_motion(rng: np.random.Generator, seconds: float) -> FloatArray:
    """Positions in cycles at 50 kHz: 9 to 20 rpm, as the constant voltage phasor of the paper gives."""
    time = np.arange(round(seconds * 50e3)) / 50e3
    rpm = 14.5 + 5.5 * np.sin(2.0 * np.pi * (6.0 * time + rng.uniform()))
    return np.cumsum(rpm / 60.0 * CYCLES_PER_REVOLUTION) / 50e3


def random_encoder(rng: np.random.Generator, noise_lsb: float) -> Encoder:
    """An encoder with offset, gain, phase error and 2nd, 3rd and 5th harmonic, all drawn at random."""
    sizes = {2: 0.02, 3: 0.03, 5: 0.01}
    return Encoder(
        amplitude_counts=rng.uniform(1200.0, 1700.0),
        sine_offset=rng.uniform(-0.06, 0.06), cosine_offset=rng.uniform(-0.06, 0.06),
        sine_amplitude=rng.uniform(0.94, 1.06), cosine_amplitude=rng.uniform(0.94, 1.06),
        phase_error_rad=rng.uniform(-0.1, 0.1), noise_lsb=noise_lsb,
        harmonics=tuple(
            Harmonic(order, *rng.uniform(0.0, size, 2), *rng.uniform(0.0, 2.0 * np.pi, 2))
            for order, size in sizes.items()
        ),
    )  # fmt: skip


def measured(
    seed: int | list[int],
    rpm: float,
    seconds: float = 10.0,
    kind: Callable[[np.random.Generator, float], Encoder] = random_encoder,
) -> tuple[Encoder, IntArray, IntArray]:
    """An encoder drawn at random, and its counts at a speed that wanders."""
    rng = np.random.default_rng(seed)
    encoder = kind(rng, 0.5)
    return encoder, *encoder.sample(wandering(rpm, rng, seconds), rng)


def refusal(method: Callable[..., object], *arguments: object, **options: object) -> CalibrationError:
    """The error with which a calibration is refused."""
    with pytest.raises(CalibrationError) as refused:
        method(*arguments, **options)
    return refused.value


def extreme_encoder(rng: np.random.Generator, noise_lsb: float) -> Encoder:
    """The paper's extreme case: 40 % offset and 20 % amplitude error, of either sign."""
    sign = rng.choice([-1.0, 1.0], 3)
    return Encoder(
        amplitude_counts=1250.0,
        sine_offset=0.4 * sign[0],
        cosine_offset=0.4 * sign[1],
        sine_amplitude=1.0 + 0.2 * sign[2],
        cosine_amplitude=1.0 - 0.2 * sign[2],
        noise_lsb=noise_lsb,
    )
