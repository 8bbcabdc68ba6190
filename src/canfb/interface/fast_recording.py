"""Object 2050h of the encoder interface: both tracks, sampled faster than SYNC."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from canfb import objects as od
from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.device.od.dictionary import Dictionary, refuse_if

BLOCK_SAMPLES = 1 << 16
COMMANDS = frozenset(od.RecordingCommand)

Block = npt.NDArray[np.int16]
"""Sine and cosine in ADC counts, shape (n, 2)."""


@runtime_checkable
class Continuous(Protocol):
    """A source that can be sampled at any time."""

    def machine_time(self, now: float) -> float:
        """The time of the machine, seconds, at the time ``now`` of the node."""

    def fast_samples(self, times_s: npt.NDArray[np.float64], seed: tuple[int, int]) -> Block:
        """Both tracks at these times of the machine; ``seed`` is that of the noise."""


class FastRecorder:
    """Samples the encoder from start (2050:01 = 1) to stop (2), or until the memory is full (2050:05).

    The samples, at the rate of 2050:04, are a function of time, computed when 2050:03 is read. A reset of the
    node drops them. Without a :class:`Continuous` source start is refused (08000022h).
    """

    def __init__(self, dictionary: Dictionary, source: object, now: Callable[[], float]) -> None:
        self._source = source if isinstance(source, Continuous) else None
        self._now = now
        self._command = command = dictionary.entry(*od.RECORDING_COMMAND)
        command.on_check = refuse_if(lambda value: value not in COMMANDS)
        command.on_written = self._obey
        command.on_read = lambda: int(self.is_recording)
        dictionary.entry(*od.RECORDING_RECORDED).on_read = lambda: self.count
        dictionary.entry(*od.RECORDING_SAMPLES).on_read = self.to_bytes
        self._rate, self._capacity = (
            dictionary.entry(*place) for place in (od.RECORDING_RATE, od.RECORDING_CAPACITY)
        )
        self._rate.on_check = refuse_if(lambda value: self.is_recording, AbortCode.DEVICE_STATE)
        self._number = 0
        self.reset()

    def reset(self) -> None:
        self._began_s: float | None = None  # time of the node, while it records
        self._first_s = 0.0  # time of the machine
        self._kept = 0
        self._rate_hz = 1.0
        self._blocks: list[bytes] = []

    @property
    def is_recording(self) -> bool:
        return self._began_s is not None and self.count < self._capacity.value

    @property
    def count(self) -> int:
        if self._began_s is None:
            return self._kept
        passed = max(0.0, self._now() - self._began_s)
        # The first sample is taken at the start; a sum of times may fall short of a whole by rounding.
        return min(int(passed * self._rate_hz + 1e-6) + 1, int(self._capacity.value))

    def to_bytes(self) -> bytes:
        count = self.count
        whole, rest = divmod(count, BLOCK_SAMPLES)
        while len(self._blocks) < whole:
            self._blocks.append(self._block(len(self._blocks)))
        tail = self._block(whole)[: 4 * rest] if rest else b""
        return b"".join((*self._blocks[:whole], tail))

    def _block(self, number: int) -> bytes:
        """Whole blocks only, so that the noise does not depend on when it is read."""
        if self._source is None:
            return b""
        places = np.arange(number * BLOCK_SAMPLES, (number + 1) * BLOCK_SAMPLES)
        block = self._source.fast_samples(self._first_s + places / self._rate_hz, (self._number, number))
        return block.astype("<i2").tobytes()

    def _obey(self) -> None:
        if self._command.value == od.RecordingCommand.START:
            self._start()
        else:
            self._kept, self._began_s = self.count, None

    def _start(self) -> None:
        if self._source is None:
            raise SdoAbort(AbortCode.DEVICE_STATE)
        self.reset()
        self._number += 1
        self._rate_hz = float(self._rate.value)
        self._began_s = self._now()
        self._first_s = self._source.machine_time(self._began_s)
