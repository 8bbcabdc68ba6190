"""Claims on the position within a cycle: introduction, section 2, part of section 5."""

import itertools
from collections.abc import Iterator

import numpy as np

from canfb import CalibrationError, CorrectionTable, calibrate_from_zero_crossings, phase_in_cycle
from canfb.signal.phase import wrap
from canfb.simulation.encoder import Encoder
from tools.faults.machine import exact_table, ideal_tracks
from tools.paper.claim import Claim, Effort, Verdict, grouped, percent, verdict
from tools.paper.plant import CYCLES_PER_REVOLUTION, EXTREME, IDEAL, USUAL, FloatArray

GRID = 1 << 18
PAPER_TABLE_ENTRIES = 200  # 800 bytes on the paper's processor
RECORDING_RATE_HZ = 50_000.0


def introduction(effort: Effort) -> Iterator[Claim]:
    """Claims of the example that shows the limits of digital encoders."""
    rate_hz, resolution_rpm, speed_rpm = 2000.0, 0.1, 3000.0
    cycles = 60.0 * rate_hz / (4.0 * resolution_rpm)
    frequency_hz = speed_rpm / 60.0 * cycles
    ours_rpm = 60.0 * rate_hz * resolution_step() / CYCLES_PER_REVOLUTION
    ours_hz = speed_rpm / 60.0 * CYCLES_PER_REVOLUTION
    yield Claim(
        "quad-counting",
        f"{grouped(cycles)} cycles, {frequency_hz / 1e6:.1f} MHz; this method with 2500 cycles and 12 bits: "
        f"{ours_rpm:.4f} rpm, {ours_hz / 1e3:.0f} kHz",
        verdict(round(cycles) == 300_000 and round(frequency_hz) == 15_000_000 and ours_rpm < resolution_rpm),
    )


def phases(effort: Effort) -> Iterator[Claim]:
    position = np.arange(GRID) / GRID
    sine, cosine = ideal_tracks(position)
    raw = phase_in_cycle(sine, cosine)
    error = _largest(raw - position)
    yield Claim("table-1-error", f"{percent(error, 4)} of a cycle", verdict(0.011 < error < 0.0125))
    steps = np.diff(raw) * GRID  # slope; that of the true phase is 1
    yield Claim(
        "table-1-continuous",
        f"slope {steps.min():.3f} to {steps.max():.3f} everywhere, no step",
        verdict(steps.min() > 0.78 and steps.max() < 1.58),
    )
    printed = np.where(position > 7 / 8, 1.0 + sine / cosine, raw)  # Table 1 with its last column as printed
    step = float(np.diff(printed).min())
    away = float(np.abs(printed - position).max())
    yield Claim(
        "table-1-misprint",
        f"steps by {step:.3f} cycle at 7/8, up to {away:.3f} cycle off; with 1 + s/(8c) it is continuous",
        verdict(step < -0.8, Verdict.MISPRINT),
    )
    yield _arc_tangent(position)


def _arc_tangent(position: FloatArray) -> Claim:
    arc_tangent = exact_table(IDEAL.tracks, PAPER_TABLE_ENTRIES)
    slight = Encoder(sine_offset=0.05, cosine_offset=0.05)
    ideal = peak_error(IDEAL, arc_tangent, position)
    offset = peak_error(slight, arc_tangent, position)
    extreme = peak_error(EXTREME, arc_tangent, position)
    individual = peak_error(EXTREME, exact_table(EXTREME.tracks, PAPER_TABLE_ENTRIES), position)
    size = len(arc_tangent.to_bytes())
    return Claim(
        "arc-tangent",
        f"arc tangent {percent(ideal, 2)} of a cycle on ideal tracks, {percent(offset, 2)} with 5 % offset, "
        f"{percent(extreme, 3)} with 40 % offset and 20 % amplitude error; individual table of {size} bytes "
        f"there {percent(individual, 2)}",
        verdict(ideal < 1e-4 and 0.008 < offset < 0.02 and 0.1 < extreme < 0.2 and 1e-5 < individual < 2e-4),
    )


