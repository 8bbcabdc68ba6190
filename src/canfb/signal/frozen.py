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
        """The counts are others than before."""
        self.repeats = 0

    def repeated(self, speed_cycles: float) -> bool:
        """The counts are those of the sample before; True if the input is frozen.

        ``speed_cycles`` before this sample, cycles per interval; looked at with the first repeat only.
        """
        if self.repeats == 0:
            self._speed = speed_cycles
        self.repeats += 1
        if not self.frozen_samples or abs(self._speed) < self.residual_limit_cycles:
            return False
        return self.repeats >= self.frozen_samples

    def goes_on(self, repeated: bool) -> bool:
        """The counts of a machine that stands are ``repeated``, or others."""
        if repeated:
            self.repeated(self._speed)
        else:
            self.moved()
        return repeated

    @property
    def stands(self) -> bool:
        """The counts repeat, and are those of a machine that stands still."""
        slow = not self.frozen_samples or abs(self._speed) < self.residual_limit_cycles
        return self.repeats > 0 and slow

    def take_run(self, equal: npt.NDArray[np.bool_], speeds: npt.NDArray[np.float64]) -> int:
        """:meth:`repeated` where a sample is ``equal`` to the one before, :meth:`moved` where not.

        ``speeds`` before each sample, cycles per interval. The result: samples before the first frozen one;
        only these are taken.
        """
        at = np.flatnonzero(equal)
        if not len(at):
            self.repeats = 0 if len(equal) else self.repeats
            return len(equal)
        begin = ~equal[at - 1]
        begin[0] = True  # none before it, and at 0 there is no at - 1
        begins = at[begin]
        speed = speeds[begins]
        if begins[0] == 0 and self.repeats:  # the repeats began before this run
            begins[0], speed[0] = -self.repeats, self._speed
        row = np.add.accumulate(begin, dtype=np.intp) - 1
        repeats = at - begins[row] + 1
        moving = (np.abs(speed) >= self.residual_limit_cycles) & (self.frozen_samples > 0)
        frozen = np.flatnonzero(moving[row] & (repeats >= self.frozen_samples))
        taken = int(at[frozen[0]]) if len(frozen) else len(equal)
        if taken and not equal[taken - 1]:
            self.repeats = 0
        elif taken:
            last = int(np.searchsorted(at, taken)) - 1
            self.repeats, self._speed = int(repeats[last]), float(speed[row[last]])
        return taken
