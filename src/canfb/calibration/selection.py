"""Which samples, blocks and orders a fit is to keep, and what it is worth."""

from __future__ import annotations

import numpy as np

from canfb.calibration.joint import JointFit
from canfb.calibration.motion_blocks import Blocks, BoolArray
from canfb.calibration.waveform import table_sensitivity
from canfb.signal.conditioning import Conditioning
from canfb.signal.phase import FloatArray

# An order stays if its four coefficients stand out of the noise: chi^2 with four degrees of freedom.
SIGNIFICANT = 16.0
MIN_BLOCKS = 8
REJECT_SIGMAS = 6.0
REJECT_BLOCK = 4.0
QUANTISATION_COUNTS = 0.3
COARSE_CYCLES = 0.05


def uncertainty(fit: JointFit, conditioning: Conditioning) -> float:
    """Expected rms error of the table, cycles."""
    sensitivity = table_sensitivity(fit.waveform, conditioning)
    variance = np.einsum("pi,pi->p", sensitivity @ fit.covariance, sensitivity)
    return float(np.sqrt(max(0.0, float(variance.mean()))))


def significant_orders(fit: JointFit) -> tuple[int, ...]:
    """Orders whose coefficients are more than noise; the fundamental always.

    The least significant one goes first and the others are corrected for it: two that the
    samples can hardly separate would otherwise drop each other.
    """
    half, orders = len(fit.waveform.sine), fit.waveform.orders
    places = {
        order: [1 + 2 * at, 2 + 2 * at, half + 1 + 2 * at, half + 2 + 2 * at]
        for at, order in enumerate(orders)
    }
    values = np.concatenate([fit.waveform.sine, fit.waveform.cosine])
    covariance = fit.covariance.copy()
    kept = list(orders)
    while len(kept) > 1:
        sizes = {order: _size(values, covariance, places[order]) for order in kept if order > 1}
        weakest = min(sizes, key=lambda order: sizes[order])
        if sizes[weakest] > SIGNIFICANT:
            break
        kept.remove(weakest)
        at = places[weakest]
        share = covariance[:, at] @ np.linalg.pinv(covariance[np.ix_(at, at)], hermitian=True)
        values = values - share @ values[at]
        covariance = covariance - share @ covariance[at]
    return tuple(kept)


def _size(values: FloatArray, covariance: FloatArray, at: list[int]) -> float:
    """Square of these values in units of their uncertainty."""
    inverse = np.linalg.pinv(covariance[np.ix_(at, at)], hermitian=True)
    return float(values[at] @ inverse @ values[at])


def reject(blocks: Blocks, fit: JointFit, coarse: bool = False) -> Blocks:
    """Leave out samples far off the curve or the motion, and blocks that do not fit as a whole.

    ``coarse``: only what is far off by any measure. Before the harmonics are known, a block that
    meets all phases fits worse than one at standstill, yet it is the one that informs.
    """
    use = blocks.used
    floor = COARSE_CYCLES * float(np.median(fit.speed[use])) if coarse else 0.0
    telling = blocks.informative(blocks.evaluate(fit.motion))
    if telling.sum() < MIN_BLOCKS:
        telling = rows_used(blocks)[:, 0]
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


def rows_used(blocks: Blocks) -> BoolArray:
    """Blocks with samples used, as a column."""
    rows: BoolArray = np.any(blocks.used, axis=1, keepdims=True)
    return rows
