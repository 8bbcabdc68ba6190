"""Objects 2020h and 2002h: correction table and conditioning, staged and in force, and the drift.

Table and conditioning take effect together, between two samples: the table is for conditioned tracks.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Sequence
from functools import partial

from canfb import objects as od
from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.device.od.dictionary import Dictionary, Entry
from canfb.device.storage.kept import ParameterGroup
from canfb.device.storage.storage import Storage
from canfb.module.parameters import ADAPTATION_BOUNDS, ADAPTATION_UNIT, Limits
from canfb.signal.adaptation import AdaptConfig, FollowedDrift
from canfb.signal.chain import SignalChain
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import Correction, CorrectionTable


class TableStore:
    """Object 2020h: a table is staged by 2020:01 and takes effect, with 2002h, by 2020:03.

    `save` keeps the values in force, not those of 2002h for the next activation. ``on_in_force`` is called
    with each correction that comes into force, by SDO, by a calibration or with a reset.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        chain: SignalChain,
        storage: Storage,
        on_in_force: Callable[[Correction], None],
    ) -> None:
        self._chain, self._storage, self._on_in_force = chain, storage, on_in_force
        self._staged_crc = dictionary.entry(*od.TABLE_STAGED_CRC)
        self._active_crc = dictionary.entry(*od.TABLE_ACTIVE_CRC)
        self._active_entries = dictionary.entry(*od.TABLE_ACTIVE_ENTRIES)
        self._staged: CorrectionTable | None = None
        # Its value is empty, except for a table that is being restored or written.
        self._content = staged = dictionary.entry(*od.TABLE_STAGED)
        self._activation = activate = dictionary.entry(*od.TABLE_ACTIVATE)
        self._conditioned = [dictionary.entry(*place) for place in od.CONDITIONING]
        staged.on_check = _check_table
        staged.on_written = self._stage
        dictionary.read_live(
            {
                od.TABLE_STAGED: lambda: (self._table or CorrectionTable.identity()).to_bytes(),
                od.TABLE_SAVED_CRC: self._saved_crc,
                od.TABLE_ACTIVE_CONDITIONING: lambda: struct.pack(f"<{len(od.CONDITIONING)}f", *self._values),
            }
        )
        activate.on_written = self._activate
        activate.on_download = storage.configuration_changed
        storage.entries.keep(
            *od.TABLE_STAGED, saved=lambda: self._table.to_bytes() if self._table is not None else b""
        )
        for part, entry in enumerate(self._conditioned):
            entry.on_check = partial(self._check_conditioning, entry)
            storage.entries.save_as(entry.index, entry.subindex, partial(self._saved_conditioning, part))

    @property
    def _table(self) -> CorrectionTable | None:
        return self._chain.correction.table

    @property
    def _values(self) -> Sequence[float]:
        return self._chain.correction.conditioning.values

    def reset(self) -> None:
        """Put the stored table, or none, and 2002h in force; nothing is staged."""
        self._staged = None
        stored: bytes = self._content.value
        self._content.value = b""
        self._put_in_force(CorrectionTable.from_bytes(stored) if stored else None)

    def take_over(self, correction: Correction) -> None:
        """Put ``correction`` in force between two samples; a staged table stays staged."""
        for entry, value in zip(self._conditioned, correction.conditioning.values, strict=True):
            entry.value = value
        self._put_in_force(correction.table)
        self._storage.configuration_changed()

    def _saved_conditioning(self, part: int) -> float:
        return self._values[part]

    def _saved_crc(self) -> int:
        for record in self._storage.records(ParameterGroup.MANUFACTURER) or ():
            if (record.index, record.subindex) == od.TABLE_STAGED and record.data:
                return zlib.crc32(record.data)
        return 0

    def _stage(self) -> None:
        data: bytes = self._content.value
        if not data:
            raise SdoAbort(AbortCode.INVALID_VALUE)
        self._staged = CorrectionTable.from_bytes(data)
        self._content.value = b""
        self._staged_crc.value = self._staged.crc32

    def _activate(self) -> None:
        known = {one.crc32: one for one in (self._table, self._staged) if one is not None} | {0: None}
        if self._activation.value not in known:
            raise SdoAbort(AbortCode.INVALID_VALUE)
        self._put_in_force(known[self._activation.value])

    def _put_in_force(self, table: CorrectionTable | None) -> None:
        correction = Correction(table, self._conditioning())
        self._chain.activate(correction)
        self._active_crc.value = correction.crc32
        self._active_entries.value = 0 if table is None else len(table)
        self._staged_crc.value = 0 if self._staged is None else self._staged.crc32
        self._on_in_force(correction)

    def _conditioning(self, changed: Entry | None = None, value: float = 0.0) -> Conditioning:
        return Conditioning(*(value if entry is changed else entry.value for entry in self._conditioned))

    def _check_conditioning(self, entry: Entry, value: float) -> None:
        try:
            self._conditioning(entry, value)
        except ValueError:
            raise SdoAbort(AbortCode.INVALID_VALUE) from None


def _check_table(data: bytes) -> None:
    """Refuse a bad table; an empty one is the identity in the store, and cannot be staged."""
    try:
        if data:
            CorrectionTable.from_bytes(data)
    except ValueError:
        raise SdoAbort(AbortCode.INVALID_VALUE) from None


MOST_PER_CENT = 0xFFFF


class Adapting:
    """Follows the drift of offset, gain and phase: 2002:08..12 (docs/analog-front-end.md).

    `save` keeps the drift, from which a reset continues; 2002:01..07 stay those of the calibration. An
    activation, or 2002:08 = 0, resets the drift to zero.
    """

    def __init__(self, dictionary: Dictionary, chain: SignalChain, limits: Limits, storage: Storage) -> None:
        self._chain, self._limits = chain, limits
        entry = dictionary.entry
        self._mode = entry(*od.ADAPTATION)
        self._bounds = {name: entry(*place) for name, place in ADAPTATION_BOUNDS.items()}
        self._drift = [entry(*place) for place in od.DRIFT]
        for changed in (self._mode, *self._bounds.values()):
            changed.on_written = self._adapt
        dictionary.read_live(
            {od.ADAPTATION_STATE: lambda: int(self.state), od.ADAPTATION_USED: self._used},
        )
        for part, shown in enumerate(self._drift):
            shown.on_read = read = partial(self._followed, part)
            storage.entries.keep(shown.index, shown.subindex, saved=read)

    @property
    def state(self) -> od.AdaptationState:
        adaptation = self._chain.adaptation
        if not adaptation.is_on:
            return od.AdaptationState.OFF
        if adaptation.at_limit:
            return od.AdaptationState.AT_LIMIT
        return (
            od.AdaptationState.FOLLOWING
            if adaptation.is_recent(self._chain.samples)
            else od.AdaptationState.WAITING
        )

    def reset(self) -> None:
        self._adapt(FollowedDrift(*(entry.value for entry in self._drift)))

    def _adapt(self, start_from: FollowedDrift | None = None) -> None:
        bounds = {name: entry.value * ADAPTATION_UNIT for name, entry in self._bounds.items()}
        self._chain.adapt(AdaptConfig(**bounds) if self._mode.value else None, start_from)
        self._limits.apply()  # the adaptation needs the sampling interval

    def _followed(self, part: int) -> float:
        return self._chain.adaptation.drift[part]

    def _used(self) -> int:
        return min(int(100.0 * self._chain.adaptation.used), MOST_PER_CENT)
