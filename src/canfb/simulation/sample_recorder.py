"""Keeps what the encoder interface samples, SYNC by SYNC."""

from __future__ import annotations

from array import array

import numpy as np

from canfb import objects as od
from canfb.cia301 import cob
from canfb.cia301.frame import Frame
from canfb.interface.encoder_interface import EncoderInterface
from canfb.signal.phase import FloatArray

MISSED = -32768  # in both tracks, as in 2050:03


class SampleRecorder:
    """Keeps the sample of each SYNC, from the first sample on; sans-I/O, and it sends nothing.

    It must hear the SYNC after the ``interface``: attach it behind. Four bytes for each SYNC.
    """

    def __init__(self, interface: EncoderInterface) -> None:
        self._interface = interface
        self._counts = array("h")
        self._samples = 0
        self._channels = [
            interface.dictionary.entry(*track) for track in (od.INTERFACE_SINE, od.INTERFACE_COSINE)
        ]

    def __len__(self) -> int:
        """Intervals, those without a sample as well."""
        return len(self._counts) // 2

    def tracks(self) -> tuple[FloatArray, FloatArray]:
        """Sine and cosine in ADC counts, NaN where a SYNC had no sample."""
        pairs = np.array(self._counts, np.float64).reshape(-1, 2)
        pairs[(pairs == MISSED).all(axis=1)] = np.nan
        return pairs[:, 0].copy(), pairs[:, 1].copy()

    def start(self, now: float) -> list[Frame]:
        """Nothing to send."""
        return []

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Take what the interface has sampled at this SYNC."""
        if frame.can_id == cob.SYNC and not frame.rtr:
            if self._interface.samples > self._samples:
                self._samples = self._interface.samples
                self._counts.extend(int(channel.value) for channel in self._channels)
            elif self._samples and not self._interface.ended:
                self._counts.extend((MISSED, MISSED))
        return []

    def tick(self, now: float) -> list[Frame]:
        """Nothing is ever due."""
        return []

    def deadline(self) -> float | None:
        """No time is waited for."""
        return None
