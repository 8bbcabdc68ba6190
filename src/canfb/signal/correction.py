"""The correction of one encoder: phase as a function of raw phase (paper, section 2), and of counts."""

from __future__ import annotations

import copy
import math
import zlib
from dataclasses import dataclass
from typing import Any, Protocol, Self, overload

import numpy as np
import numpy.typing as npt

from canfb.signal.blocks import Scratch, blocks
from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.signal.phase import SCALARS, FloatArray, real_array, wrap_block

MIN_ENTRIES = 16
MAX_ENTRIES = 4096
MAX_DEVIATION_CYCLES = 0.25

Lines = tuple[tuple[float, float], ...]


class CorrectionTable:
    """Phase of one encoder as a function of its raw phase, by linear interpolation.

    ``entries[n]`` is the phase, in cycles, at raw phase ``n / len(entries)``, with the precision of 2020:01
    (REAL32). Raises ValueError unless 16 <= N <= 4096, every entry is finite, the entries are strictly
    increasing including the wrap to ``entries[0] + 1``, and none is further than 0.25 cycle from ``n / N``.
    """

    __slots__ = ("_bytes", "_first", "_lines", "_n", "_slope", "conditioning")

    def __init__(self, entries: npt.ArrayLike) -> None:
        try:
            single = np.array(real_array("entries", entries), dtype="<f4", ndmin=1)
        except (TypeError, ValueError) as error:
            raise ValueError(f"a correction table is a sequence of numbers: {error}") from None
        _check(single)
        self._n = len(single)
        self._bytes = single.tobytes()
        first = single.astype(np.float64)
        # Raw phase 1.0 is raw phase 0.0: entry 0 is repeated at the end.
        self._first: FloatArray = np.append(first, first[0])
        self._slope: FloatArray = np.append(np.diff(first, append=first[0] + 1.0), 0.0)
        self.conditioning: Conditioning | None = None
        """The conditioning with which a calibration made the table; None: not known. Not in the bytes."""
        self._lines: Lines = ()  # made for the first sample: an upload only checks a table

    @classmethod
    def identity(cls, n: int = 256) -> Self:
        """The identity, with ``n`` entries (16..4096)."""
        return cls(np.arange(n) / n)

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """Table from the bytes of object 2020:01: N x REAL32, little-endian. ValueError if bad."""
        if len(data) % 4:
            raise ValueError(f"a correction table is N x REAL32: {len(data)} bytes is not a multiple of 4")
        return cls(np.frombuffer(bytes(data), dtype="<f4"))

    def made_for(self, conditioning: Conditioning) -> Self:
        """The same table as one that a calibration made with this ``conditioning``."""
        made = copy.copy(self)
        made.conditioning = conditioning
        return made

    def to_bytes(self) -> bytes:
        """The table as object 2020:01 has it: N x REAL32, little-endian."""
        return self._bytes

    @property
    def crc32(self) -> int:
        """CRC-32 (zlib) of :meth:`to_bytes`: what 2020:03 activates."""
        return zlib.crc32(self._bytes)

    @property
    def entries(self) -> FloatArray:
        """The entries in cycles, shape (N,), a copy."""
        return self._first[:-1].copy()

    def __len__(self) -> int:
        return self._n

    def __eq__(self, other: object) -> bool:
        return isinstance(other, CorrectionTable) and self._bytes == other._bytes

    def __hash__(self) -> int:
        return hash(self._bytes)

    def __repr__(self) -> str:
        return f"CorrectionTable({self._n} entries, crc32={self.crc32:08X}h)"

    @overload
    def __call__(self, raw_phase: float) -> float: ...
    @overload
    def __call__(self, raw_phase: npt.ArrayLike) -> FloatArray: ...
    def __call__(self, raw_phase: Any) -> Any:
        """Phase at ``raw_phase`` (cycles, taken modulo 1): 0 <= phase < 1, NaN stays NaN.

        A float for scalars, an ndarray for arrays; both give the same bits.
        """
        if isinstance(raw_phase, SCALARS):
            raw = float(raw_phase)
            return self.correct(raw % 1.0 % 1.0) if math.isfinite(raw) else math.nan
        raws = real_array("raw_phase", raw_phase)
        with np.errstate(invalid="ignore"):
            return self.correct_array(raws % 1.0 % 1.0)

    def _make_lines(self) -> Lines:
        # For one sample at a time: N + 1 pairs of entry and slope, cycles, as plain floats.
        self._lines = tuple(zip(self._first.tolist(), self._slope.tolist(), strict=True))
        return self._lines

    def correct(self, raw: float) -> float:
        """Phase at one raw phase, 0..1 (unchecked)."""
        place = raw * self._n
        index = int(place)
        first, slope = (self._lines or self._make_lines())[index]
        phase = first + (place - index) * slope
        if phase < 0.0:
            phase += 1.0
        if phase >= 1.0:
            phase -= 1.0
        return phase

    def correct_array(self, raw: FloatArray) -> FloatArray:
        """Phases at raw phases in 0..1, NaN allowed; the same bits."""
        phases = np.empty(raw.shape)
        flat_raw, flat = raw.reshape(-1), phases.reshape(-1)
        for part, scratch in blocks(len(flat)):
            self.correct_block(flat_raw[part], flat[part], scratch)
        return phases

    def correct_block(self, raw: FloatArray, out: FloatArray, scratch: Scratch) -> None:
        """:meth:`correct_array` for one block, into ``out`` (may be ``raw``); ``scratch`` has its length."""
        place, whole, index = scratch.a, scratch.b, scratch.index
        np.multiply(raw, self._n, out=place)
        np.floor(place, out=whole)
        with np.errstate(invalid="ignore"):
            index[:] = whole
        place -= whole
        # NaN has no index: "clip" keeps the look-up in the table, and the fraction makes the result NaN.
        phase = self._slope.take(index, mode="clip", out=whole)
        phase *= place
        phase += self._first.take(index, mode="clip", out=place)
        if self._first[0] < 0.0:  # a phase just below 0 may be rounded to 1.0, which is 0.0
            wrap_block(phase, scratch)
        np.subtract(phase, np.floor(phase, out=place), out=out)


