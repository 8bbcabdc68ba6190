"""A converter that repeats itself: the same counts again and again although the machine moves."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from canfb.signal.phase import AnyArray


def repeats(
    sine: AnyArray, cosine: AnyArray, before: tuple[float, float], out: npt.NDArray[np.bool_]
) -> npt.NDArray[np.bool_] | None:
    """Which pairs of counts, of one or more, are those of the sample before; in ``out``. None: not one.

    ``before`` is the pair before the first one.
    """
    equal = out[: len(sine)]
    equal[0] = sine[0] == before[0]
    np.equal(sine[1:], sine[:-1], out=equal[1:])
    if not equal.any():  # then the other track need not be looked at
        return None
    equal[0] &= cosine[0] == before[1]
    equal[1:] &= cosine[1:] == cosine[:-1]
    return equal if equal.any() else None


class FrozenInput:
    """Counts repeated pairs of counts.

    A machine slower than the residual limit may have stopped. A faster one cannot, but whole cycles per
    sample show the same phase each time, and only noise shows that the converter works: ``frozen_samples``
    (2010:04) successive repeats, 0: off.
    """

    __slots__ = ("_speed", "frozen_samples", "repeats", "residual_limit_cycles")

    def __init__(self, frozen_samples: int, residual_limit_cycles: float) -> None:
        self.frozen_samples = frozen_samples
        self.residual_limit_cycles = residual_limit_cycles
        self.repeats = 0
        self._speed = 0.0

    def moved(self) -> None:
        self.repeats = 0

    def repeated(self, speed_cycles: float) -> bool:
        """The counts are those of the sample before; True if the input is frozen.

        ``speed_cycles`` before this sample, cycles per interval; looked at with the first repeat only.
        """
        if self.repeats == 0:
            self._speed = speed_cycles
        self.repeats += 1
        return not self.stands and self.repeats >= self.frozen_samples

    def goes_on(self, repeated: bool) -> bool:
        if repeated:
            self.repeated(self._speed)
        else:
            self.moved()
        return repeated

    @property
    def stands(self) -> bool:
        slow = not self.frozen_samples or abs(self._speed) < self.residual_limit_cycles
        return self.repeats > 0 and slow

    def before_row(self, equal: npt.NDArray[np.bool_]) -> int:
        """Samples before the first row of repeats that may freeze: long enough, or with no end yet.

        ``equal``: which samples are equal to the one before; the first one begins a row.
        """
        changes = np.flatnonzero(np.diff(equal, prepend=False, append=False))
        begins, ends = changes[::2], changes[1::2]
        rows = begins[(ends - begins >= self.frozen_samples) | (ends == len(equal))]
        return int(rows[0]) if len(rows) else len(equal)
