"""The error of the position behind real analog paths, over the speed: the table of docs/analog-front-end.md.

Each row is an encoder of 2500 cycles with 1 % of third harmonic behind a converter of 12 bits with half a
count of noise. Its table comes from a reference measurement at 61 rpm; then it turns at each speed, and the
error is that against the position at the instant of the sample, in cycles: mean / rms without the mean.
"compensated" has the path as it is; "--speeds" has what `canfb calibrate --speeds 61,1500,3000` finds of it,
with the delay (2002:07) given, and with the one that the amplitude shows.

    python -m tools.bench.analog [--check]
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

import canfb
from canfb.calibration.over_speeds import SpeedCalibration, TracksAtSpeed, calibrate_over_speeds
from canfb.calibration.path_correction import sampled_together
from canfb.calibration.recording import recording
from canfb.signal.chain import SignalChain
from canfb.signal.correction import Correction
from canfb.signal.harmonics import Corners
from canfb.signal.sample import Sample
from canfb.simulation.encoder import IDEAL_PATH, AnalogPath, Encoder, Harmonic
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
COMPENSATIONS = (COMPENSATED, GIVEN, ESTIMATED)


PATHS = {
    "ideal": IDEAL_PATH,
    "multiplexed, cosine 1 µs after sine": AnalogPath(cosine_delay_s=1e-6),
    "low-pass 125 kHz on both tracks": AnalogPath(sine_corner_hz=125e3, cosine_corner_hz=125e3),
    "the same, corners 2 % apart": AnalogPath(sine_corner_hz=125e3, cosine_corner_hz=127.5e3),
    "multiplexer 100 ns, low-pass 250 kHz, 2 % apart": AnalogPath(
        sine_corner_hz=250e3, cosine_corner_hz=255e3, cosine_delay_s=1e-7
    ),
}
HARMONICS = {
    "1 % third harmonic": (Harmonic(3, 0.01, 0.01),),
    "1 % third harmonic, tracks of one shape": (Harmonic(3, 0.01, -0.01),),
}


Error = tuple[float, float]
"""Mean and rms without the mean of the position error, cycles."""


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
    """Table and conditioning of a reference measurement at 61 rpm by a module with this delay in 2002:06."""
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


def compensated(encoder: Encoder, path: AnalogPath) -> SignalChain:
    """The chain of a module that is configured with this path."""
    used = reference(encoder, path.cosine_delay_s)
    known = replace(used.conditioning, cosine_delay_s=path.cosine_delay_s, delay_s=path.lag_s(0.0))
    return chain(Correction(used.table, known), Corners(path.sine_corner_hz, path.cosine_corner_hz))


def chain(used: Correction, corners: Corners) -> SignalChain:
    """With the conditioning and table of ``used``, behind a low-pass with these corners."""
    config = canfb.ChainConfig(
        conditioning=used.conditioning,
        corner_hz=corners.corner_hz,
        cosine_corner_hz=corners.cosine_corner_hz,
        interval_s=INTERVAL_S,
    )
    return SignalChain(config, used.table)


def error(encoder: Encoder, chain: SignalChain, rpm: float, samples: int) -> Error:
    """At this speed, from the instant of the sample on."""
    position, hertz = positions(rpm, samples, 3)
    tracks = encoder.sample(position, np.random.default_rng(4), hertz)
    chain.reset()
    chain.restart(0, float(hertz[0]) * INTERVAL_S)
    found = []
    for sine, cosine, true in zip(*(one.tolist() for one in (*tracks, position)), strict=True):
        got = chain.step(Sample(sine, cosine))
        lag = chain.tracks.lag_intervals
        moved = (got.speed_cycles + got.acceleration_cycles * (1.0 + lag) / 2.0) * lag
        found.append((got.cycles - true) + got.phase + moved)
    off = np.array(found[START:])
    off -= np.round(np.median(off))
    return float(off.mean()), float(off.std())


def measured(
    harmonics: tuple[Harmonic, ...], samples: int
) -> Iterator[tuple[str, AnalogPath, dict[str, list[Error]]]]:
    """Each path with its errors at each speed, without compensation and with each."""
    for name, path in PATHS.items():
        encoder = Encoder(amplitude_counts=1500.0, harmonics=harmonics, noise_lsb=0.5, path=path)
        fitted = over_speeds(encoder)
        delays = {GIVEN: path.lag_s(0.0), ESTIMATED: fitted.path.low_pass.delay_s}
        modules = {name: compensated(encoder, IDEAL_PATH), COMPENSATED: compensated(encoder, path)}
        modules |= {
            what: chain(fitted.with_delay(delay_s).correction, fitted.path.corners)
            for what, delay_s in delays.items()
        }
        found = {
            what: [error(encoder, one, rpm, samples) for rpm in SPEEDS_RPM] for what, one in modules.items()
        }
        yield name, path, found


def is_missed(path: AnalogPath, what: str, rpm: float, found: Error) -> bool:
    """Whether an error of a compensated module is over its goal (docs/analog-front-end.md)."""
    multiplexed = path.cosine_delay_s >= 1e-6 and rpm >= 3000.0
    rms, mean = GOAL_MULTIPLEXER if multiplexed else GOAL_RMS, GOAL_MEAN
    if what == ESTIMATED:
        mean = GOAL_ESTIMATED
    return what in COMPENSATIONS and (found[1] > rms or abs(found[0]) > mean)


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
        for _, path, found in measured(harmonics, options.samples):
            for what, over in found.items():
                rows.append([what, *(f"{mean:+.4f} / {rms:.5f}" for mean, rms in over)])
                missed |= any(is_missed(path, what, *one) for one in zip(SPEEDS_RPM, over, strict=True))
        print("\n".join(table(["", *(f"{rpm:g}" for rpm in SPEEDS_RPM)], rows)))
    return 1 if options.check and missed else 0


if __name__ == "__main__":
    sys.exit(main())
