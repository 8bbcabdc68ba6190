"""What a node tells its program: one method for each event, called from within the calls of the node."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from canfb.cia301.nmt import NmtState
from canfb.device.od.dictionary import Entry
from canfb.device.storage.image import ParameterGroup

Groups = list[ParameterGroup]


class Expiry(Protocol):
    """Until when, seconds, the process data of the program holds."""

    until: float


class HeldRpdo(Protocol):
    """A synchronous RPDO."""

    def synchronise(self, now: float) -> None:
        """Take over what came since the last SYNC, with `rpdo_received`."""


# After a SYNC: no TPDOs are sent, they are, or they are and `tpdos_sampled` is called then.
IGNORED, FOLLOWED, REVOKED = range(3)


class ProcessData:
    """What SYNCs and PDOs are for the program, in one object, so that a frame takes no detour.

    The rules of `Application` hold.
    """

    def synchronise(self, counter: int | None, now: float, waiting: Sequence[HeldRpdo]) -> int:
        """A SYNC in OPERATIONAL (CiA 301, 7.2.5), `counter` None without 1019h; `waiting` RPDOs are taken
        over, then come the synchronous TPDOs, as the result says.
        """
        for rpdo in waiting:
            rpdo.synchronise(now)
        self.sync_received(counter, now)
        return FOLLOWED

    def rpdo_received(self, number: int, now: float) -> None:
        """RPDO `number` is in the dictionary."""

    def sync_received(self, counter: int | None, now: float) -> None:
        """A SYNC, after its RPDOs."""

    def tpdos_sampled(self) -> None:
        """The synchronous TPDOs are sampled."""

    def idle_sync_received(self, counter: int | None) -> None:
        """A SYNC in PRE-OPERATIONAL."""

    def rpdo_too_short(self, number: int, received: int, mapped: int, now: float) -> None:
        """RPDO `number` was dropped."""


class Application(ProcessData):
    """The program behind a :class:`canfb.device.node.Node`: a subclass overrides what it needs.

    The methods may write entries and use the node, but not its `receive` or `tick`. What they raise comes out
    of the call. Times are seconds, monotonic.
    """

    def expired(self, now: float) -> None:
        """A frame after `Expiry.until` is about to be taken."""

    def overdue(self, now: float) -> None:
        """A `tick` at or after `Expiry.until`."""

    def time_received(self, days: int, milliseconds: int, now: float) -> None:
        """TIME: days since 1984-01-01, milliseconds of the day."""

    def state_changed(self, old: NmtState, new: NmtState, now: float, why: str) -> None:
        """Another NMT state; `why` in words, "" for a command or a start."""

    def reset_done(self, communication_only: bool, now: float) -> None:
        """A reset, or the start, before the boot-up: report again what persists."""

    def configuration_changed(self) -> None:
        """PDO parameters or the NMT state have changed."""

    def check_write(self, entry: Entry | None) -> None:
        """SDO is about to write `entry`, or LSS to configure (None). SdoAbort refuses it."""

    def parameters_refused(self, faults: Mapping[ParameterGroup, str], now: float) -> None:
        """Stored parameters that were refused, and why: after a reset, and when it changes."""

    def parameters_saved(self, saved: Groups, forgotten: Groups, now: float) -> None:
        """These groups were saved, or dropped from the store."""

    def saving_failed(self, groups: Groups, reason: str, now: float) -> None:
        """These groups were not saved."""

    def emergency_sent(self, code: int, register: int, detail: bytes, now: float) -> None:
        """An EMCY goes out, with 1001h and 5 bytes."""

    def duplicate_received(self, can_id: int, now: float) -> None:
        """Another node uses a CAN-ID of this one, first time after a reset."""

    def communication_failed(self, now: float) -> None:
        """Heartbeat, guarding master or bus is lost; the state changes next."""

    def bit_rate_activated(self, kbit_s: int, delay_s: float, now: float) -> None:
        """LSS activates this bit rate: change it at `now` + `delay_s`; the node is silent up to twice
        that.
        """
