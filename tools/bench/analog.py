"""The error of the position behind real analog paths, over the speed: the table of docs/analog-front-end.md.

Each row is an encoder of 2500 cycles with 1 % of third harmonic behind a converter of 12 bits with half a
count of noise. Its table comes from a reference measurement at 61 rpm; then it turns at each speed, and the
error is that against the position at the instant of the sample, in cycles: mean / rms without the mean.
"compensated" has the path as it is; "--speeds" has what `canfb calibrate --speeds 61,1500,3000` finds of it,
with the delay (2002:07) given, and with the one that the amplitude tells.

    python -m tools.bench.analog [--check]
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

import canfb
from canfb.calibration.over_speeds import SpeedCalibration, TracksAtSpeed, calibrate_over_speeds
from canfb.calibration.path_correction import sampled_together
from canfb.calibration.recording import recording
from canfb.signal.chain import SignalChain
from canfb.signal.correction import Correction
from canfb.signal.harmonics import Corners
from canfb.signal.sample import Sample
from canfb.simulation.analog_path import IDEAL_PATH, AnalogPath
from canfb.simulation.encoder import Encoder, Harmonic
from tools.site.markdown import table

N = 2500
INTERVAL_S = 1e-3
REFERENCE_RPM = 61.0
FITTED_RPM = (61.0, 1501.0, 2999.0)
FITTED_SAMPLES = 7500
SPEEDS_RPM = (60.0, 300.0, 1000.0, 2000.0, 3000.0)
SAMPLES, START = 3000, 40
GOAL_RMS, GOAL_MULTIPLEXER, GOAL_MEAN, GOAL_ESTIMATED = 0.0003, 0.002, 0.003, 0.02
COMPENSATED, GIVEN, ESTIMATED = "compensated", "--speeds, delay given", "--speeds, delay estimated"


@dataclass(frozen=True)
class Row:
    """An analog path, and what the module is told of it."""

    name: str
    path: AnalogPath


@dataclass(frozen=True)
class Told:
    """What a module computes with."""

    correction: Correction
    corners: Corners


ROWS = (
    Row("ideal", IDEAL_PATH),
    Row("multiplexed, cosine 1 µs after sine", AnalogPath(cosine_delay_s=1e-6)),
    Row("low-pass 125 kHz on both tracks", AnalogPath(sine_corner_hz=125e3, cosine_corner_hz=125e3)),
    Row("the same, corners 2 % apart", AnalogPath(sine_corner_hz=125e3, cosine_corner_hz=127.5e3)),
    Row(
        "multiplexer 100 ns, low-pass 250 kHz, 2 % apart",
        AnalogPath(sine_corner_hz=250e3, cosine_corner_hz=255e3, cosine_delay_s=1e-7),
    ),
)
HARMONICS = {
    "1 % third harmonic": (Harmonic(3, 0.01, 0.01),),
    "1 % third harmonic, tracks of one shape": (Harmonic(3, 0.01, -0.01),),
}


@dataclass(frozen=True)
class Error:
    """Of the position, cycles."""

    mean: float
    rms: float


def positions(rpm: float, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Position (cycles) and speed (cycles/s) of a machine with a little ripple."""
    time = np.arange(samples) * INTERVAL_S
    hertz = rpm / 60.0 * N
    omega = 2.0 * math.pi * 0.37
    ripple = 2e-3 * hertz
    start = float(np.random.default_rng(seed).uniform())
    return start + hertz * time + ripple / omega * (1.0 - np.cos(omega * time)), hertz + ripple * np.sin(
        omega * time
    )


def reference(encoder: Encoder, cosine_delay_s: float) -> Correction:
    """Table and conditioning of a reference measurement at 61 rpm by a module that is told this delay."""
    position, hertz = positions(REFERENCE_RPM, 20000, 1)
    sine, cosine = (
        np.asarray(one, float) for one in encoder.sample(position, np.random.default_rng(2), hertz)
    )
    if cosine_delay_s:
        record = recording(sine, cosine, None, None, 12)
        cosine = sampled_together(record, 2.0 * np.pi * hertz * cosine_delay_s)
    return canfb.calibrate_from_motion(sine, cosine, "fit").correction


