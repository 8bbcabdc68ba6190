"""Motion that is locked to the samples, seen after a second instead of after the whole measurement."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

from canfb.calibration.lock import WINDOW, Lock, away_from, find_lock
from canfb.calibration.result import Reason
from canfb.commissioning.samples import TrackSamples
from canfb.errors import CalibrationError
from canfb.signal.phase import FloatArray

FIRST_S = 1.0
STANDSTILL_S = 3.0  # somebody may be about to let the machine turn
HALF_CYCLE = 0.5


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


class LockWatch:
    """Looks once, about a second after the first SYNC, whether the motion is locked to the samples.

    ``speed_rad_s`` asks the module for its speed; it is 0.0 where the module could not count. Call it as
    the samples come: it is True when it makes no sense to continue, and ``found`` says why.
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
        lock = find_lock(*_latest(samples, self._next_s - FIRST_S))
        if lock is None:
            self._next_s = math.inf
            return False
        speed = 0.0
        if samples.rate_hz:
            speed = self._speed_rad_s() * self._cycles_per_revolution / (2.0 * math.pi) / samples.rate_hz
            if speed < 0.0:  # backwards is forwards with the tracks exchanged
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
                "the tracks hardly change: the machine is at standstill, or moves a whole number of "
                f"cycles per sample. Let it turn {faster}",
                Reason.COVERAGE,
            )
        known = "" if speed < HALF_CYCLE else f", for example at {(_near(speed, lock) + step) * rpm:.5g} rpm"
        count = "a whole number" if lock.denominator == 1 else f"n + {lock.numerator}/{lock.denominator}"
        return CalibrationError(
            f"the motion is locked to the samples: {count} of cycles per sample, so that the same phases "
            f"repeat. Let it turn {faster}{known}",
            Reason.LOCKED,
        )


def _near(speed: float, lock: Lock) -> float:
    """The module's speed, averaged over little, put on the lock."""
    part = lock.numerator / lock.denominator
    return round(speed - part) + part


def _latest(samples: TrackSamples, from_s: float) -> tuple[FloatArray, FloatArray]:
    """Both tracks from this time on."""
    first = min(int(from_s * (samples.rate_hz or 0.0)), max(0, len(samples) - WINDOW))
    return samples.sine[first:], samples.cosine[first:]
