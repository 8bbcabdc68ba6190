"""Print how good correction tables are: methods x encoders x speeds, against the truth, as Markdown.

    python -m tools.bench.calibration [--seconds S] [--seeds N] [--encoder NAME] [--conditioning fit|none]

Encoders are simulated, so the phase that a table should give is known exactly. Of several seeds (encoder,
motion, noise) the worst is printed. Errors are those of the table itself, in per cent of a cycle, between
its entries too; the constant part is none. The last column holds the noise of the samples, which have
12 bits, as well. Exit status 1 when a table that was
accepted is worse than it says of itself.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from canfb.signal.phase import wrap

try:
    import canfb
except ImportError as error:
    sys.exit(f"{error}: run this file with the Python of the virtual environment (make test makes it)")
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import CorrectionTable
from canfb.signal.phase import FloatArray, raw_phases
from canfb.simulation.encoder import Encoder, Harmonic

CYCLES = 2500
SYNC_HZ, FAST_HZ = 1000.0, 50e3
FAST_SECONDS = 4.0
GRID, FINE = 4096, 1 << 16
PERCENT = 100.0
HEADER = (
    "encoder",
    "method",
    "speed, rpm",
    "before, peak %",
    "after, peak %",
    "after, rms %",
    "promised, peak %",
    "single samples, rms %",
)
SPEEDS_RPM = (6.0, 60.0, 600.0, 2000.0, 3000.0)
SLOW_RPM = (9.0, 20.0)
MakeEncoder = Callable[[np.random.Generator], Encoder]


def ideal(rng: np.random.Generator) -> Encoder:
    return Encoder(amplitude_counts=1500.0, noise_lsb=0.5)


def good(rng: np.random.Generator) -> Encoder:
    return _drawn(rng, 0.02, {2: 0.002, 3: 0.004}, 0.5)


def mediocre(rng: np.random.Generator) -> Encoder:
    return _drawn(rng, 0.06, {2: 0.02, 3: 0.03, 5: 0.01}, 0.5)


def noisy(rng: np.random.Generator) -> Encoder:
    return _drawn(rng, 0.06, {2: 0.02, 3: 0.03, 5: 0.01}, 4.0)


def extreme(rng: np.random.Generator) -> Encoder:
    """The paper's: 40 % offset, 20 % amplitude error."""
    sign = rng.choice([-1.0, 1.0], 3)
    return Encoder(
        amplitude_counts=1250.0,
        sine_offset=0.4 * sign[0],
        cosine_offset=0.4 * sign[1],
        sine_amplitude=1.0 + 0.2 * sign[2],
        cosine_amplitude=1.0 - 0.2 * sign[2],
        noise_lsb=0.5,
    )


def _drawn(rng: np.random.Generator, part: float, sizes: dict[int, float], noise_lsb: float) -> Encoder:
    return Encoder(
        amplitude_counts=rng.uniform(1200.0, 1650.0),
        sine_offset=rng.uniform(-part, part),
        cosine_offset=rng.uniform(-part, part),
        sine_amplitude=rng.uniform(1.0 - part, 1.0 + part),
        cosine_amplitude=rng.uniform(1.0 - part, 1.0 + part),
        phase_error_rad=rng.uniform(-part, part),
        harmonics=tuple(
            Harmonic(order, *rng.uniform(0.0, size, 2), *rng.uniform(0.0, 2.0 * np.pi, 2))
            for order, size in sizes.items()
        ),
        noise_lsb=noise_lsb,
    )


ENCODERS: dict[str, tuple[MakeEncoder, str]] = {
    "ideal": (ideal, "ideal tracks"),
    "good": (good, "2 % offset and gain, 0.4 % harmonics"),
    "mediocre": (mediocre, "6 % offset and gain, 3 % harmonics"),
    "noisy": (noisy, "as mediocre, noise 4 LSB rms"),
    "extreme": (extreme, "40 % offset, 20 % gain"),
}


@dataclass
class Result:
    """The worst of all seeds, cycles."""

    before: float = 0.0
    peak: float = 0.0
    rms: float = 0.0
    promised: float = 0.0
    sample: float = 0.0
    broken: bool = False
    refused: str = ""

    def add(self, before: FloatArray, after: FloatArray, promised: float, sample: float) -> None:
        """One more seed."""
        peak = float(np.abs(after).max())
        self.before = max(self.before, float(np.abs(before).max()))
        self.peak = max(self.peak, peak)
        self.rms = max(self.rms, float(np.sqrt(np.mean(after**2))))
        self.promised = max(self.promised, promised)
        self.sample = max(self.sample, sample)
        self.broken |= peak > promised

    @property
    def cells(self) -> list[str]:
        """Before, peak, rms, promised, single samples."""
        if self.refused:
            return ["", "", "", "", f"refused: {self.refused}"]
        values = (self.before, self.peak, self.rms, self.promised, self.sample)
        return [f"{PERCENT * value:.2g}" for value in values]