def over_speeds(encoder: Encoder) -> SpeedCalibration:
    """What several speeds show of this encoder and its path."""
    measured = []
    for seed, rpm in enumerate(FITTED_RPM):
        position, hertz = positions(rpm, FITTED_SAMPLES, 10 + seed)
        sine, cosine = encoder.sample(position, np.random.default_rng(20 + seed), hertz)
        counts = np.asarray(sine, float), np.asarray(cosine, float)
        measured.append(TracksAtSpeed(*counts, 1.0 / INTERVAL_S, float(np.mean(hertz))))
    return calibrate_over_speeds(measured, adc_bits=12)


def told(used: Correction, path: AnalogPath) -> Told:
    """With this path as it is."""
    known = replace(used.conditioning, cosine_delay_s=path.cosine_delay_s, delay_s=path.lag_s(0.0))
    return Told(Correction(used.table, known), Corners(path.sine_corner_hz, path.cosine_corner_hz))


def errors(encoder: Encoder, used: Told, rpm: float, samples: int) -> Error:
    """At this speed, with what the module is told."""
    position, hertz = positions(rpm, samples, 3)
    sine, cosine = encoder.sample(position, np.random.default_rng(4), hertz)
    config = canfb.ChainConfig(
        conditioning=used.correction.conditioning,
        corner_hz=used.corners.corner_hz,
        cosine_corner_hz=used.corners.cosine_corner_hz,
        interval_s=INTERVAL_S,
    )
    chain = SignalChain(config, used.correction.table)
    chain.restart(0, float(hertz[0]) * INTERVAL_S)
    found = []
    for pair, true in zip(zip(sine.tolist(), cosine.tolist(), strict=True), position.tolist(), strict=True):
        got = chain.step(Sample(*pair))
        lag = chain.lag_intervals
        way = (got.speed_cycles + got.acceleration_cycles * (1.0 + lag) / 2.0) * lag
        found.append((got.cycles - true) + got.phase + way)
    off = np.array(found[START:])
    off -= np.round(np.median(off))
    return Error(float(off.mean()), float(off.std()))


def measured(harmonics: tuple[Harmonic, ...], samples: int) -> Iterator[tuple[Row, dict[str, list[Error]]]]:
    """For each row the errors at each speed, without compensation and with each."""
    for row in ROWS:
        encoder = Encoder(amplitude_counts=1500.0, harmonics=harmonics, noise_lsb=0.5, path=row.path)
        fitted = over_speeds(encoder)
        corners = fitted.path.corners
        modules = {
            row.name: told(reference(encoder, 0.0), IDEAL_PATH),
            COMPENSATED: told(reference(encoder, row.path.cosine_delay_s), row.path),
            GIVEN: Told(fitted.with_delay(row.path.lag_s(0.0)).correction, corners),
            ESTIMATED: Told(fitted.with_delay(fitted.path.low_pass.delay_s).correction, corners),
        }
        yield (
            row,
            {
                name: [errors(encoder, used, rpm, samples) for rpm in SPEEDS_RPM]
                for name, used in modules.items()
            },
        )


def goal(row: Row, rpm: float) -> float:
    """Largest rms of issue and page, cycles."""
    return GOAL_MULTIPLEXER if row.path.cosine_delay_s >= 1e-6 and rpm >= 3000.0 else GOAL_RMS


def misses(row: Row, what: str, found: list[Error]) -> list[float]:
    """Speeds at which an error is over its goal; none for what is not compensated."""
    if what == row.name:
        return []
    mean = GOAL_ESTIMATED if what == ESTIMATED else GOAL_MEAN
    pairs = zip(SPEEDS_RPM, found, strict=True)
    return [rpm for rpm, one in pairs if one.rms > goal(row, rpm) or abs(one.mean) > mean]


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.bench.analog", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--check", action="store_true", help="exit status 1 when a goal is missed")
    parser.add_argument("--samples", type=int, default=SAMPLES, help="samples at each speed")
    options = parser.parse_args(arguments)
    missed = False
    for name, harmonics in HARMONICS.items():
        print(f"\n{name}\n")
        rows = []
        for row, found in measured(harmonics, options.samples):
            for what, over in found.items():
                rows.append([what, *(f"{one.mean:+.4f} / {one.rms:.5f}" for one in over)])
                missed = missed or bool(misses(row, what, over))
        print("\n".join(table(["", *(f"{rpm:g}" for rpm in SPEEDS_RPM)], rows)))
    return 1 if options.check and missed else 0


if __name__ == "__main__":
    sys.exit(main())
