"""From a recording to the joint fit (:mod:`.joint`): positions, length of the blocks, orders, faults.

1. Take positions from the arc tangent after the ellipse; fit orders 1 to 6.
2. Choose the block length with the least expected error of the table; else polynomials of higher degree.
3. Add orders while the upper quarter of them is significant; leave out samples that do not fit.
4. Take positions again from the phases on the fitted curve, and repeat 3.
5. Keep orders whose four coefficients v have v' C^-1 v > 16, which noise alone exceeds in 0.3 % of cases.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from canfb.calibration.ellipse import angle_cycles
from canfb.calibration.joint import (
    JointFit,
    Waveform,
    fit_jointly,
    grid_phases,
    information_loss,
    initial_waveform,
    phase_at_raw,
    table_sensitivity,
    table_variance,
)
from canfb.calibration.recording import CUBIC, MIN_SAMPLES, Blocks, Recording
from canfb.calibration.result import (
    LOCKED_LOSS,
    MAX_OFF_CYCLES,
    Reason,
    check_distance,
    coverage,
    no_fit,
    robust_rms,
    root_mean,
)
from canfb.errors import CalibrationError
from canfb.signal.conditioning import Conditioning
from canfb.signal.phase import BoolArray, FloatArray


class Shape(NamedTuple):
    """Length of the blocks in samples, coefficients of the motion in each."""

    length: int
    terms: int


FIRST_ORDERS = tuple(range(1, 7))
ORDER_STEPS = (16, 32)
SAMPLES_PER_ORDER = 30
STIFF = tuple(Shape(length, CUBIC) for length in (12, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096))
# Ratio of the noise along the curve to that across it. Noise alone gives 1 +- 0.011 in a trial; 1.15 means
# that the motion the blocks do not follow is sqrt(1.15^2 - 1) = 0.57 of the noise.
LIVELY_NOISE = 1.15
# Largest ratio of the uncertainty with all orders to that with the significant ones, for noise alone.
MOST_UNDETERMINED = 5.0
# Largest ratio of the uncertainty with all orders to the one that well-spread phases would give.
INSEPARABLE = 20.0
DISTANCE_SAMPLES = 64
# Samples that suffice to choose the block length.
TRIAL_SAMPLES = 8000
TRIAL_ROUNDS = 4


class Start(NamedTuple):
    """Tracked positions of all samples, cycles, and their tracks, if known."""

    position: FloatArray
    waveform: Waveform | None


class Solution(NamedTuple):
    """Result of :meth:`Solver.solve`.

    loss          factor by which the unknown motion increases the uncertainty
    undetermined  uncertainty of the table, cycles, by orders neither significant nor ruled out; else 0
    """

    fit: JointFit
    loss: float
    undetermined: float


Progress = Callable[[float], None]


def no_progress(_: float) -> None:
    """Report nothing."""


@dataclass(frozen=True, eq=False)
class Solver:
    """The search for tracks and motion. ``ellipse`` converts the tracks to a rough circle
    of radius ``amplitude_counts``.
    """

    record: Recording
    ellipse: Conditioning
    amplitude_counts: float
    report: Progress

    def solve(self, angle: FloatArray) -> Solution:
        """Fit tracks and motion, from the ellipse's ``angle`` (cycles) on. CalibrationError if none fit."""
        first = Start(self.record.positions(angle), None)
        seen = first.position[self.record.valid][::DISTANCE_SAMPLES]
        check_distance(coverage(angle[self.record.valid]), float(np.ptp(seen)))
        shape, lively = self._choose_shape(first, STIFF)
        self.report(0.3)
        fit = self._fit(self.record.cut(*shape), first)
        loss = self._loss(fit.blocks, first.position)
        if (off := self._off_cycles(fit)) > MAX_OFF_CYCLES:
            raise no_fit(f"the positions are {off:.2f} cycle rms away from any smooth motion", loss)
        fit = self._more_orders(fit)
        self.report(0.5)
        many = significant_orders(fit)[-1] > FIRST_ORDERS[-1]
        if many or lively or self.record.uneven or fit.blocks.samples < int(self.record.valid.sum()):
            # Corrected phases determine the speed better and follow the motion where the first ones lost
            # it; errors that orders 1 to 6 left looked like motion.
            better = self._start(angle, fit.waveform)
            if many or lively:
                shape = self._choose_again(better, shape)
            fit = self._more_orders(self._fit(self.record.cut(*shape), better))
        self.report(0.7)
        all_orders = uncertainty(fit, self.ellipse)
        mixed = fit.noise_cycles * float(np.sqrt(len(fit.information) / fit.blocks.samples))
        if all_orders > INSEPARABLE * mixed:
            raise no_fit("the samples have too few different phases to separate the harmonics", np.inf)
        few = _with_orders(fit, significant_orders(fit))
        fit = _again(few, reject(fit.blocks, few))
        undetermined = all_orders if all_orders > MOST_UNDETERMINED * uncertainty(fit, self.ellipse) else 0.0
        off = max(self._off_cycles(fit), fit.noise.across / (2.0 * np.pi * self.amplitude_counts))
        telling = fit.blocks.used[fit.informative].sum()
        if self._curve(fit.waveform) is None or off > MAX_OFF_CYCLES or telling < MIN_SAMPLES:
            raise no_fit("tracks and motion cannot be separated", loss)
        longer = self.record.cut(2 * shape.length, shape.terms)
        if fit.noise.along > LIVELY_NOISE * fit.noise.across and len(longer) >= MIN_BLOCKS:
            # Motion that the blocks do not follow is not white noise: longer blocks show its effect on the
            # tracks.
            other = self._fit(longer, self._start(angle, fit.waveform)).waveform
            change = (other.coefficients - fit.waveform.coefficients).ravel()
            moved = root_mean(table_sensitivity(fit.waveform, self.ellipse) @ change)
            undetermined = max(undetermined, moved)
        return Solution(fit, loss, undetermined)

    def _off_cycles(self, fit: JointFit) -> float:
        return fit.noise.along / (2.0 * np.pi * self.amplitude_counts)

    def _loss(self, blocks: Blocks, position: FloatArray) -> float:
        circle = np.zeros((2, 1 + 2 * len(FIRST_ORDERS)))
        circle[0, 2] = circle[1, 1] = self.amplitude_counts
        return information_loss(blocks, Waveform(FIRST_ORDERS, circle), blocks.smooth(position[blocks.index]))

    def _start(self, angle: FloatArray, waveform: Waveform) -> Start:
        curve = self._curve(waveform)
        if curve is None:
            return Start(self.record.positions(angle), None)
        return Start(self.record.positions(phase_at_raw(curve, angle) % 1.0 % 1.0), waveform)

    def _curve(self, waveform: Waveform) -> FloatArray | None:
        curve = np.unwrap(angle_cycles(self.ellipse, *waveform.tracks(grid_phases())), period=1.0)
        rises = abs(curve[-1] - curve[0] - 1.0) < 1e-6 and np.diff(curve).min() > 0.0
        return curve if rises else None

    def _choose_shape(self, start: Start, shapes: tuple[Shape, ...]) -> tuple[Shape, bool]:
        """The shape with the least expected error: long, stiff blocks average more, others follow the motion.

        Also whether its blocks fail to follow the motion.
        """
        best, least, lively = shapes[0], np.inf, True
        for shape in shapes:
            error, missed = self._promise(start, shape)
            if error < least:
                best, least, lively = shape, error, missed
            elif error > 2.0 * least and shape.terms == CUBIC:
                break
        if least == np.inf and shapes is STIFF:
            return self._choose_shape(start, _more_lively(STIFF[1]))
        return best, lively

    def _choose_again(self, start: Start, shape: Shape) -> Shape:
        near = tuple(one for one in STIFF if shape.length / 2 <= one.length <= shape.length * 2)
        best, lively = self._choose_shape(start, (shape,) if shape.terms > CUBIC else near)
        return self._choose_shape(start, (best, *_more_lively(best)))[0] if lively else best

    def _promise(self, start: Start, shape: Shape) -> tuple[float, bool]:
        """Expected rms error of the table in cycles; True if the blocks do not follow the motion."""
        blocks, length = self.record.cut(*shape), shape.length
        if len(blocks) > TRIAL_SAMPLES // length:
            few = np.linspace(0, len(blocks) - 1, TRIAL_SAMPLES // length).astype(np.int64)
            blocks = blocks.take(few)
        if len(blocks) < MIN_BLOCKS or self._loss(blocks, start.position) > LOCKED_LOSS:
            return float("inf"), False
        fit = self._fit(blocks, start)
        strict = reject(fit.blocks, fit)
        # Blocks too long for the motion are rejected; a shape that loses half of the samples is unsuitable.
        if 2 * strict.samples <= blocks.samples:
            return float("inf"), False
        fit = _again(fit, strict, TRIAL_ROUNDS)
        if self._off_cycles(fit) > MAX_OFF_CYCLES:
            return float("inf"), False
        return uncertainty(fit, self.ellipse), fit.noise.along > LIVELY_NOISE * fit.noise.across

    def _fit(self, blocks: Blocks, start: Start) -> JointFit:
        if len(blocks) < MIN_BLOCKS:
            raise CalibrationError("too few contiguous samples", Reason.SAMPLES)
        motion, waveform = blocks.smooth(start.position[blocks.index]), start.waveform
        if waveform is None:
            waveform = initial_waveform(blocks, motion, FIRST_ORDERS)
        fit = fit_jointly(blocks, waveform, motion, rounds=TRIAL_ROUNDS)
        cleaned = reject(blocks, fit, coarse=True)
        fit = _again(fit, cleaned, TRIAL_ROUNDS)
        if cleaned.samples == blocks.samples:
            return fit
        cleaned = reject(
            blocks.using(blocks.used & cleaned.used.any(axis=1, keepdims=True)), fit, coarse=True
        )
        return _again(fit, cleaned, TRIAL_ROUNDS)

    def _more_orders(self, fit: JointFit) -> JointFit:
        blocks = fit.blocks
        for step in ORDER_STEPS:
            highest = max(FIRST_ORDERS[-1], min(step, fit.blocks.samples // SAMPLES_PER_ORDER))
            if highest > fit.waveform.orders[-1]:
                fit = _with_orders(fit, tuple(range(1, highest + 1)))
            fit = _again(fit, reject(blocks, fit))
            if significant_orders(fit)[-1] <= highest * 3 // 4:
                break
        return fit


def _again(fit: JointFit, blocks: Blocks, rounds: int = 10) -> JointFit:
    return fit_jointly(blocks, fit.waveform, fit.motion, rounds=rounds, noise=fit.noise)


def _with_orders(fit: JointFit, orders: tuple[int, ...]) -> JointFit:
    return fit_jointly(fit.blocks, fit.waveform.with_orders(orders), fit.motion, noise=fit.noise)


def _more_lively(shape: Shape) -> tuple[Shape, ...]:
    length = max(shape.length, 16)
    return tuple(
        Shape(times * length, terms) for times, terms in ((1, 6), (2, 8), (2, 12), (4, 12), (4, 24), (4, 40))
    )


SIGNIFICANT = 16.0  # v' C^-1 v above which an order is kept (step 5)
MIN_BLOCKS = 8
REJECT_SIGMAS = 6.0  # noise alone exceeds these once in 5e8 samples
REJECT_BLOCK = 4.0
QUANTISATION_COUNTS = 0.3  # rms of rounding, 1/sqrt(12)
COARSE_CYCLES = 0.05


def uncertainty(fit: JointFit, conditioning: Conditioning) -> float:
    sensitivity = table_sensitivity(fit.waveform, conditioning)
    return float(np.sqrt(table_variance(sensitivity, fit.covariance).mean()))


def significant_orders(fit: JointFit) -> tuple[int, ...]:
    """Orders whose coefficients exceed noise; always the fundamental.

    The least significant order is dropped first and the others corrected for it: of two orders that the
    samples hardly separate, one remains.
    """
    orders, values, covariance = fit.waveform.orders, fit.waveform.coefficients.ravel(), fit.covariance
    half = len(values) // 2
    places = {
        order: [1 + 2 * at, 2 + 2 * at, half + 1 + 2 * at, half + 2 + 2 * at]
        for at, order in enumerate(orders)
    }
    kept = [order for order in orders if order > 1]
    while kept:
        at = np.array([places[order] for order in kept])
        inverses = np.linalg.pinv(covariance[at[:, :, None], at[:, None, :]], hermitian=True)
        sizes = np.einsum("ki,kij,kj->k", values[at], inverses, values[at])
        weakest = int(sizes.argmin())
        if sizes[weakest] > SIGNIFICANT:
            break
        del kept[weakest]
        share = covariance[:, at[weakest]] @ inverses[weakest]
        values = values - share @ values[at[weakest]]
        covariance = covariance - share @ covariance[at[weakest]]
    return (1, *kept)


def reject(blocks: Blocks, fit: JointFit, coarse: bool = False) -> Blocks:
    """Leave out samples far off the curve or the motion, and blocks that do not fit as a whole.

    ``coarse``: only beyond COARSE_CYCLES as well, because without harmonics informative blocks fit worse
    than standstill.
    """
    use = blocks.used
    floor = COARSE_CYCLES * float(np.median(fit.speed[use])) if coarse else 0.0
    telling = fit.informative
    if telling.sum() < MIN_BLOCKS:
        telling = np.asarray(use.any(axis=1), np.bool_)
    judges = use & telling[:, None]
    good: BoolArray = np.ones_like(use)
    for off in (fit.along, fit.across):
        sigma = max(robust_rms(off[judges]), QUANTISATION_COUNTS)
        good &= np.abs(off) < max(REJECT_SIGMAS * sigma, floor)
    size = np.sqrt(np.sum(np.where(use, fit.along**2, 0.0), axis=1) / np.maximum(1, use.sum(axis=1)))
    usual = max(float(np.median(size[telling])), QUANTISATION_COUNTS)
    return blocks.using(use & good & (size < max(REJECT_BLOCK * usual, floor))[:, None])
