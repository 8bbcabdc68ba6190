"""Objects 2020h and 2002h: correction table and conditioning, staged, in force, and followed.

Table and conditioning belong together, for the table is that of conditioned tracks: they take effect
together, between two samples (:class:`TableStore`). From there on :class:`Adapting` can follow the drift of
offset, gain and phase (2002:08..12, docs/adaptation.md).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from functools import partial

from canfb import objects as od
from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.device.od.dictionary import Dictionary, Entry
from canfb.device.storage.image import ParameterGroup
from canfb.device.storage.storage import Storage
from canfb.module.parameters import ADAPTATION_BOUNDS, ADAPTATION_UNIT, Limits
from canfb.objects import AdaptationState as State
from canfb.signal.adaptation import AdaptConfig, FollowedDrift
from canfb.signal.chain import SignalChain
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import Correction, CorrectionTable


class TableStore:
    """Object 2020h: a table is staged by 2020:01 and takes effect, with 2002h, by 2020:03.

    `save` keeps what is in force: the active table, as the content of 2020:01, and its conditioning; not what
    2002h holds for the next activation. Both come back with a reset. 2020:06 is the CRC of the table, 2020:07
    the conditioning in force.
    """

    def __init__(self, dictionary: Dictionary, chain: SignalChain, storage: Storage) -> None:
        self._dictionary = dictionary
        self._chain = chain
        self._storage = storage
        self.on_in_force: Callable[[Correction], None] | None = None
        """Called with what has come into force, by SDO, by a calibration or with a reset."""
        self._staged: CorrectionTable | None = None
        self._content = staged = dictionary.entry(*od.TABLE_STAGED)
        """Its value is a table that was restored, or one that is just written; else empty."""
        self._activation = activate = dictionary.entry(*od.TABLE_ACTIVATE)
        self._conditioned = [dictionary.entry(*place) for place in od.CONDITIONING]
        staged.on_check = _check_table
        staged.on_written = self._stage
        staged.on_read = self._read_active
        dictionary.entry(*od.TABLE_SAVED_CRC).on_read = self._saved_crc
        dictionary.entry(*od.TABLE_ACTIVE_CONDITIONING).on_read = self._read_conditioning
        activate.on_written = self._activate
        activate.on_download = storage.configuration_changed
        storage.entries.keep(*od.TABLE_STAGED, saved=self._saved)
        for part, entry in enumerate(self._conditioned):
            entry.on_check = self._checker(entry)
            storage.entries.save_as(entry.index, entry.subindex, partial(self._saved_conditioning, part))

    def reset(self) -> None:
        """Nothing staged, the stored table active or none, the conditioning of 2002h in force."""
        self._staged = None
        stored: bytes = self._content.value
        self._content.value = b""
        self._put_in_force(CorrectionTable.from_bytes(stored) if stored else None)

    def take_over(self, correction: Correction) -> None:
        """Put both in force together, between two samples. 2002h shows the conditioning then; what
        is staged stays staged.
        """
        for entry, value in zip(self._conditioned, correction.conditioning.values, strict=True):
            entry.value = value
        self._put_in_force(correction.table)
        self._storage.configuration_changed()

    def _saved(self) -> bytes:
        table = self._chain.correction.table
        return b"" if table is None else table.to_bytes()

    def _saved_conditioning(self, part: int) -> float:
        return self._chain.correction.conditioning.values[part]

    def _saved_crc(self) -> int:
        """0 for the identity, and where nothing is saved: both bring the identity."""
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
        self._dictionary.entry(*od.TABLE_STAGED_CRC).value = self._staged.crc32

    def _read_active(self) -> bytes:
        return (self._chain.correction.table or CorrectionTable.identity()).to_bytes()

    def _read_conditioning(self) -> bytes:
        values = self._chain.correction.conditioning.values
        return struct.pack(f"<{len(values)}f", *values)

    def _activate(self) -> None:
        crc32 = self._activation.value
        active = self._chain.correction.table
        if crc32 == 0:
            self._put_in_force(None)
        elif self._staged is not None and crc32 == self._staged.crc32:
            self._put_in_force(self._staged)
        elif active is not None and crc32 == active.crc32:
            self._put_in_force(active)
        else:
            raise SdoAbort(AbortCode.INVALID_VALUE)

    def _put_in_force(self, table: CorrectionTable | None) -> None:
        correction = Correction(table, self._conditioning())
        self._chain.activate(correction)
        self._dictionary.entry(*od.TABLE_ACTIVE_CRC).value = correction.crc32
        self._dictionary.entry(*od.TABLE_ACTIVE_ENTRIES).value = 0 if table is None else len(table)
        self._dictionary.entry(*od.TABLE_STAGED_CRC).value = 0 if self._staged is None else self._staged.crc32
        if self.on_in_force is not None:
            self.on_in_force(correction)

    def _conditioning(self, changed: Entry | None = None, value: float = 0.0) -> Conditioning:
        return Conditioning(*(value if entry is changed else entry.value for entry in self._conditioned))

    def _checker(self, entry: Entry) -> Callable[[float], None]:
        def check(value: float) -> None:
            try:
                self._conditioning(entry, value)
            except ValueError:
                raise SdoAbort(AbortCode.INVALID_VALUE) from None

        return check


def _check_table(data: bytes) -> None:
    """Refuse what is not a table. `save` keeps the identity as nothing at all; that cannot be staged."""
    try:
        if data:
            CorrectionTable.from_bytes(data)
    except ValueError:
        raise SdoAbort(AbortCode.INVALID_VALUE) from None


MOST_PER_CENT = 0xFFFF


class Adapting:
    """Between these objects and :attr:`SignalChain.adaptation`.

    `save` keeps the drift that is followed, and a reset goes on from there; the conditioning of 2002:01..07
    stays that of the calibration. An activation (2020:03, 2030:01) begins at zero, as 2002:08 does when 0 is
    written.
    """

    def __init__(self, dictionary: Dictionary, chain: SignalChain, limits: Limits, storage: Storage) -> None:
        self._chain, self._limits = chain, limits
        entry = dictionary.entry
        self._mode = entry(*od.ADAPTATION)
        self._bounds = {name: entry(*place) for name, place in ADAPTATION_BOUNDS.items()}
        self._drift = [entry(*place) for place in od.DRIFT]
        self._mode.on_written = self._apply
        for bound in self._bounds.values():
            bound.on_written = self._apply
        entry(*od.ADAPTATION_STATE).on_read = lambda: int(self.state)
        entry(*od.ADAPTATION_USED).on_read = self._used
        for part, shown in enumerate(self._drift):
            shown.on_read = read = partial(self._followed, part)
            storage.entries.keep(shown.index, shown.subindex, saved=read)

    @property
    def state(self) -> State:
        """What it does now."""
        adaptation = self._chain.adaptation
        if not adaptation.is_on:
            return State.OFF
        if adaptation.at_limit:
            return State.AT_LIMIT
        return State.FOLLOWING if adaptation.is_recent(self._chain.samples) else State.WAITING

    def reset(self) -> None:
        """After the correction is in force: on from the drift that was saved with it."""
        self._adapt(FollowedDrift(*(entry.value for entry in self._drift)))

    def _apply(self) -> None:
        self._adapt(None)

    def _adapt(self, start_from: FollowedDrift | None) -> None:
        bounds = {name: entry.value * ADAPTATION_UNIT for name, entry in self._bounds.items()}
        self._chain.adapt(AdaptConfig(**bounds) if self._mode.value else None, start_from)
        self._limits.apply()  # it needs the sampling interval

    def _followed(self, part: int) -> float:
        return self._chain.adaptation.drift[part]

    def _used(self) -> int:
        return min(int(100.0 * self._chain.adaptation.used), MOST_PER_CENT)
