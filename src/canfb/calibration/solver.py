"""From a recording to the joint fit: track, block length, orders, faults left out, track again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from canfb.calibration.blocks import CUBIC, Blocks, BoolArray, cut
from canfb.calibration.joint import JointFit, fit_jointly, information_loss, initial_fit
from canfb.calibration.judgement import LOCKED_LOSS, MAX_OFF_CYCLES, check_smooth, check_way, no_fit
from canfb.calibration.recording import MIN_SAMPLES, Recording, coverage
from canfb.calibration.waveform import Waveform, grid_phases, table_sensitivity
from canfb.errors import CalibrationError
from canfb.signal.conditioning import Conditioning
from canfb.signal.phase import FloatArray


class Shape(NamedTuple):
    """Length of the blocks in samples, coefficients of the motion in each."""

    length: int
    terms: int


FIRST_ORDERS = tuple(range(1, 7))
ORDER_STEPS = (8, 16, 32)
# An order stays if its four coefficients stand out of the noise: chi^2 with four degrees of freedom.
SIGNIFICANT = 16.0
STIFF = tuple(Shape(length, CUBIC) for length in (12, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096))
LIVELY_NOISE = 1.15
WAY_SAMPLES = 64
MIN_BLOCKS = 8
# Enough to choose the block length by.
TRIAL_SAMPLES = 8000
TRIAL_ROUNDS = 4
REJECT_SIGMAS = 6.0
REJECT_BLOCK = 4.0
QUANTISATION_COUNTS = 0.3
COARSE_CYCLES = 0.05


class Solution(NamedTuple):
    """Fit, the blocks used, and how many times the unknown motion made the uncertainty larger."""

    fit: JointFit
    blocks: Blocks
    loss: float


Progress = Callable[[float], None]


def no_progress(_: float) -> None:
    """Report nothing."""


@dataclass(frozen=True, eq=False)
class Solver:
    """The search for tracks and motion. ``ellipse`` turns the tracks into a rough circle
    of radius ``amplitude_counts``.
    """

    record: Recording
    ellipse: Conditioning
    amplitude_counts: float
    report: Progress

    def solve(self, angle: FloatArray) -> Solution:
        """Tracks and motion from the ellipse's ``angle`` (cycles). CalibrationError if there are none."""
        position = self._positions(angle)
        check_way(coverage(angle[self.record.valid]), self._way(position))
        shape = self._choose_shape(position, FIRST_ORDERS)
        self.report(0.4)
        fit, blocks = self._fit(self._cut(shape), position)
        loss = self._loss(blocks, position)
        check_smooth(self._off_cycles(fit), loss)
        fit, blocks = self._find_orders(fit, blocks)
        if fit.waveform.orders[-1] > FIRST_ORDERS[-1]:
            # What the first orders left looked like motion.
            orders = fit.waveform.orders
            shape = self._choose_shape(position, orders)
            fit, blocks = self._find_orders(*self._fit(self._cut(shape), position, orders))
        self.report(0.7)
        if blocks.samples < int(self.record.valid.sum()):
            # Better phases may follow the motion where the first ones lost it.
            position = self._positions(self._improved(angle, fit.waveform))
            again, more = self._fit(self._cut(shape), position, fit.waveform.orders)
            if more.samples > blocks.samples:
                fit, blocks = self._find_orders(again, more)
        off = max(self._off_cycles(fit), fit.noise.across / (2.0 * np.pi * self.amplitude_counts))
        telling = blocks.used[blocks.informative(blocks.evaluate(fit.motion))].sum()
        if self._curve(fit.waveform) is None or off > MAX_OFF_CYCLES or telling < MIN_SAMPLES:
            raise no_fit("tracks and motion cannot be told apart", loss)
        return Solution(fit, blocks, loss)

    def _off_cycles(self, fit: JointFit) -> float:
        return fit.noise.along / (2.0 * np.pi * self.amplitude_counts)

    def _loss(self, blocks: Blocks, position: FloatArray) -> float:
        motion = blocks.smooth(position[blocks.index])
        return information_loss(blocks, self._circle(), motion)

    def _way(self, position: FloatArray) -> float:
        """Cycles gone through, noise left out, as far as the samples can tell."""
        seen = position[self.record.valid][::WAY_SAMPLES]
        return float(np.abs(np.diff(seen)).sum())

    def _circle(self) -> Waveform:
        track = np.zeros((2, 1 + 2 * len(FIRST_ORDERS)))
        track[0, 2] = track[1, 1] = self.amplitude_counts
        return Waveform(FIRST_ORDERS, track[0], track[1])

    def _positions(self, phase: FloatArray) -> FloatArray:
        return self.record.positions(np.where(self.record.valid, phase, np.nan))

    def _improved(self, angle: FloatArray, waveform: Waveform) -> FloatArray:
        """Phase on the fitted curve at the ellipse's angle; the angle itself if the curve is no good."""
        curve = self._curve(waveform)
        if curve is None:
            return angle
        ahead = curve[0] + (angle - curve[0]) % 1.0
        phase: FloatArray = np.interp(ahead, curve, grid_phases()) % 1.0 % 1.0
        return phase

    def _curve(self, waveform: Waveform) -> FloatArray | None:
        """Angle of the waveform over the phase, None unless it rises through one cycle."""
        s, c = self.ellipse.apply(*waveform.tracks(grid_phases()))
        curve = np.unwrap(np.arctan2(s, c) / (2.0 * np.pi), period=1.0)
        rises = abs(curve[-1] - curve[0] - 1.0) < 1e-6 and np.diff(curve).min() > 0.0
        return curve if rises else None

    def _cut(self, shape: Shape) -> Blocks:
        record = self.record
        return cut(record.time, record.valid, record.breaks, shape.length, shape.terms)

    def _choose_shape(self, position: FloatArray, orders: tuple[int, ...]) -> Shape:
        """Blocks that promise the least error: long and stiff ones know more, others follow the motion."""
        best, least, lively = STIFF[1], np.inf, True
        for shape in STIFF:
            error, missed = self._promise(position, shape, orders)
            if error < least:
                best, least, lively = shape, error, missed
            elif error > 2.0 * least:
                break
        for shape in _more_lively(best) if lively else ():
            error, _ = self._promise(position, shape, orders)
            if error < least:
                best, least = shape, error
        return best

    def _promise(self, position: FloatArray, shape: Shape, orders: tuple[int, ...]) -> tuple[float, bool]:
        """Expected rms error of the table in cycles; True if the motion is more than the blocks follow."""
        blocks, length = self._cut(shape), shape.length
        if len(blocks) > TRIAL_SAMPLES // length:
            few = np.linspace(0, len(blocks) - 1, TRIAL_SAMPLES // length).astype(np.int64)
            blocks = blocks.take(few)
        if len(blocks) < MIN_BLOCKS or self._loss(blocks, position) > LOCKED_LOSS:
            return float("inf"), False
        fit, coarse = self._fit(blocks, position, orders)
        strict = reject(coarse, fit)
        fit = self._again(fit, strict, TRIAL_ROUNDS)
        # A block too long for the motion is rejected: what it does not tell counts as well.
        if 2 * strict.samples <= blocks.samples or self._off_cycles(fit) > MAX_OFF_CYCLES:
            return float("inf"), False
        return uncertainty(fit, self.ellipse), fit.noise.along > LIVELY_NOISE * fit.noise.across

    def _fit(
        self, blocks: Blocks, position: FloatArray, orders: tuple[int, ...] = FIRST_ORDERS
    ) -> tuple[JointFit, Blocks]:
        """First fit from tracked positions, without what is far off."""
        record = self.record
        if len(blocks) < MIN_BLOCKS:
            raise CalibrationError("too few samples in one piece", "samples")
        waveform, motion = initial_fit(blocks, record.sine, record.cosine, position, orders)
        fit = fit_jointly(blocks, record.sine, record.cosine, waveform, motion, rounds=TRIAL_ROUNDS)
        cleaned = reject(blocks, fit, coarse=True)
        fit = self._again(fit, cleaned, TRIAL_ROUNDS)
        cleaned = reject(blocks.using(blocks.used & _rows(cleaned)), fit, coarse=True)
        return self._again(fit, cleaned, TRIAL_ROUNDS), cleaned

    def _again(self, fit: JointFit, blocks: Blocks, rounds: int = 10) -> JointFit:
        record = self.record
        return fit_jointly(
            blocks, record.sine, record.cosine, fit.waveform, fit.motion, rounds=rounds, noise=fit.noise
        )

    def _find_orders(self, fit: JointFit, blocks: Blocks) -> tuple[JointFit, Blocks]:
        """More orders while the last ones carry something, then only those that stand out of the noise."""
        kept, cleaned = fit.waveform.orders, blocks
        for highest in ORDER_STEPS:
            fit = self._with_orders(fit, cleaned, tuple(range(1, highest + 1)))
            cleaned = reject(blocks, fit)
            fit = self._again(fit, cleaned)
            kept = significant_orders(fit)
            if kept[-1] <= highest * 3 // 4:
                break
        fit = self._with_orders(fit, cleaned, kept)
        cleaned = reject(blocks, fit)
        return self._again(fit, cleaned), cleaned

    def _with_orders(self, fit: JointFit, blocks: Blocks, orders: tuple[int, ...]) -> JointFit:
        record, start = self.record, fit.waveform.with_orders(orders)
        return fit_jointly(blocks, record.sine, record.cosine, start, fit.motion, noise=fit.noise)


def _more_lively(shape: Shape) -> tuple[Shape, ...]:
    """Blocks that follow more of the motion: up to a vibration at a quarter of the sampling rate."""
    length = max(shape.length, 16)
    return tuple(
        Shape(times * length, terms) for times, terms in ((1, 6), (2, 8), (2, 12), (4, 12), (4, 24), (4, 40))
    )


def uncertainty(fit: JointFit, conditioning: Conditioning) -> float:
    """Expected rms error of the table, cycles."""
    sensitivity = table_sensitivity(fit.waveform, conditioning)
    variance = np.einsum("pi,pi->p", sensitivity @ fit.covariance, sensitivity)
    return float(np.sqrt(max(0.0, float(variance.mean()))))


def significant_orders(fit: JointFit) -> tuple[int, ...]:
    """Orders whose coefficients are more than noise; the fundamental always."""
    waveform, kept = fit.waveform, [1]
    half = len(waveform.sine)
    values = np.concatenate([waveform.sine, waveform.cosine])
    for place, order in enumerate(waveform.orders):
        at = np.array([1 + 2 * place, 2 + 2 * place, half + 1 + 2 * place, half + 2 + 2 * place])
        part = fit.covariance[np.ix_(at, at)]
        size = values[at] @ np.linalg.pinv(part, hermitian=True) @ values[at]
        if order > 1 and size > SIGNIFICANT:
            kept.append(order)
    return tuple(kept)


def reject(blocks: Blocks, fit: JointFit, coarse: bool = False) -> Blocks:
    """Leave out samples far off the curve or the motion, and blocks that do not fit as a whole.

    ``coarse``: only what is far off by any measure. Before the harmonics are known, a block that
    meets all phases fits worse than one at standstill, yet it is the one that tells.
    """
    use = blocks.used
    floor = COARSE_CYCLES * float(np.median(fit.speed[use])) if coarse else 0.0
    telling = blocks.informative(blocks.evaluate(fit.motion))
    if telling.sum() < MIN_BLOCKS:
        telling = _rows(blocks)[:, 0]
    judges = use & telling[:, None]
    good: BoolArray = np.ones_like(use)
    for off in (fit.along, fit.across):
        good &= np.abs(off) < max(REJECT_SIGMAS * _sigma(off[judges]), floor)
    size = np.sqrt(np.sum(np.where(use, fit.along**2, 0.0), axis=1) / np.maximum(1, use.sum(axis=1)))
    usual = max(float(np.median(size[telling])), QUANTISATION_COUNTS)
    return blocks.using(use & good & (size < max(REJECT_BLOCK * usual, floor))[:, None])


def _sigma(values: FloatArray) -> float:
    """Robust standard deviation, not below what quantisation leaves."""
    usual = float(np.median(np.abs(values))) if len(values) else 0.0
    return max(1.4826 * usual, QUANTISATION_COUNTS)


def _rows(blocks: Blocks) -> BoolArray:
    rows: BoolArray = np.any(blocks.used, axis=1, keepdims=True)
    return rows