def reference_measurement(effort: Effort) -> Iterator[Claim]:
    speed_rpm = 60.0 * RECORDING_RATE_HZ / 50.0 / CYCLES_PER_REVOLUTION
    yield Claim("reference-speed", f"{speed_rpm:.1f} rpm", verdict(round(speed_rpm, 6) == 24.0))
    number = np.arange(round(effort.recording_s * RECORDING_RATE_HZ), dtype=np.float64)
    # Slightly below 24 rpm, so that the samples do not repeat the same 50 phases in each cycle.
    steady = number * (23.93 / 24.0 / 50.0)
    # Speed of a machine driven by a constant voltage phasor: 9 to 20 rpm.
    rpm = 14.5 + 5.5 * np.sin(2.0 * np.pi * 6.0 * number / RECORDING_RATE_HZ)
    swinging = np.cumsum(rpm / 60.0 * CYCLES_PER_REVOLUTION) / RECORDING_RATE_HZ
    cases = {
        "ideal": (IDEAL, steady),
        "usual": (USUAL, steady),
        "extreme": (EXTREME, steady),
        "fluctuating": (EXTREME, swinging),
    }
    found = {name: calibrated_error(encoder, way) for name, (encoder, way) in cases.items()}
    largest = max(found.values())
    yield Claim(
        "reference-50-samples",
        f"{percent(found['ideal'], 2)} on ideal tracks, {percent(found['usual'], 2)} with harmonics and "
        f"offset, {percent(found['extreme'], 2)} with 40 % and 20 %",
        verdict(1e-6 < largest <= 5e-4),
    )
    yield Claim(
        "reference-fluctuating",
        f"{percent(found['fluctuating'], 2)} with 40 % and 20 %",
        verdict(1e-6 < found["fluctuating"] <= 5e-4),
    )


def conclusion(effort: Effort) -> Iterator[Claim]:
    sine, cosine = ideal_tracks(np.arange(0, GRID, 7) / GRID)
    raw = phase_in_cycle(sine, cosine)
    common = max(
        float(np.abs(wrap(phase_in_cycle(k * sine, k * cosine) - raw)).max()) for k in (0.1, 0.5, 1.3, 7)
    )
    single = float(np.abs(wrap(phase_in_cycle(1.1 * sine, cosine) - raw)).max())
    yield Claim(
        "common-amplitude",
        f"{percent(common, 1)} of a cycle at 0.1 to 7 times the amplitude; 10 % on one track alone: "
        f"{percent(single, 2)}",
        verdict(common < 1e-15 and 0.008 < single < 0.03),
    )
    step = resolution_step()
    yield Claim(
        "resolution",
        f"1/{1.0 / step:.0f} cycle in the worst place, 45 degrees",
        verdict(5700 < 1.0 / step < 5900),
    )


def peak_error(encoder: Encoder, table: CorrectionTable, position: FloatArray) -> float:
    """Largest error of the phases less their mean, because phase 0 is a convention."""
    off = wrap(table(phase_in_cycle(*encoder.tracks(position))) - position)
    return float(np.abs(off - off.mean()).max())


def resolution_step() -> float:
    """Largest change of the raw phase by one LSB of a track, at full scale of 12 bits."""
    sine, cosine = (2048.0 * track for track in ideal_tracks(np.arange(4096) / 4096))
    raw = phase_in_cycle(sine, cosine)
    return max(
        _largest(phase_in_cycle(sine + ds, cosine + dc) - raw)
        for ds, dc in itertools.product((-1.0, 0.0, 1.0), repeat=2)
    )


def calibrated_error(encoder: Encoder, way: FloatArray) -> float:
    """Largest error of the table of a reference measurement; inf if that is refused."""
    try:
        found = calibrate_from_zero_crossings(*encoder.sample(way, np.random.default_rng(4)))
    except CalibrationError:
        return np.inf
    n = 4096
    off = wrap(found.table(np.arange(n) / n) - exact_table(encoder.tracks, n).entries)
    return float(np.abs(off - off.mean()).max())


def _largest(difference: FloatArray) -> float:
    return float(np.abs(wrap(difference)).max())
