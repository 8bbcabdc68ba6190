"""Data for the pictures of one module: from snapshots to plain values, bounded."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np

from canfb.calibration.deviation import best_deviation
from canfb.calibration.recording import recording
from canfb.errors import CalibrationError
from canfb.monitoring.lines import MachineUnits, is_stale
from canfb.monitoring.snapshot import ModuleSnapshot
from canfb.objects import PositionState
from canfb.signal.correction import NO_CORRECTION, Correction
from canfb.signal.phase import FloatArray

LONGEST_S = 120.0
MOST_POINTS = 1200
SAMPLES = 4096  # most recent samples used for the deviation
LEAST_SAMPLES = 512
BLOCK_SAMPLES = 32
GAP_SAMPLES = 100  # missed samples inserted at a gap, more than can be bridged
EVERY_S = 2.0
PERCENT = 100.0
MOST_DOTS = 600
SHOWN = (PositionState.VALID, None)  # states in which positions and velocities are drawn
NOTHING = np.zeros(0)
# Time (s), position, velocity (units of the machine), residual and its limit (cycles), amplitude
# after and before conditioning (counts), new faults, 1 while the position is not valid.
Point = tuple[float | None, ...]


# Deviation of the last samples from smooth motion, % of a cycle, over the phase (0..1), for JSON.
#
# phase, deviation       single samples
# centers, before, mean  means over the phase, without a table and with the table of the module
# text                   rms with and without table, or why there is no curve
Curve = dict[str, Any]


class ModuleTraces:
    """The last minutes of one module."""

    def __init__(self, units: MachineUnits) -> None:
        self.points: deque[Point] = deque(maxlen=MOST_POINTS)
        self.correction: Correction | None = None  # The active one; None while it is not known.
        self.read: Correction | None = None  # The correction read last.
        self._units = units
        self._samples: deque[tuple[int, int, int]] = deque(maxlen=SAMPLES)
        self._received = self._place = self._faults = 0
        self._due_s = -math.inf

    def take(self, now: float, module: ModuleSnapshot) -> None:
        if self.points and now < (self.points[-1][0] or 0.0):
            self.points.clear()
            self._due_s = -math.inf
        self.points.append(self._point(now, module))
        while now - (self.points[0][0] or 0.0) > LONGEST_S:
            self.points.popleft()
        self._judge(module)
        self._follow(module)

    def _judge(self, module: ModuleSnapshot) -> None:
        """Use the correction read last while 2020:04 and status bit 7 agree with it."""
        read, before = self.read, self.correction
        active = None if module.status is None else module.table_active
        if read and read.crc32 == module.table_crc32 and active in (None, bool(read.crc32)):
            self.correction = read
        else:
            self.correction = NO_CORRECTION if active is False else None
        if self.correction != before:
            self._due_s = -math.inf

    def _point(self, now: float, module: ModuleSnapshot) -> Point:
        known = not is_stale(module) and module.position_state in SHOWN
        position, velocity = module.position_revolutions, module.velocity_rad_s
        before, self._faults = self._faults, sum(module.seen.values())
        return (
            now,
            position * self._units.per_revolution if known and position is not None else None,
            self._units.speed(velocity) if known and velocity is not None else None,
            None if is_stale(module) else module.residual_peak_cycles,
            module.residual_limit_cycles,
            None if is_stale(module) or module.amplitude_is_raw else module.amplitude_counts,
            math.hypot(*module.tracks_counts[-1]) if module.tracks_counts else None,
            max(0, self._faults - before) if self.points else 0,
            int(not known),
        )

    def _follow(self, module: ModuleSnapshot) -> None:
        new = module.tracks_heard - self._received
        self._received = module.tracks_heard
        if new < 0:
            self._samples.clear()
        if not 0 <= new <= len(module.tracks_counts):
            self._place += GAP_SAMPLES
            new = len(module.tracks_counts)
        for sine, cosine in module.tracks_counts[len(module.tracks_counts) - new :]:
            self._place += 1
            self._samples.append((self._place, sine, cosine))

    def deviation(self, now: float, full_scale_counts: int) -> Curve | None:
        """The deviation; None if the last one is less than EVERY_S old."""
        if now < self._due_s:
            return None
        self._due_s = now + EVERY_S
        if len(self._samples) < LEAST_SAMPLES:
            return _curve(f"nothing to see: {len(self._samples)} of {LEAST_SAMPLES} samples")
        place, sine, cosine = np.array(self._samples, np.float64).T
        bits = full_scale_counts.bit_length() if full_scale_counts.bit_count() == 1 else None
        try:
            taken = recording(sine, cosine, place, None, bits, may_be_offset=True)
            found = best_deviation(taken, self.correction or NO_CORRECTION, NO_CORRECTION, BLOCK_SAMPLES)
        except (CalibrationError, ValueError):
            return _curve("nothing to see: only while the machine turns, not locked to the samples")
        step = max(1, len(found.phase) // MOST_DOTS)
        mean = found.mean_over_phase()
        return _curve(
            self._words(PERCENT * found.before_rms, PERCENT * found.rms),
            phase=found.phase[::step] % 1.0,
            deviation=PERCENT * found.error[::step],
            centers=(np.arange(len(mean)) + 0.5) / len(mean),
            before=PERCENT * found.mean_over_phase(before=True),
            mean=PERCENT * mean * (np.nan if self.correction in (None, NO_CORRECTION) else 1.0),
        )

    def _words(self, without: float, with_it: float) -> str:
        if self.correction is None:
            return f"without a table {without:.3f} % rms; the active table is not known, --sdo reads it"
        if self.correction == NO_CORRECTION:
            return f"no table is active: {without:.3f} % rms"
        name = f"table {self.correction.crc32:08X}h" if self.correction.table else "conditioning"
        return f"without {without:.3f} % rms, with the active {name} {with_it:.3f} % rms"


def _curve(text: str, **columns: FloatArray) -> Curve:
    curve = dict.fromkeys(("phase", "deviation", "centers", "before", "mean"), NOTHING) | columns
    plain = {
        name: [round(value, 5) if math.isfinite(value) else None for value in column.tolist()]
        for name, column in curve.items()
    }
    return {"text": text} | plain
