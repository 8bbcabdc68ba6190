"""Joint least squares of both tracks over the phase and of the motion over time.

The samples follow s = S(x), c = C(x) with S and C Fourier series and the position x a
polynomial of time in each block. Every sample gives two equations, one along the curve of
the tracks and one across it. Noise of the converter is in both, what the polynomials miss
of the motion (vibration) only in the one along the curve, so the two are weighed apart.
Gauss-Newton; the blocks' coefficients are eliminated, so the system that remains has only
the coefficients of the two series. Its inverse is the covariance of the result.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from canfb.calibration.blocks import TERMS, Blocks, BoolArray, solve_blocks
from canfb.calibration.waveform import Waveform, basis
from canfb.signal.phase import FloatArray

CHUNK_SAMPLES = 8192  # keeps the temporaries in the processor's cache
CONVERGED_CYCLES = 2e-8
LARGEST_STEP_CYCLES = 0.1


@dataclass(frozen=True, eq=False)
class Noise:
    """Rms in counts: across the curve, and along it (where the motion's is added)."""

    across: float
    along: float


@dataclass(frozen=True, eq=False)
class JointFit:
    """Result of :func:`fit_jointly`.

    waveform     both tracks
    motion       coefficients of the polynomials, (blocks, TERMS); positions in cycles
    along/across residuals in counts, (blocks, length)
    speed        length of the curve's tangent, counts per cycle, (blocks, length)
    noise        estimated from the residuals of the samples used
    covariance   of the coefficients (sine, then cosine), counts^2; the phase's origin is held
    known_motion the same if the motion were known: what its elimination cost
    """

    waveform: Waveform
    motion: FloatArray
    along: FloatArray
    across: FloatArray
    speed: FloatArray
    noise: Noise
    covariance: FloatArray
    known_motion: FloatArray

    @property
    def noise_cycles(self) -> float:
        """Rms deviation of single samples from the smooth motion, cycles."""
        return self.noise.along / float(np.sqrt(np.mean(self.speed**2)))


def initial_fit(
    blocks: Blocks, sine: FloatArray, cosine: FloatArray, position: FloatArray, orders: tuple[int, ...]
) -> tuple[Waveform, FloatArray]:
    """First values: polynomials through the tracked positions, tracks by least squares over them."""
    motion = blocks.smooth(position[blocks.index])
    use = blocks.used
    columns, _ = basis(blocks.evaluate(motion)[use], orders)
    both = np.column_stack([sine[blocks.index][use], cosine[blocks.index][use]])
    solution = np.asarray(np.linalg.lstsq(columns, both, rcond=None)[0], np.float64)
    return Waveform(orders, solution[:, 0], solution[:, 1]), motion


def fit_jointly(
    blocks: Blocks,
    sine: FloatArray,
    cosine: FloatArray,
    waveform: Waveform,
    motion: FloatArray,
    rounds: int = 8,
    noise: Noise | None = None,
) -> JointFit:
    """Least squares from these first values; ``noise`` weighs the two kinds of equation (None: equal)."""
    weigh = noise or Noise(1.0, 1.0)
    for _ in range(rounds):
        system = _System(blocks, sine, cosine, waveform, motion, weigh)
        waveform, motion, step = system.step()
        if step < CONVERGED_CYCLES:
            break
    return _System(blocks, sine, cosine, waveform, motion, weigh).result()


def bound_covariance(
    blocks: Blocks, sine: FloatArray, cosine: FloatArray, fit: JointFit, noise_counts: float
) -> FloatArray:
    """Cramer-Rao bound: least covariance that any estimate can have if noise were white.

    For noise of ``noise_counts`` rms on each track, these samples, this motion and the orders of ``fit``.
    """
    noise = Noise(noise_counts, noise_counts)
    return _System(blocks, sine, cosine, fit.waveform, fit.motion, noise).covariance()


class _System:
    """Normal equations at one point, the blocks' coefficients eliminated."""

    def __init__(
        self,
        blocks: Blocks,
        sine: FloatArray,
        cosine: FloatArray,
        waveform: Waveform,
        motion: FloatArray,
        noise: Noise,
    ) -> None:
        self.blocks, self.waveform, self.motion, self.noise = blocks, waveform, motion, noise
        size = 2 * len(waveform.sine)
        self.normal, self.right = np.zeros((size, size)), np.zeros(size)
        shape = blocks.index.shape
        self.along, self.across, self.speed = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        self.cross = np.zeros((len(blocks), TERMS, size))
        self.inner = np.zeros((len(blocks), TERMS, TERMS))
        self.inner_right = np.zeros((len(blocks), TERMS))
        rows = max(1, CHUNK_SAMPLES // shape[1])
        for start in range(0, len(blocks), rows):
            self._add(slice(start, start + rows), sine, cosine)
        # Blocks eliminated: what remains says how well the tracks themselves are known.
        solved = solve_blocks(self.inner, np.concatenate([self.cross, self.inner_right[..., None]], axis=2))
        self.solved_cross, self.solved_right = solved[..., :-1], solved[..., -1]
        flat = self.cross.reshape(-1, size)
        self.reduced = self.normal - flat.T @ self.solved_cross.reshape(-1, size)
        self.reduced_right = self.right - flat.T @ self.solved_right.reshape(-1)

    def _add(self, part: slice, sine: FloatArray, cosine: FloatArray) -> None:
        blocks = self.blocks
        index, used, terms = blocks.index[part], blocks.used[part], blocks.terms[part]
        position = np.matmul(terms, self.motion[part][..., None])[..., 0]
        columns, slopes = basis(position, self.waveform.orders)
        slope_s, slope_c = slopes @ self.waveform.sine, slopes @ self.waveform.cosine
        off_s = sine[index] - columns @ self.waveform.sine
        off_c = cosine[index] - columns @ self.waveform.cosine
        speed = np.hypot(slope_s, slope_c)
        turn_s, turn_c = slope_s / speed, slope_c / speed
        along, across = off_s * turn_s + off_c * turn_c, off_c * turn_s - off_s * turn_c
        self.along[part], self.across[part], self.speed[part] = along, across, speed
        weight_along, weight_across = self._weights(speed, used)
        # Roots of the weights go into the rows, so that each product is one matrix product.
        turn_s, turn_c = turn_s[..., None], turn_c[..., None]
        rows_along = np.concatenate([turn_s * columns, turn_c * columns], axis=2) * weight_along[..., None]
        rows_across = np.concatenate([-turn_c * columns, turn_s * columns], axis=2) * weight_across[..., None]
        rows_motion = terms * (speed * weight_along)[..., None]
        along, across = along * weight_along, across * weight_across
        size = rows_along.shape[2]
        flat_along, flat_across = rows_along.reshape(-1, size), rows_across.reshape(-1, size)
        self.normal += flat_along.T @ flat_along + flat_across.T @ flat_across
        self.right += flat_along.T @ along.ravel() + flat_across.T @ across.ravel()
        turned = rows_motion.transpose(0, 2, 1)
        self.cross[part] = np.matmul(turned, rows_along)
        self.inner[part] = np.matmul(turned, rows_motion)
        self.inner_right[part] = np.matmul(turned, along[..., None])[..., 0]

    def _weights(self, speed: FloatArray, used: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Inverse standard deviations along and across the curve, zero for samples left out."""
        across, along = self.noise.across, self.noise.along
        if along > across:
            # Noise of the converter is constant in counts, noise of the motion in cycles.
            mean = float(np.sqrt(np.mean(speed**2)))
            variance = across**2 + (along**2 - across**2) * (speed / mean) ** 2
        else:
            variance = np.full_like(speed, along**2)
        return used / np.sqrt(variance), used / across

    def _origin(self) -> FloatArray:
        """Direction in which a shift of the phase moves the coefficients: the data cannot tell it."""
        parts = []
        for track in (self.waveform.sine, self.waveform.cosine):
            moved = np.zeros_like(track)
            for place, order in enumerate(self.waveform.orders):
                omega = 2.0 * np.pi * order
                moved[1 + 2 * place] = omega * track[2 + 2 * place]
                moved[2 + 2 * place] = -omega * track[1 + 2 * place]
            parts.append(moved)
        direction = np.concatenate(parts)
        return np.asarray(direction / np.linalg.norm(direction), np.float64)

    def _held(self, matrix: FloatArray) -> FloatArray:
        origin = self._origin()
        size = float(np.trace(matrix)) / len(matrix)
        return np.asarray(matrix + size * np.outer(origin, origin), np.float64)

    def step(self) -> tuple[Waveform, FloatArray, float]:
        """One step of Gauss-Newton: new tracks, new motion, largest change of position in cycles."""
        change = np.linalg.lstsq(self._held(self.reduced), self.reduced_right, rcond=1e-14)[0]
        motion = self.solved_right - self.solved_cross @ change
        moved = np.abs(motion).sum(axis=1)
        step = float(np.quantile(moved, 0.9)) if len(moved) else 0.0
        # A block that the start left far off must not throw the others about.
        motion *= np.minimum(1.0, LARGEST_STEP_CYCLES / np.maximum(moved, 1e-30))[:, None]
        half = len(self.waveform.sine)
        waveform = Waveform(
            self.waveform.orders, self.waveform.sine + change[:half], self.waveform.cosine + change[half:]
        )
        return waveform, self.motion + motion, step

    def result(self) -> JointFit:
        blocks, size = self.blocks, len(self.right)
        use = blocks.used
        across = np.sqrt(np.sum(self.across[use] ** 2) / max(1.0, blocks.samples - size / 2.0))
        along = np.sqrt(np.sum(self.along[use] ** 2) / max(1.0, blocks.freedom - size / 2.0))
        noise = Noise(max(float(across), 1e-9), max(float(along), 1e-9))
        # Weights were relative: scale them to the noise found.
        scale = max((noise.along / self.noise.along) ** 2, (noise.across / self.noise.across) ** 2)
        return JointFit(
            self.waveform,
            self.motion,
            self.along,
            self.across,
            self.speed,
            noise,
            self._inverse(self.reduced) * scale,
            self._inverse(self.normal) * scale,
        )

    def covariance(self) -> FloatArray:
        """Inverse of the information that the samples hold on the coefficients, origin held."""
        return self._inverse(self.reduced)

    def _inverse(self, information: FloatArray) -> FloatArray:
        held = self._held(information)
        return np.asarray(np.linalg.pinv(held, rcond=1e-14, hermitian=True), np.float64)