@dataclass(frozen=True)
class Correction:
    """Conditioning and correction table of one reference measurement, which take effect together (2020:03).

    table         None: the identity
    conditioning  2002h; default: the identity
    """

    table: CorrectionTable | None = None
    conditioning: Conditioning = IDENTITY

    @property
    def crc32(self) -> int:
        """CRC-32 of the table as in object 2020:04: 0 for the identity."""
        return 0 if self.table is None else self.table.crc32


NO_CORRECTION = Correction()


def check_table(table: object) -> None:
    if table is not None and not isinstance(table, CorrectionTable):
        raise TypeError(
            f"table must be a CorrectionTable or None, not {type(table).__name__}: "
            "make one of entries with canfb.CorrectionTable(entries)"
        )


class Calibrated(Protocol):
    """An object with table and conditioning, as :class:`canfb.Calibration`."""

    @property
    def correction(self) -> Correction:
        """Table and conditioning."""


AnyTable = CorrectionTable | Correction | Calibrated | None


def correction_of(table: AnyTable, conditioning: Conditioning | None = None) -> Correction:
    """Table and conditioning to compute with; ``conditioning`` None: not given.

    TypeError unless ``table`` is a table, a calibration or None. ValueError if the table of a calibration
    comes without its conditioning, or a calibration with another one.
    """
    found = table if isinstance(table, Correction) else getattr(table, "correction", None)
    if not isinstance(found, Correction):
        check_table(table)
        assert table is None or isinstance(table, CorrectionTable)
        made_for = None if table is None else table.conditioning
        if conditioning is None and made_for not in (None, IDENTITY):
            raise ValueError(
                "this table belongs to a conditioning, without which it is wrong: pass the whole calibration "
                "in its place, or its conditioning too"
            )
        return Correction(table, conditioning or IDENTITY)
    if conditioning not in (None, found.conditioning):
        raise ValueError("conditioning: the calibration has another one already; pass its table alone")
    return found


def _check(entries: npt.NDArray[np.float32]) -> None:
    if entries.ndim != 1:
        raise ValueError(f"a correction table has one dimension, not {entries.ndim}")
    n = len(entries)
    if not MIN_ENTRIES <= n <= MAX_ENTRIES:
        raise ValueError(f"a correction table has {MIN_ENTRIES} to {MAX_ENTRIES} entries, not {n}")
    bad = np.flatnonzero(~np.isfinite(entries))
    if len(bad):
        raise ValueError(f"entry {bad[0]} is not a finite number")
    values = entries.astype(np.float64)
    far = np.flatnonzero(np.abs(values - np.arange(n) / n) > MAX_DEVIATION_CYCLES)
    if len(far):
        raise ValueError(f"entry {far[0]} is further than {MAX_DEVIATION_CYCLES} cycle from {far[0]}/{n}")
    falling = np.flatnonzero(np.diff(values, append=values[0] + 1.0) <= 0.0)
    if len(falling):
        raise ValueError(f"not strictly increasing from entry {falling[0]} to {(falling[0] + 1) % n}")
