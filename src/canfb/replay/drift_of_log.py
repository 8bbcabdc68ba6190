"""How far the encoder of a log had moved away from the table in force: the log as a reference measurement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from canfb.calibration.deviation import drift
from canfb.calibration.from_motion import calibrate_from_motion
from canfb.calibration.path_correction import sampled_together
from canfb.calibration.recording import recording
from canfb.errors import CalibrationError
from canfb.objects import StatusBit
from canfb.replay.sample_columns import Block
from canfb.signal.correction import Correction
from canfb.signal.phase import FloatArray

MOST_SAMPLES = 1 << 15
"""So many samples of a log are measured: enough for a table, and of bounded time."""
LEAST_SAMPLES = 1000


@dataclass(frozen=True)
class LogDrift:
    """Cycles, without the constant part; NaN and a ``reason`` where the log does not show it."""

    rms: float = float("nan")
    peak: float = float("nan")
    uncertainty_rms: float = float("nan")
    reason: str | None = None


class DriftTracks:
    """Keeps the first samples from the first motion on, as they came; give it blocks."""

    def __init__(self) -> None:
        self._sine: list[FloatArray] = []
        self._cosine: list[FloatArray] = []
        self._hertz: list[FloatArray] = []
        self._samples = 0
        self._moved = False

    def take(self, block: Block) -> None:
        """More samples."""
        cycles = block["cycles"]
        self._moved = self._moved or int(cycles.max()) - int(cycles.min()) > 1
        if not self._moved or self._samples >= MOST_SAMPLES:
            return
        missed = block["status"] & StatusBit.MISSED != 0
        for kept, name in ((self._sine, "sine_counts"), (self._cosine, "cosine_counts")):
            kept.append(np.where(missed, np.nan, block[name].astype(np.float64)))
        interval_s = np.where(block["interval_s"] > 0.0, block["interval_s"], np.inf)
        self._hertz.append(block["speed_cycles"] / interval_s)
        self._samples += len(missed)

    def drift(self, active: Correction, adc_bits: int) -> LogDrift:
        """Against the ``active`` table and conditioning."""
        if self._samples < LEAST_SAMPLES:
            return LogDrift(reason="no motion" if not self._moved else "few samples")
        sine, cosine = np.concatenate(self._sine), np.concatenate(self._cosine)
        try:
            cosine = self._together(sine, cosine, active.conditioning.cosine_delay_s, adc_bits)
            fresh = calibrate_from_motion(sine, cosine, active.conditioning, adc_bits=adc_bits)
            found = drift(fresh, active.table, active.conditioning)
        except CalibrationError as error:
            return LogDrift(reason=str(error.reason))
        except ValueError as error:
            return LogDrift(reason=" ".join(str(error).split()))
        return LogDrift(found.rms, found.peak, fresh.uncertainty_rms)

    def _together(
        self, sine: FloatArray, cosine: FloatArray, cosine_delay_s: float, adc_bits: int
    ) -> FloatArray:
        """The cosine at the instant of the sine."""
        if not cosine_delay_s:
            return cosine
        record = recording(sine, cosine, None, None, adc_bits, may_be_offset=True)
        turned = 2.0 * np.pi * cosine_delay_s * np.concatenate(self._hertz)
        return np.where(np.isnan(cosine), np.nan, sampled_together(record, turned))
