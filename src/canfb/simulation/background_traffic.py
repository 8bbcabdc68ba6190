"""Frames of other nodes, which keep the bus busy."""

from __future__ import annotations

import numpy as np

from canfb.checks import number_in
from canfb.cia301.frame import Frame, frame_bits

CAN_ID = 0x6E0  # of no node and of no service of CiA 301
MEAN_BITS = sum(frame_bits(size) for size in range(9)) / 9
HIGHEST_LOAD = 0.95


class BackgroundTraffic:
    """Sends frames of 0 to 8 bytes at random times; sans-I/O.

    load      part of the time for which they keep a bus of ``bit_rate`` bit/s busy, 0..0.95
    seed      the same one gives the same frames again

    ValueError for another load.
    """

    def __init__(self, load: float, bit_rate: int, seed: int = 1) -> None:
        number_in("load", load, 0.0, HIGHEST_LOAD)
        self._rng = np.random.default_rng((seed, CAN_ID))
        self._mean_gap_s = MEAN_BITS / bit_rate / load if load else None
        self._next_s: float | None = None

    def start(self, now: float) -> list[Frame]:
        """Power-on: the first frame comes after a random time."""
        self._plan(now)
        return []

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Nothing on the bus concerns it."""
        return []

    def deadline(self) -> float | None:
        """The time of the next frame."""
        return self._next_s

    def tick(self, now: float) -> list[Frame]:
        """A frame when it is due."""
        if self._next_s is None or now < self._next_s:
            return []
        self._plan(self._next_s)
        return [Frame(CAN_ID, self._rng.bytes(int(self._rng.integers(9))))]

    def _plan(self, after_s: float) -> None:
        if self._mean_gap_s is not None:
            self._next_s = after_s + float(self._rng.exponential(self._mean_gap_s))
