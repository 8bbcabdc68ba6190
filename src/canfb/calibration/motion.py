"""Reference measurement from any motion, at any speed, also many cycles per sample.

The position of a machine is smooth over tens of samples, the errors of the encoder repeat
with every cycle. So both can be told apart in one least-squares fit (:mod:`.joint`), which
needs neither a constant speed nor many samples per cycle, only that the samples of a block
meet different phases.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from canfb.calibration.blocks import Blocks, BoolArray, cut
from canfb.calibration.ellipse import angle_cycles, as_real32, fit_ellipse
from canfb.calibration.evaluate import finish
from canfb.calibration.joint import JointFit, fit_jointly, initial_fit
from canfb.calibration.recording import Recording, check_clipped, recording
from canfb.calibration.result import Calibration
from canfb.calibration.waveform import Waveform, grid_phases, table_sensitivity
from canfb.errors import CalibrationError
from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.signal.phase import FloatArray

FIRST_ORDERS = tuple(range(1, 7))
ORDER_STEPS = (8, 16, 32)
# An order stays if its four coefficients stand out of the noise: chi^2 with four degrees of freedom.
SIGNIFICANT = 16.0
BLOCK_LENGTHS = (32, 64, 128, 256, 512, 1024)
SHORT_LENGTHS = (16, 12)
MIN_BLOCKS = 8
REJECT_SIGMAS = 6.0
REJECT_BLOCK = 4.0

Progress = Callable[[float], None]


def calibrate_from_motion(
    sine: npt.ArrayLike,
    cosine: npt.ArrayLike,
    conditioning: Conditioning | str | None = None,
    *,
    time_s: npt.ArrayLike | None = None,
    valid: npt.ArrayLike | None = None,
    adc_bits: int | None = None,
    entries: int = 1024,
    progress: Progress | None = None,
) -> Calibration:
    """Correction table from samples of any motion, taken at any rate (also below Nyquist).

    sine, cosine    ADC counts, shape (n,), NaN where a sample is missing
    conditioning    None leaves all to the table, "fit" fits the ellipse of the tracks first, or
                    a :class:`canfb.signal.conditioning.Conditioning` to use
    time_s          sample times in seconds, rising; None: one sample per interval, none left out
    valid           False for samples to leave out (missed, faulty)
    adc_bits        4..16, to find clipped samples; None: 12, 14 or 16, the first that fits
    entries         length of the table, 16..4096. 1024 keep the error of interpolation below
                    0.001 % of a cycle even for very poor tracks without conditioning
    progress        called with 0..1 as the work goes on

    Raises ValueError for wrong arguments, :class:`canfb.errors.CalibrationError` for a
    measurement that cannot be used, with the reason and what to do.
    """
    if not 16 <= entries <= 4096:
        raise ValueError(f"entries must be 16..4096, not {entries!r}")
    if not (conditioning is None or conditioning == "fit" or isinstance(conditioning, Conditioning)):
        raise ValueError('conditioning must be None, "fit" or a Conditioning')
    report = progress or no_progress
    record = recording(sine, cosine, time_s, valid, adc_bits)
    ellipse = fit_ellipse(record.sine, record.cosine, record.valid)
    angle = angle_cycles(ellipse, record.sine, record.cosine)
    check_clipped(record, angle)
    report(0.05)
    solver = _Solver(record, ellipse, report)
    fit, blocks = solver.solve(angle)
    report(0.8)
    chosen = IDENTITY if conditioning is None else conditioning
    if not isinstance(chosen, Conditioning):
        chosen = ellipse
    result = finish(record, blocks, fit, as_real32(chosen), entries)
    report(1.0)
    return result


def no_progress(_: float) -> None:
    """Report nothing."""


@dataclass(frozen=True, eq=False)
class _Solver:
    record: Recording
    ellipse: Conditioning
    report: Progress

    def solve(self, angle: FloatArray) -> tuple[JointFit, Blocks]:
        """Track, choose the block length, fit, find the orders; once more with the better phase."""
        position = self._positions(angle)
        length = self._choose_length(position)
        self.report(0.4)
        fit, blocks = self._fit(position, length, FIRST_ORDERS)
        fit, blocks = self._find_orders(fit, blocks)
        self.report(0.6)
        position = self._positions(self._improved(angle, fit.waveform))
        fit, blocks = self._fit(position, length, fit.waveform.orders)
        return self._find_orders(fit, blocks)

    def _positions(self, phase: FloatArray) -> FloatArray:
        return self.record.positions(np.where(self.record.valid, phase, np.nan))

    def _improved(self, angle: FloatArray, waveform: Waveform) -> FloatArray:
        """Phase on the fitted curve at the ellipse's angle; the angle itself if the curve is no good."""
        s, c = self.ellipse.apply(*waveform.tracks(grid_phases()))
        curve = np.unwrap(np.arctan2(s, c) / (2.0 * np.pi), period=1.0)
        if abs(curve[-1] - curve[0] - 1.0) > 1e-6 or np.diff(curve).min() <= 0.0:
            return angle
        ahead = curve[0] + (angle - curve[0]) % 1.0
        phase: FloatArray = np.interp(ahead, curve, grid_phases()) % 1.0 % 1.0
        return phase

    def _choose_length(self, position: FloatArray) -> int:
        """Block length that promises the least error: long ones know more, short ones follow the motion."""
        best, least = 0, np.inf
        for length in BLOCK_LENGTHS:
            error = self._promise(position, length)
            if error < least:
                best, least = length, error
            elif error > 2.0 * least:
                break
        if best == BLOCK_LENGTHS[0]:
            for length in SHORT_LENGTHS:
                error = self._promise(position, length)
                if error < least:
                    best, least = length, error
        if not best:
            raise CalibrationError(
                "too few samples in one piece, or too little motion between them", "samples"
            )
        return best

    def _promise(self, position: FloatArray, length: int) -> float:
        if self.record.valid.sum() < MIN_BLOCKS * length:
            return float("inf")
        try:
            fit, _ = self._fit(position, length, FIRST_ORDERS, polish=False)
        except CalibrationError:
            return float("inf")
        return uncertainty(fit, self.ellipse)

    def _fit(
        self, position: FloatArray, length: int, orders: tuple[int, ...], polish: bool = True
    ) -> tuple[JointFit, Blocks]:
        record = self.record
        blocks = cut(record.time, record.valid, record.breaks, length)
        if int(blocks.used.any(axis=1).sum()) < MIN_BLOCKS:
            raise CalibrationError("too few samples in one piece", "samples")
        waveform, motion = initial_fit(blocks, record.sine, record.cosine, position, orders)
        fit = fit_jointly(blocks, record.sine, record.cosine, waveform, motion, rounds=3)
        cleaned = reject(blocks, fit)
        fit = self._again(fit, cleaned, rounds=4)
        if polish:
            cleaned = reject(blocks.using(blocks.used & _rows(cleaned)), fit)
            fit = self._again(fit, cleaned)
        return fit, cleaned

    def _again(self, fit: JointFit, blocks: Blocks, rounds: int = 10) -> JointFit:
        record = self.record
        return fit_jointly(
            blocks, record.sine, record.cosine, fit.waveform, fit.motion, rounds=rounds, noise=fit.noise
        )

    def _find_orders(self, fit: JointFit, blocks: Blocks) -> tuple[JointFit, Blocks]:
        """More orders while the last ones carry something, then only those that stand out of the noise."""
        for highest in ORDER_STEPS:
            orders = tuple(range(1, highest + 1))
            fit = self._with_orders(fit, blocks, orders)
            kept = significant_orders(fit)
            if max(kept) <= highest * 3 // 4:
                break
        fit = self._with_orders(fit, blocks, kept)
        cleaned = reject(blocks, fit)
        return self._again(fit, cleaned), cleaned

    def _with_orders(self, fit: JointFit, blocks: Blocks, orders: tuple[int, ...]) -> JointFit:
        record, start = self.record, fit.waveform.with_orders(orders)
        return fit_jointly(blocks, record.sine, record.cosine, start, fit.motion, noise=fit.noise)


