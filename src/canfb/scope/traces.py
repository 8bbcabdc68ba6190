"""What the pictures of one module are drawn from: snapshots in, arrays out, all of it bounded."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from canfb.calibration.deviation import best_deviation
from canfb.calibration.recording import recording
from canfb.errors import CalibrationError
from canfb.monitoring.lines import is_stale
from canfb.monitoring.snapshot import BusSnapshot, ModuleSnapshot, NodeSnapshot
from canfb.signal.correction import NO_CORRECTION, Correction
from canfb.signal.phase import FloatArray

LONGEST_S = 120.0  # of position and velocity
MOST_POINTS = 1200
SAMPLES = 4096  # of which the deviation is computed
LEAST_SAMPLES = 512
BLOCK_SAMPLES = 32
GAP_SAMPLES = 100  # more than what can be followed
EVERY_S = 2.0
PERCENT = 100.0
MOST_DOTS = 600


@dataclass(frozen=True, eq=False)
class DeviationCurve:
    """Deviation of the last samples from smooth motion, % of a cycle, over the phase (0..1).

    phase, deviation       single samples
    centers, before, mean  means over the phase, without any table and with that of the module
    rms, before_rms        of all of it
    with_table             False: the table of the module is not known, or there is none
    note                   why there is nothing to see
    """

    phase: FloatArray
    deviation: FloatArray
    centers: FloatArray
    before: FloatArray
    mean: FloatArray
    rms: float = math.nan
    before_rms: float = math.nan
    with_table: bool = False
    note: str = ""


NOTHING = np.zeros(0)


class ModuleTraces:
    """One module: its last minutes."""

    def __init__(self) -> None:
        self.points: deque[tuple[float, float, float]] = deque(maxlen=MOST_POINTS)
        """Time (s), position (revolutions), velocity (rad/s); NaN where it is not known."""
        self.node: NodeSnapshot | None = None
        self.module: ModuleSnapshot | None = None
        self.correction: Correction | None = None
        """The active one; None while it was not read."""
        self._samples: deque[tuple[int, int, int]] = deque(maxlen=SAMPLES)
        self._received = self._place = 0
        self._table_crc32: int | None = None
        self._curve: DeviationCurve | None = None
        self._curve_s = -math.inf

    def take(self, now: float, node: NodeSnapshot, module: ModuleSnapshot) -> None:
        """What is known ``now``, seconds."""
        self.node, self.module = node, module
        if self.points and now < self.points[-1][0]:
            self.points.clear()
        valid = not is_stale(module) and module.position_state in ("valid", None)
        position = module.position_revolutions if valid else None
        velocity = module.velocity_rad_s if valid else None
        self.points.append((now, _number(position), _number(velocity)))
        while self.points[-1][0] - self.points[0][0] > LONGEST_S:
            self.points.popleft()
        if module.table_crc32 != self._table_crc32:
            self._table_crc32 = module.table_crc32
            if self.correction is not None and self.correction.crc32 != module.table_crc32:
                self.correction = None  # another master has activated another table
        self._follow(module)

    def _follow(self, module: ModuleSnapshot) -> None:
        """The samples that have come since; over those that were missed there is a gap."""
        new = module.tracks_heard - self._received
        self._received = module.tracks_heard
        if new < 0:
            self._samples.clear()
            new = len(module.tracks_counts)
        if new > len(module.tracks_counts):
            self._place += GAP_SAMPLES
            new = len(module.tracks_counts)
        for sine, cosine in module.tracks_counts[len(module.tracks_counts) - new :]:
            self._place += 1
            self._samples.append((self._place, sine, cosine))

    def know(self, correction: Correction) -> None:
        """This is the active table and conditioning."""
        self.correction, self._curve_s = correction, -math.inf

    def deviation(self, now: float) -> DeviationCurve:
        """Of the last samples; computed again every EVERY_S seconds."""
        if self._curve is None or not 0.0 <= now - self._curve_s < EVERY_S:
            self._curve, self._curve_s = self._computed(), now
        return self._curve

    def _computed(self) -> DeviationCurve:
        if len(self._samples) < LEAST_SAMPLES or self.module is None:
            return _no_curve(f"{len(self._samples)} of {LEAST_SAMPLES} samples")
        place, sine, cosine = np.array(self._samples, np.float64).T
        full_scale = self.module.full_scale_counts
        bits = full_scale.bit_length() if full_scale.bit_count() == 1 else None
        used = self.correction or NO_CORRECTION
        try:
            taken = recording(sine, cosine, place, None, bits, may_be_offset=True)
            found = best_deviation(taken, used, NO_CORRECTION, BLOCK_SAMPLES)
        except (CalibrationError, ValueError):
            return _no_curve("only while the machine turns, not locked to the samples")
        step = max(1, len(found.phase) // MOST_DOTS)
        bins = found.mean_over_phase()
        return DeviationCurve(
            found.phase[::step] % 1.0,
            PERCENT * found.error[::step],
            (np.arange(len(bins)) + 0.5) / len(bins),
            PERCENT * found.mean_over_phase(before=True),
            PERCENT * bins,
            PERCENT * found.rms,
            PERCENT * found.before_rms,
            used != NO_CORRECTION,
        )


class BusTraces:
    """All modules of a bus."""

    def __init__(self) -> None:
        self.snapshot: BusSnapshot | None = None
        self.modules: dict[int, ModuleTraces] = {}

    def take(self, snapshot: BusSnapshot) -> None:
        """A look at the bus."""
        self.snapshot = snapshot
        for node, module in snapshot.modules:
            self.of(node.node_id).take(snapshot.time_s, node, module)

    def of(self, node_id: int) -> ModuleTraces:
        """Of this module (1..127)."""
        return self.modules.setdefault(node_id, ModuleTraces())


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _no_curve(note: str) -> DeviationCurve:
    return DeviationCurve(NOTHING, NOTHING, NOTHING, NOTHING, NOTHING, note=note)
