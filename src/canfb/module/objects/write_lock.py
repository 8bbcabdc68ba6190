"""Object 2040h: the lock against changes of parameters over the bus (docs/service.md).

It only prevents mistakes: CAN has no authentication, and each node on the bus can receive the code.
"""

from __future__ import annotations

from canfb import objects as od
from canfb.cia301.codes import AbortCode, NmtState, SdoAbort
from canfb.device.core import NEVER
from canfb.device.node import Node
from canfb.device.od.dictionary import Entry, refuse_if
from canfb.module.cia406.profile import CYCLIC_TIMER

RETRY_S = 1.0  # time after a wrong code in which none is accepted
COMMANDS = (od.TABLE_STAGED, od.TABLE_ACTIVATE, od.MEASUREMENT_COMMAND, od.WRITE_LOCK_NEW_UNLOCK_CODE)
STORES = frozenset({0x1010, 0x1011})


class WriteLock:
    """Refuses SDO writes of parameters, and LSS, while it is locked: 08000022h, in mode "code" 08000021h.

    It locks all that a backup holds, table, calibration in the module, `save`, `load`, and the lock itself. A
    transfer that began before is aborted at its next segment. The right code unlocks until a reset, or until
    0 is written. The lock is saved (1010h), but not in a backup.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        entry, entries = node.dictionary.entry, node.storage.entries
        self._mode, self._code = entry(*od.WRITE_LOCK_MODE), entry(*od.WRITE_LOCK_NEW_UNLOCK_CODE)
        self._given = entry(*od.WRITE_LOCK_UNLOCK_CODE)
        for place in (od.WRITE_LOCK_MODE, od.WRITE_LOCK_NEW_UNLOCK_CODE):
            entries.keep(*place)
        self._locked_places = {(one.index, one.subindex) for one in entries.settings()}
        self._locked_places |= {od.WRITE_LOCK_MODE, (CYCLIC_TIMER, 0), *COMMANDS}
        self._unlocked = False
        self._retry_s = -NEVER
        self._mode.on_check = refuse_if(lambda mode: mode == od.WriteLockMode.CODE and not self._code.value)
        self._code.on_check = refuse_if(lambda code: not code and self._mode.value == od.WriteLockMode.CODE)
        self._given.on_check = self._check_given
        self._given.on_written = self._unlock
        entry(*od.WRITE_LOCK_LOCKED).on_read = lambda: int(self.refusal is not None)

    @property
    def refusal(self) -> AbortCode | None:
        """The abort code for a write now; None: it is accepted."""
        mode = self._mode.value
        if mode == od.WriteLockMode.PREOP and self._node.state is NmtState.OPERATIONAL:
            return AbortCode.DEVICE_STATE
        if mode == od.WriteLockMode.CODE and not self._unlocked:
            return AbortCode.LOCAL_CONTROL
        return None

    def reset(self) -> None:
        self._unlocked = False

    def check_write(self, entry: Entry | None) -> None:
        """Raise SdoAbort if a write of ``entry`` is refused now; None: LSS."""
        place = None if entry is None else (entry.index, entry.subindex)
        if entry is not None and entry.index not in STORES and place not in self._locked_places:
            return
        refusal = self.refusal
        if refusal is not None:
            raise SdoAbort(refusal)

    def _check_given(self, value: int) -> None:
        """Refuse a wrong code, and any for RETRY_S after it."""
        if not value:
            return
        now = self._node.now
        if now >= self._retry_s:
            if self._code.value and value == self._code.value:
                return
            self._retry_s = now + RETRY_S
        raise SdoAbort(AbortCode.LOCAL_CONTROL)

    def _unlock(self) -> None:
        self._unlocked = bool(self._given.value)
        self._given.value = 0