def uncertainty(fit: JointFit, conditioning: Conditioning) -> float:
    """Expected rms error of the table, cycles."""
    sensitivity = table_sensitivity(fit.waveform, conditioning)
    variance = np.einsum("pi,ij,pj->p", sensitivity, fit.covariance, sensitivity)
    return float(np.sqrt(max(0.0, float(variance.mean()))))


def significant_orders(fit: JointFit) -> tuple[int, ...]:
    """Orders whose coefficients are more than noise; the fundamental always."""
    waveform, kept = fit.waveform, [1]
    half = len(waveform.sine)
    values = np.concatenate([waveform.sine, waveform.cosine])
    for place, order in enumerate(waveform.orders):
        if order == 1:
            continue
        at = np.array([1 + 2 * place, 2 + 2 * place, half + 1 + 2 * place, half + 2 + 2 * place])
        part = fit.covariance[np.ix_(at, at)]
        if values[at] @ np.linalg.pinv(part, hermitian=True) @ values[at] > SIGNIFICANT:
            kept.append(order)
    return tuple(kept)


def reject(blocks: Blocks, fit: JointFit) -> Blocks:
    """Leave out samples far off the curve or the motion, and blocks that do not fit as a whole."""
    use = blocks.used
    good: BoolArray = np.ones_like(use)
    for off in (fit.along, fit.across):
        good &= np.abs(off) < REJECT_SIGMAS * _sigma(off[use])
    size = np.sqrt(np.sum(np.where(use, fit.along**2, 0.0), axis=1) / np.maximum(1, use.sum(axis=1)))
    fits = size < REJECT_BLOCK * max(float(np.median(size[use.any(axis=1)])), 0.3)
    return blocks.using(use & good & fits[:, None])


def _sigma(values: FloatArray) -> float:
    """Robust standard deviation, not below what quantisation leaves."""
    return max(1.4826 * float(np.median(np.abs(values))), 0.3) if len(values) else 0.3


def _rows(blocks: Blocks) -> BoolArray:
    rows: BoolArray = np.any(blocks.used, axis=1, keepdims=True)
    return rows
