"""Motion that is locked to the samples, seen after a second in place of after the whole measurement."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from canfb.calibration.result import Reason
from canfb.commissioning.samples import TrackSamples
from canfb.errors import CalibrationError
from canfb.signal.phase import FloatArray

WINDOW = 256  # samples; a reference measurement needs that the phases move within about so many
LARGEST_DENOMINATOR = 16
DRIFT_CYCLES = 0.36  # over the window, times the denominator: less is too close to locked
FIRST_S = 1.0
STANDSTILL_S = 3.0  # somebody may be about to let the machine turn
HALF_CYCLE = 0.5
# Steps in cycles per sample, far from simple fractions; the first that leads away from them is taken.
STEPS = (0.382, 0.276, 0.171, 0.236, 0.118, 0.073, 0.045)
FAR = 0.03


class Lock(NamedTuple):
    """So many cycles per sample: numerator / denominator, and an unknown whole number."""

    numerator: int
    denominator: int


class Listening(Protocol):
    """What is being collected, as :class:`.listening.Listener`."""

    @property
    def elapsed_s(self) -> float:
        """Time since the first SYNC."""

    @property
    def intervals(self) -> int:
        """SYNCs that came."""

    def result(self) -> TrackSamples:
        """What came."""


def find_lock(samples: TrackSamples) -> Lock | None:
    """The lock of these samples, None without one, or with fewer than 256.

    Locked at p/q, each q-th sample lies at the same place; here for q up to 16, on windows of 256.
    """
    z = samples.cosine + 1j * samples.sine
    windows = len(z) // WINDOW
    if not windows:
        return None
    rows = z[: windows * WINDOW].reshape(windows, WINDOW)
    power = np.nanmean(np.abs(rows) ** 2)
    for q in range(1, LARGEST_DENOMINATOR + 1):
        length = WINDOW // q * q
        places = rows[:, :length].reshape(windows, length // q, q)
        seen = ~np.isnan(places)
        mean = np.where(seen, places, 0.0).sum(axis=1) / np.maximum(1, seen.sum(axis=1))
        if np.mean(np.abs(mean) ** 2) > power * np.sinc(DRIFT_CYCLES / q) ** 2:
            turn = z[1:] * np.conj(z[:-1])
            step = float(np.angle(np.nansum(turn))) / (2.0 * math.pi)
            return Lock(round(step * q) % q, q)
    return None


class LockWatch:
    """Looks once, about a second after the first SYNC, whether the motion is locked to the samples.

    ``speed_rad_s`` asks the module for its speed; it is 0.0 where the module could not count. Call it as
    the samples come: it is True when there is no sense in going on, and ``found`` says why.
    """

    def __init__(self, cycles_per_revolution: int, speed_rad_s: Callable[[], float]) -> None:
        self.found: CalibrationError | None = None
        self._cycles_per_revolution = cycles_per_revolution
        self._speed_rad_s = speed_rad_s
        self._next_s = FIRST_S

    def __call__(self, listening: Listening) -> bool:
        """True if the collection may end."""
        if listening.elapsed_s < self._next_s or listening.intervals <= WINDOW:
            return False
        samples = listening.result()
        lock = find_lock(_latest(samples, self._next_s - FIRST_S))
        if lock is None:
            self._next_s = math.inf
            return False
        speed = 0.0
        if samples.rate_hz:
            speed = self._speed_rad_s() * self._cycles_per_revolution / (2.0 * math.pi) / samples.rate_hz
            if speed < 0.0:  # backwards is forwards with the tracks the other way round
                speed, lock = -speed, Lock(-lock.numerator % lock.denominator, lock.denominator)
        if lock.denominator == 1 and speed < HALF_CYCLE and self._next_s < STANDSTILL_S:
            self._next_s = STANDSTILL_S
            return False
        self.found = self._error(lock, speed, samples.rate_hz)
        return True

    def raise_found(self) -> None:
        """CalibrationError, with a speed that would do, if a lock was found."""
        if self.found is not None:
            raise self.found

    def _error(self, lock: Lock, speed: float, rate_hz: float | None) -> CalibrationError:
        """``speed`` in cycles per sample, less than a half where it is not known."""
        step = away_from(lock.numerator / lock.denominator)
        rpm = 60.0 * rate_hz / self._cycles_per_revolution if rate_hz else 0.0  # of one cycle per sample
        faster = f"{step * rpm:.3g} rpm faster" if rpm else f"by {step} of a cycle per sample faster"
        if lock.denominator == 1 and speed < HALF_CYCLE:
            return CalibrationError(
                "the tracks hardly change: the machine stands still, or goes through a whole number of "
                f"cycles per sample. Let it turn {faster}",
                Reason.COVERAGE,
            )
        known = "" if speed < HALF_CYCLE else f", at {(_near(speed, lock) + step) * rpm:.5g} rpm for one"
        count = "a whole number" if lock.denominator == 1 else f"n + {lock.numerator}/{lock.denominator}"
        return CalibrationError(
            f"the motion is locked to the samples: {count} of cycles per sample, so that the same phases "
            f"come again and again. Let it turn {faster}{known}",
            Reason.LOCKED,
        )


def away_from(fraction: float) -> float:
    """What to add to these cycles per sample so that they are no simple fraction."""
    for step in STEPS:
        multiples = [q * (fraction + step) for q in range(1, LARGEST_DENOMINATOR + 1)]
        if all(abs(one - round(one)) >= FAR for one in multiples):
            return step
    return STEPS[0]


def _near(speed: float, lock: Lock) -> float:
    """The module's speed, averaged over little, put on the lock."""
    part = lock.numerator / lock.denominator
    return round(speed - part) + part


def _latest(samples: TrackSamples, from_s: float) -> TrackSamples:
    """Those from this time on."""
    first = int(from_s * (samples.rate_hz or 0.0))
    tracks: list[FloatArray] = [samples.sine[first:], samples.cosine[first:]]
    if len(tracks[0]) < WINDOW:
        tracks = [samples.sine[-WINDOW:], samples.cosine[-WINDOW:]]
    return TrackSamples(tracks[0], tracks[1], samples.rate_hz, samples.origin)
