"""A backup back into a module: written in order, proven, saved; or the parameters from before."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from canfb import objects as od
from canfb.backup.backup_file import Backup, NodeIdentity
from canfb.cia301.nmt import NmtCommand, NmtState
from canfb.master.access import CommissioningError, NodeAccess
from canfb.master.active_table import check_can_save
from canfb.master.all_or_nothing import Guard, change
from canfb.master.node_state import nmt_state
from canfb.sdo.object_description import Place

STORES = (od.STORE_ALL_PARAMETERS,)
LEFT_ALONE = (od.TABLE_STAGED,)  # compared by the CRC of the active table
NMT = 0x000
MOST_SHOWN = 40


class SdoWrite(Protocol):
    """One SDO write."""

    @property
    def index(self) -> int:
        """Of the object."""

    @property
    def subindex(self) -> int:
        """Of the object."""

    @property
    def data(self) -> bytes:
        """As SDO has it."""


class Configured(Protocol):
    """:class:`canfb.module.device_configuration.DeviceConfiguration`."""

    def values(self) -> dict[Place, Any]:
        """The value of each object."""

    def writes(self) -> Sequence[SdoWrite]:
        """SDO writes that bring it about in Pre-operational, in their order."""


@dataclass(frozen=True)
class RestoreOptions:
    """The options of ``canfb restore``: save at the end, accept another major revision or what is unknown,
    send the node to PRE-OPERATIONAL first, write nothing.
    """

    keep: bool = False
    force: bool = False
    preop: bool = False
    dry_run: bool = False


@dataclass(frozen=True)
class Restored:
    """What came out.

    changes     the value of before and of the backup, of each object that differs
    untouched   the parameters that are not in the backup, and stay as they are
    wishes      what was asked for
    """

    module: NodeAccess
    identity: NodeIdentity
    changes: dict[Place, tuple[Any, Any]]
    untouched: list[Place]
    wishes: RestoreOptions
    saved_as: str | None


class Restoring:
    """Backups into one module.

    ``read`` gives its configuration; CanfbError where that does not work.
    """

    def __init__(self, module: NodeAccess, read: Callable[[], Configured], guard: Guard) -> None:
        self._module = module
        self._read = read
        self._guard = guard

    def restore(
        self, backup: Backup, made: Callable[[dict[Place, Any]], Configured], wishes: RestoreOptions
    ) -> Restored:
        """Write, prove, save. CommissioningError if anything does not work; then all is as it was before.

        ``made`` makes the configuration of the backup, with the values of before for what is not in it.
        """
        identity = self._check_identity(backup, wishes.force)
        before = self._read()
        after = made(before.values())
        changes = differences(before, after)
        if wishes.keep:
            check_can_save(self._module, STORES)
        saved_as = None
        if not wishes.dry_run:
            if changes:
                self._leave_operational(wishes.preop)
            saved_as = self._write_and_prove(before, after, bool(changes), wishes.keep)
        tables = {od.TABLE_STAGED, od.TABLE_ACTIVATE}
        untouched = sorted(before.values().keys() - backup.values.keys() - tables)
        return Restored(self._module, identity, changes, untouched, wishes, saved_as)

    def _check_identity(self, backup: Backup, force: bool) -> NodeIdentity:
        there = NodeIdentity(*(self._module.integer(*place, "I") for place in od.IDENTITY))
        if there[:2] != backup.identity[:2]:
            ours, theirs = (
                f"product {one.product} of vendor {one.vendor}" for one in (there, backup.identity)
            )
            raise CommissioningError(
                f"{self._module.name} is {ours}, the backup is of {theirs}: it is for another device"
            )
        major, other = there.revision >> 16, backup.identity.revision >> 16
        if major != other and not force:
            raise CommissioningError(
                f"{self._module.name} has the major revision {major} (1018:03), the backup is of {other}: "
                "its objects may mean something else; --force restores what both have"
            )
        return there

    def _leave_operational(self, preop: bool) -> None:
        """CommissioningError while PDOs are sent on which somebody may rely."""
        module = self._module
        if preop:
            module.master.send(NMT, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, module.node_id)))
        if nmt_state(module) is not NmtState.OPERATIONAL:
            return
        if preop:
            raise CommissioningError(f"{module.name} does not go to PRE-OPERATIONAL; nothing was written")
        raise CommissioningError(
            f"{module.name} is in OPERATIONAL: a restore switches its PDOs off meanwhile, and may move its "
            f"position. Stop the machine, and give --preop (or canfb nmt preop {module.node_id:#04x})"
        )

    def _write_and_prove(
        self, before: Configured, after: Configured, differs: bool, keep: bool
    ) -> str | None:
        def prove(configured: Configured, wrong: str) -> None:
            if differs:
                self._write(configured)
                left = differences(self._read(), configured)
                if left:
                    raise CommissioningError(f"{self._module.name}: {wrong}: {shown(left)}")

        return change(
            self._module,
            self._guard,
            lambda: prove(after, "not as written"),
            lambda: prove(before, "not as before"),
            what="what was before",
            undone=lambda: f"the parameters and the table from before are in {self._module.name} again",
            keep=keep,
            stores=STORES,
        )

    def _write(self, configured: Configured) -> None:
        for one in configured.writes():
            if (one.index, one.subindex) == od.TABLE_STAGED:
                self._module.download_domain(one.index, one.subindex, one.data)
            else:
                self._module.write_bytes(one.index, one.subindex, one.data)


def differences(one: Configured, other: Configured) -> dict[Place, tuple[Any, Any]]:
    """The objects whose values differ, in order; None for an object that one of both does not have."""
    values, others = one.values(), other.values()
    places = sorted((values.keys() | others.keys()) - set(LEFT_ALONE))
    pairs = {place: (values.get(place), others.get(place)) for place in places}
    return {place: pair for place, pair in pairs.items() if pair[0] != pair[1] and not _both_nan(*pair)}


def shown(changes: dict[Place, tuple[Any, Any]]) -> str:
    """Differences in a line."""
    texts = [
        f"{od.place_text(place)} is {there!r}, not {after!r}" for place, (there, after) in changes.items()
    ]
    more = f" and {len(texts) - MOST_SHOWN} more" if len(texts) > MOST_SHOWN else ""
    return ", ".join(texts[:MOST_SHOWN]) + more


def _both_nan(one: Any, other: Any) -> bool:
    return bool(one != one and other != other)