def true_phases(encoder: Encoder, n: int, conditioning: Conditioning) -> FloatArray:
    """Position in the cycle at raw phase k/n, from the equations of the encoder."""
    position = np.arange(FINE) / FINE
    raw = np.unwrap(raw_phases(*conditioning.apply(*encoder.tracks(position))), period=1.0)
    raw = raw - np.floor(raw[0])
    curve = np.concatenate([raw - 1.0, raw, raw + 1.0])
    places = np.concatenate([position - 1.0, position, position + 1.0])
    phases: FloatArray = np.interp(np.arange(n) / n, curve, places)
    return phases


def error_of(table: CorrectionTable, encoder: Encoder, conditioning: Conditioning) -> FloatArray:
    """Error over the raw phase, cycles, its mean taken off."""
    error = table(np.arange(GRID) / GRID) - true_phases(encoder, GRID, conditioning)
    error = wrap(error - error[0])
    alone: FloatArray = error - error.mean()
    return alone


def motion(rpm: float, seconds: float, rng: np.random.Generator) -> FloatArray:
    """Positions in cycles at each SYNC: a speed that wanders by 3 %."""
    time = np.arange(round(seconds * SYNC_HZ)) / SYNC_HZ
    swing = sum(
        rng.uniform(0.3, 1.0) * np.sin(2.0 * np.pi * (f * time + rng.uniform()))
        for f in rng.uniform(0.1, 3.0, 5)
    )
    speed = rpm / 60.0 * CYCLES * (1.0 + 0.03 * swing / np.abs(swing).max())
    return np.cumsum(speed) / SYNC_HZ


def slow_motion(rng: np.random.Generator) -> FloatArray:
    """Positions in cycles at 50 kHz: 9 to 20 rpm, as under the constant voltage phasor of the paper."""
    time = np.arange(round(FAST_SECONDS * FAST_HZ)) / FAST_HZ
    low, high = SLOW_RPM
    rpm = (low + high) / 2.0 + (high - low) / 2.0 * np.sin(2.0 * np.pi * (6.0 * time + rng.uniform()))
    return np.cumsum(rpm / 60.0 * CYCLES) / FAST_HZ


def cases(
    seconds: float,
) -> list[tuple[str, str, Callable[..., canfb.Calibration], Callable[..., FloatArray]]]:
    """Method, speed, the method itself, and the motion."""
    listed: list[tuple[str, str, Callable[..., canfb.Calibration], Callable[..., FloatArray]]] = [
        (
            f"zero crossings, {FAST_SECONDS:g} s at 50 kHz",
            f"{SLOW_RPM[0]:g}..{SLOW_RPM[1]:g}",
            canfb.calibrate_from_zero_crossings,
            slow_motion,
        )
    ]
    listed += [
        (
            f"motion, {seconds:g} s at 1 kHz",
            f"{rpm:g}",
            canfb.calibrate_from_motion,
            lambda rng, rpm=rpm: motion(rpm, seconds, rng),
        )
        for rpm in SPEEDS_RPM
    ]
    return listed


def measure(
    make: MakeEncoder,
    method: Callable[..., canfb.Calibration],
    move: Callable[..., FloatArray],
    seeds: int,
    conditioning: str | None,
) -> Result:
    """All seeds of one row."""
    result = Result()
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        encoder = make(rng)
        sine, cosine = encoder.sample(move(rng), rng)
        try:
            found = method(sine, cosine, conditioning, adc_bits=12)
        except canfb.CalibrationError as error:
            result.refused = error.reason
            break
        identity = CorrectionTable.identity()
        result.add(
            error_of(identity, encoder, Conditioning()),
            error_of(found.table, encoder, found.conditioning),
            found.uncertainty_peak,
            found.residual_rms,
        )
    return result


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.bench.calibration", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--seconds", type=float, default=10.0, help="of motion at 1 kHz (10)")
    parser.add_argument("--seeds", type=int, default=1, help="encoders and motions for each row (1)")
    parser.add_argument("--encoder", choices=ENCODERS, help="this one only")
    parser.add_argument(
        "--conditioning", choices=("fit", "none"), default="none", help="of the tracks (none)"
    )
    options = parser.parse_args(argv)
    if options.seconds < 1.0 or options.seeds < 1:
        parser.error("--seconds and --seeds must be 1 or more")
    print(f"| {' | '.join(HEADER)} |\n|{'---|' * len(HEADER)}")
    broken = False
    conditioning = "fit" if options.conditioning == "fit" else None
    for name, (make, words) in ENCODERS.items():
        if options.encoder not in (None, name):
            continue
        for method_words, speed, method, move in cases(options.seconds):
            result = measure(make, method, move, options.seeds, conditioning)
            broken |= result.broken
            print(f"| {' | '.join([f'{name}: {words}', method_words, speed, *result.cells])} |", flush=True)
    return int(broken)


if __name__ == "__main__":
    sys.exit(main())
