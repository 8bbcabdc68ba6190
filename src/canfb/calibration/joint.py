"""Joint least squares of both tracks over the phase and of the motion over time.

    s = S(x), c = C(x): Fourier series of the position x;  x = m(t): a polynomial in each block

The coefficients minimise, over the samples k, with the unit tangent u and normal n of the curve (S, C),

    [n . r(k)]^2 / across^2 + [u . r(k)]^2 / along^2,    r(k) = (s(k) - S(x), c(k) - C(x)),  x = m(t(k))

since both residuals contain the noise of the converter, the second also the motion that the polynomials do
not follow. A step of Gauss-Newton solves

    [ N   B' ] [dw]   [a]
    [ B   D  ] [dm] = [b]      D: one small matrix for each block

with D eliminated: (N - B' D^-1 B) dw = a - B' D^-1 b, dm = D^-1 (b - B dw). The inverse of the reduced matrix
is the covariance of the series with the motion unknown. The data does not determine phase 0: it is held, by
excluding changes of the series along its slope.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from canfb.calibration.recording import Blocks, solve_blocks
from canfb.calibration.result import Reason, root_mean
from canfb.errors import CalibrationError
from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.signal.correction import MAX_DEVIATION_CYCLES, CorrectionTable
from canfb.signal.phase import BoolArray, ComplexArray, FloatArray, raw_phases

CHUNK_SAMPLES = 8192  # keeps the temporaries in the processor's cache
# The fit ends with a step below this part of the rms deviation: it changes the sum of squares by < 1e-4.
CONVERGED = 1e-2
# Over 0.1 cycle the tangent of a sine differs by 7 % from its chord; beyond 0.25 its sign is wrong.
LARGEST_STEP_CYCLES = 0.1


@dataclass(frozen=True, eq=False)
class Noise:
    """Rms noise in counts across the curve, and along it, where motion that is not fitted adds to it."""

    across: float
    along: float


@dataclass(frozen=True, eq=False)
class JointFit:
    """Result of :func:`fit_jointly`.

    blocks            samples fitted
    waveform, motion  both tracks; coefficients of the polynomials, (blocks, terms), cycles
    along, across     residuals in counts, (blocks, length); noise: estimated from samples used
    speed             length of the curve's tangent, counts per cycle, (blocks, length)
    information       inverse of :attr:`covariance`, with phase 0 held
    """

    blocks: Blocks
    waveform: Waveform
    motion: FloatArray
    along: FloatArray
    across: FloatArray
    speed: FloatArray
    noise: Noise
    information: FloatArray

    @cached_property
    def covariance(self) -> FloatArray:
        """Covariance of the coefficients (sine, then cosine), counts^2; computed on demand."""
        return inverse(self.information)

    @property
    def position(self) -> FloatArray:
        return self.blocks.evaluate(self.motion)

    @property
    def informative(self) -> BoolArray:
        return self.blocks.informative(self.position)

    @property
    def noise_counts(self) -> float:
        return min(self.noise.across, self.noise.along)

    @property
    def noise_cycles(self) -> float:
        return self.noise.along / float(np.sqrt(np.mean(self.speed**2)))


def initial_waveform(blocks: Blocks, motion: FloatArray, orders: tuple[int, ...]) -> Waveform:
    columns = basis(blocks.evaluate(motion)[blocks.used], orders)
    solution = np.linalg.lstsq(columns, blocks.tracks[:, blocks.used].T, rcond=None)[0]
    return Waveform(orders, np.asarray(solution.T, np.float64))


def fit_jointly(
    blocks: Blocks,
    waveform: Waveform,
    motion: FloatArray,
    rounds: int = 8,
    noise: Noise | None = None,
) -> JointFit:
    """Least squares with these initial values; ``noise`` weights the two kinds of equation (None: equal)."""
    weigh = noise or Noise(1.0, 1.0)
    for _ in range(rounds):
        system = _System(blocks, waveform, motion, weigh)
        waveform, motion, step = system.step()
        if step < CONVERGED * root_mean((system.along / system.speed)[blocks.used]):
            # The step is so small that the residuals before it are also those after it.
            return system.result(waveform, motion)
    return _System(blocks, waveform, motion, weigh).result(waveform, motion)


def bound_covariance(fit: JointFit) -> FloatArray:
    """Cramer-Rao bound: least covariance that any estimate can have if noise were white.

    Calculated for the noise on each track, samples, motion and orders of ``fit``.
    """
    system = _System(fit.blocks, fit.waveform, fit.motion, Noise(fit.noise_counts, fit.noise_counts))
    return inverse(system.held(system.reduced))


def information_loss(blocks: Blocks, waveform: Waveform, motion: FloatArray) -> float:
    """Uncertainty of the tracks with unknown motion / with known motion.

    Little above 1 if every block contains all phases, large if motion could explain the shape of the tracks.
    """
    system = _System(blocks, waveform, motion, Noise(1.0, 1.0))
    sensitivity = table_sensitivity(waveform, IDENTITY)
    with_motion, without = (
        table_variance(sensitivity, inverse(system.held(one))).sum()
        for one in (system.reduced, system.normal)
    )
    return float(np.sqrt(with_motion / without))


class _System:
    def __init__(self, blocks: Blocks, waveform: Waveform, motion: FloatArray, noise: Noise) -> None:
        self.blocks, self.waveform, self.motion, self.noise = blocks, waveform, motion, noise
        self.slope = waveform.slope()
        size = waveform.coefficients.size
        self.normal, self.right = np.zeros((size, size)), np.zeros(size)
        shape = blocks.index.shape
        self.along, self.across, self.speed = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        self.cross = np.zeros((len(blocks), blocks.coefficients, size))
        self.inner = np.zeros((len(blocks), blocks.coefficients, blocks.coefficients))
        self.inner_right = np.zeros((len(blocks), blocks.coefficients))
        rows = max(1, CHUNK_SAMPLES // shape[1])
        for start in range(0, len(blocks), rows):
            self._add(slice(start, start + rows))
        # Eliminate the motion: `reduced` is the information on the tracks alone.
        solved = solve_blocks(self.inner, np.concatenate([self.cross, self.inner_right[..., None]], axis=2))
        self.solved_cross, self.solved_right = solved[..., :-1], solved[..., -1]
        flat = self.cross.reshape(-1, size)
        self.reduced = self.normal - flat.T @ self.solved_cross.reshape(-1, size)
        self.reduced_right = self.right - flat.T @ self.solved_right.reshape(-1)

    def _add(self, part: slice) -> None:
        blocks = self.blocks
        used, terms = blocks.used[part], blocks.terms[part]
        position = np.matmul(terms, self.motion[part][..., None])[..., 0]
        columns = basis(position, self.waveform.orders)
        slope_s, slope_c = self.slope.over(columns)
        off_s, off_c = blocks.tracks[:, part] - self.waveform.over(columns)
        speed = np.hypot(slope_s, slope_c)
        turn_s, turn_c = slope_s / speed, slope_c / speed
        along, across = off_s * turn_s + off_c * turn_c, off_c * turn_s - off_s * turn_c
        self.along[part], self.across[part], self.speed[part] = along, across, speed
        weight_along, weight_across = self._weights(speed, used)
        # Factors of the columns: (turn_s, turn_c) along the curve, (-turn_c, turn_s) across it.
        self._add_tracks(
            columns.reshape(-1, columns.shape[-1]),
            (weight_along * turn_s**2 + weight_across * turn_c**2).ravel(),
            ((weight_along - weight_across) * turn_s * turn_c).ravel(),
            (weight_along * turn_c**2 + weight_across * turn_s**2).ravel(),
        )
        pull_along, pull_across = weight_along * along, weight_across * across
        self.right += np.concatenate(
            [
                np.tensordot(pull_along * turn_s - pull_across * turn_c, columns, 2),
                np.tensordot(pull_along * turn_c + pull_across * turn_s, columns, 2),
            ]
        )
        turned = (terms * (speed * weight_along)[..., None]).transpose(0, 2, 1)
        half = columns.shape[-1]
        self.cross[part, :, :half] = np.matmul(turned * turn_s[:, None], columns)
        self.cross[part, :, half:] = np.matmul(turned * turn_c[:, None], columns)
        self.inner[part] = np.matmul(turned, terms * speed[..., None])
        self.inner_right[part] = np.matmul(turned, along[..., None])[..., 0]

    def _add_tracks(self, columns: FloatArray, ss: FloatArray, sc: FloatArray, cc: FloatArray) -> None:
        # A' A takes half the time of A' B, which follows from three of them. No weight is negative: the third
        # is weight_along (turn_s + turn_c)^2 + weight_across (turn_s - turn_c)^2.
        s, c, both = (_gram(columns, weight) for weight in (ss, cc, ss + cc + 2.0 * sc))
        mixed = (both - s - c) / 2.0
        self.normal += np.block([[s, mixed], [mixed, c]])

    def _weights(self, speed: FloatArray, used: BoolArray) -> tuple[FloatArray, FloatArray]:
        across, along = self.noise.across**2, self.noise.along**2
        # Noise of the converter is constant in counts, noise of the motion in cycles.
        motion = max(0.0, along - across) * speed**2 / np.mean(speed**2)
        return used / (min(along, across) + motion), used / across

    def held(self, matrix: FloatArray) -> FloatArray:
        # The data does not determine phase 0, which shifts the coefficients along their slope: hold it.
        origin = self.slope.coefficients.ravel() / np.linalg.norm(self.slope.coefficients)
        size = float(np.trace(matrix)) / len(matrix)
        return np.asarray(matrix + size * np.outer(origin, origin), np.float64)

    def step(self) -> tuple[Waveform, FloatArray, float]:
        change = np.linalg.lstsq(self.held(self.reduced), self.reduced_right, rcond=1e-14)[0]
        motion = self.solved_right - self.solved_cross @ change
        moved = np.abs(motion).sum(axis=1)
        step = float(np.quantile(moved, 0.9)) if len(moved) else 0.0
        # Limit the step of a block with bad initial values, which must not disturb the others.
        motion *= np.minimum(1.0, LARGEST_STEP_CYCLES / np.maximum(moved, 1e-30))[:, None]
        old = self.waveform.coefficients
        return Waveform(self.waveform.orders, old + change.reshape(old.shape)), self.motion + motion, step

    def result(self, waveform: Waveform, motion: FloatArray) -> JointFit:
        blocks, use, size = self.blocks, self.blocks.used, len(self.right)
        across = np.sqrt(np.sum(self.across[use] ** 2) / max(1.0, blocks.samples - size / 2.0))
        along = np.sqrt(np.sum(self.along[use] ** 2) / max(1.0, blocks.freedom - size / 2.0))
        noise = Noise(max(float(across), 1e-9), max(float(along), 1e-9))
        # The weights assumed `self.noise`: scale the information to the noise found.
        scale = max((noise.along / self.noise.along) ** 2, (noise.across / self.noise.across) ** 2)
        return JointFit(
            blocks,
            waveform,
            motion,
            self.along,
            self.across,
            self.speed,
            noise,
            self.held(self.reduced) / scale,
        )


def inverse(information: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.pinv(information, rcond=1e-14, hermitian=True), np.float64)


def _gram(columns: FloatArray, weight: FloatArray) -> FloatArray:
    weighted = columns * np.sqrt(np.maximum(weight, 0.0))[:, None]
    return np.asarray(weighted.T @ weighted, np.float64)


GRID = 16384
# Margin for rounding the entries to REAL32.
LARGEST_DEVIATION = MAX_DEVIATION_CYCLES - 1e-3


def basis(position: FloatArray, orders: tuple[int, ...]) -> FloatArray:
    """Columns 1, cos 2 pi h x, sin 2 pi h x for each order h.

    ``position`` in cycles, any shape; the columns are the last axis.
    """
    angle = 2.0 * np.pi * (position - np.floor(position)).ravel()
    turn = np.cos(angle) + 1j * np.sin(angle)
    columns = np.empty((position.size, 1 + 2 * len(orders)))
    columns[:, 0] = 1.0
    power, reached = np.ones_like(turn), 0
    for place, order in enumerate(orders):
        for _ in range(order - reached):
            power *= turn
        reached = order
        columns[:, 1 + 2 * place], columns[:, 2 + 2 * place] = power.real, power.imag
    return columns.reshape(*position.shape, columns.shape[1])


@dataclass(frozen=True, eq=False)
class Waveform:
    """Mean tracks in ADC counts over the phase.

    orders         harmonics kept, ascending, 1 first
    coefficients   mean, then cosine and sine part of each order; rows: sine track, cosine track
    """

    orders: tuple[int, ...]
    coefficients: FloatArray

    def over(self, columns: FloatArray) -> FloatArray:
        """Both tracks, given the columns of :func:`basis`."""
        return np.array([columns @ track for track in self.coefficients])

    def tracks(self, position: FloatArray) -> FloatArray:
        return self.over(basis(position, self.orders))

    def slope(self) -> Waveform:
        per_cycle, slope = 2.0 * np.pi * np.array(self.orders), np.zeros_like(self.coefficients)
        slope[:, 1::2] = per_cycle * self.coefficients[:, 2::2]
        slope[:, 2::2] = -per_cycle * self.coefficients[:, 1::2]
        return Waveform(self.orders, slope)

    def with_orders(self, orders: tuple[int, ...]) -> Waveform:
        every = np.zeros((2, 2 + 2 * max(*self.orders, *orders)))
        every[:, _places(self.orders)] = self.coefficients
        return Waveform(orders, every[:, _places(orders)])


def _places(orders: tuple[int, ...]) -> list[int]:
    """Indices of the coefficients of these orders in a series of all orders, the mean first."""
    return [0, *(place for order in orders for place in (2 * order - 1, 2 * order))]


def series_of(spectrum: ComplexArray, orders: tuple[int, ...]) -> Waveform:
    """Waveform of the Fourier coefficients of order 0 and these orders, shape (2, 1 + orders), sine first."""
    parts = np.empty((2, 1 + 2 * len(orders)))
    parts[:, 0] = spectrum[:, 0].real
    parts[:, 1::2], parts[:, 2::2] = 2.0 * spectrum[:, 1:].real, -2.0 * spectrum[:, 1:].imag
    return Waveform(orders, parts)


def grid_phases(points: int = GRID) -> FloatArray:
    return np.arange(points + 1) / points


def raw_phase_curve(waveform: Waveform, conditioning: Conditioning) -> FloatArray:
    """Raw phase of the waveform at :func:`grid_phases`, continuous, strictly increasing, one cycle long.

    Raises CalibrationError ("monotonic") where raw phase does not determine the phase.
    """
    raw = np.unwrap(raw_phases(*conditioning.apply(*waveform.tracks(grid_phases()))), period=1.0)
    if np.isnan(raw).any() or abs(raw[-1] - raw[0] - 1.0) > 1e-6 or np.diff(raw).min() <= 0.0:
        raise CalibrationError(
            "raw phase does not rise through the cycle: the tracks do not circle the origin once. "
            'Fit the ellipse first (conditioning="fit"), and check the tracks',
            Reason.MONOTONIC,
        )
    return raw


def phase_at_raw(raw_curve: FloatArray, raw: FloatArray) -> FloatArray:
    """Phase on a curve of :func:`raw_phase_curve` at raw phases 0..1, continuous."""
    # The difference phase - raw is periodic.
    off = grid_phases(len(raw_curve) - 1) + np.floor(raw_curve[0]) - raw_curve
    return np.asarray(raw + np.interp(raw, raw_curve[:-1], off[:-1], period=1.0), np.float64)


def origin_of(raw_curve: FloatArray) -> float:
    """Phase on a curve of :func:`raw_phase_curve` at raw phase 0, the positive zero crossing of the sine."""
    return float(phase_at_raw(raw_curve, np.zeros(1))[0])


def table_of(raw_curve: FloatArray, entries: int) -> CorrectionTable:
    return table_from_phases(phase_at_raw(raw_curve, np.arange(entries) / entries) - origin_of(raw_curve))


def table_from_phases(phase: FloatArray) -> CorrectionTable:
    """Table with these entries, phase 0 at raw phase 0.

    If an entry is further than 0.25 cycle from its raw phase, all are shifted, by the least amount that
    helps. CalibrationError ("monotonic") if none does.
    """
    deviation = phase - np.arange(len(phase)) / len(phase)
    low, high = float(deviation.min()), float(deviation.max())
    if high - low > 2.0 * LARGEST_DEVIATION:
        raise CalibrationError(
            "raw phase and phase differ by more than 0.25 cycle: too much for a table. "
            'Fit the ellipse first (conditioning="fit")',
            Reason.MONOTONIC,
        )
    shift = min(0.0, LARGEST_DEVIATION - high) + max(0.0, -LARGEST_DEVIATION - low)
    try:
        return CorrectionTable(phase + shift)
    except ValueError as error:
        raise CalibrationError(f"the measurement gives no usable table: {error}", Reason.MONOTONIC) from None


def table_sensitivity(waveform: Waveform, conditioning: Conditioning, points: int = 256) -> FloatArray:
    """Change of the table per change of each coefficient, shape (points, coefficients), mean removed.

    At a given raw phase only the component of a track error across the ray from the origin counts:
    it moves the point where the curve crosses that ray.
    """
    columns = basis(np.arange(points) / points, waveform.orders)
    s, c = conditioning.apply(*waveform.over(columns))
    slope_s, slope_c = waveform.slope().over(columns)
    _, gain_s, _, factor_c, skew = conditioning.coefficients()
    slope_s = gain_s * slope_s
    slope_c = factor_c * slope_c - skew * slope_s
    across = slope_s * c - slope_c * s
    by_sine = gain_s * (c + skew * s) / across
    by_cosine = -factor_c * s / across
    sensitivity = -np.concatenate([by_sine[:, None] * columns, by_cosine[:, None] * columns], axis=1)
    return np.asarray(sensitivity - sensitivity.mean(axis=0), np.float64)


def table_variance(sensitivity: FloatArray, covariance: FloatArray) -> FloatArray:
    variance = np.einsum("pi,pi->p", sensitivity @ covariance, sensitivity)
    return np.asarray(np.maximum(variance, 0.0), np.float64)
