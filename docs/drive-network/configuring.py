"""Bring the nodes of a network to what the network file says: compare, write, read back, undo.

Only what differs is written, so a second run writes nothing. Until the configuration is complete every
write can be taken back. Needs python canopen.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import canopen
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError
from network_file import OFF, NetworkFile, Node, Pdo

ANSWER_S = 5.0  # for one SDO; saving may take longer
SAVING_S = 20.0
SYNC_PERIOD, SAVE, HEARTBEATS, HEARTBEAT = 0x1006, 0x1010, 0x1016, 0x1017


class NetworkError(Exception):
    """A node is not there, is another one, or refuses; one line with node, object and reason."""


class Access:
    """SDO to one node; what is written can be undone. ``remote`` is its canopen.RemoteNode."""

    def __init__(self, remote: Any, setup: Node, may_write: bool = True) -> None:
        self.remote, self.setup = remote, setup
        self.differences: list[str] = []
        self.may_write = may_write
        self._undo: list[tuple[int, int, bytes]] = []
        remote.sdo.RESPONSE_TIMEOUT = ANSWER_S

    def read(self, index: int, subindex: int = 0) -> bytes:
        """The bytes of an object."""
        data = self._told(index, subindex, lambda: self.remote.sdo.upload(index, subindex))
        return bytes(data)

    def number(self, index: int, subindex: int = 0) -> int:
        """An unsigned object."""
        return int.from_bytes(self.read(index, subindex), "little")

    def differs(self, index: int, subindex: int, wanted: bytes) -> bool:
        """Whether an object has another value; notes it in ``differences``."""
        found = self.read(index, subindex)
        if found != wanted:
            self.differences.append(
                f"{self.setup} {index:04X}:{subindex:02X} is {_shown(found)}, not {_shown(wanted)}"
            )
        return found != wanted

    def bring(self, index: int, subindex: int, wanted: bytes) -> None:
        """Write an object unless it has the value."""
        variable = self.setup.od.get_variable(index, subindex)
        if variable is not None and variable.access_type == "wo":  # a command: nothing to compare
            if self.may_write:
                self._write(index, subindex, wanted)
        elif self.differs(index, subindex, wanted) and self.may_write:
            self.put(index, subindex, wanted)

    def put(self, index: int, subindex: int, wanted: bytes) -> None:
        """Write an object, read it back, keep what it was for :meth:`undo`."""
        before = self.read(index, subindex)
        if before == wanted:
            return
        self._undo.append((index, subindex, before))
        self._write(index, subindex, wanted)
        after = self.read(index, subindex)
        if after != wanted:
            raise NetworkError(
                f"{self.setup} {index:04X}:{subindex:02X}: written {_shown(wanted)}, reads {_shown(after)}"
            )

    def encoded(self, index: int, subindex: int, value: int) -> bytes:
        """An unsigned value, as long as the EDS says."""
        variable = self.setup.od.get_variable(index, subindex)
        if variable is None:
            raise NetworkError(f"{self.setup} {index:04X}:{subindex:02X}: not in its EDS")
        return value.to_bytes(len(variable) // 8, "little")

    def bring_number(self, index: int, subindex: int, value: int) -> None:
        """:meth:`bring` for an unsigned object."""
        self.bring(index, subindex, self.encoded(index, subindex, value))

    def put_number(self, index: int, subindex: int, value: int) -> None:
        """:meth:`put` for an unsigned object."""
        self.put(index, subindex, self.encoded(index, subindex, value))

    def has(self, index: int, subindex: int = 0) -> bool:
        """Whether the EDS has the object."""
        return self.setup.od.get_variable(index, subindex) is not None

    def undo(self) -> None:
        """Take back what was written, last first, as far as the node lets."""
        while self._undo:
            index, subindex, before = self._undo.pop()
            try:
                self.remote.sdo.download(index, subindex, before)
            except (SdoAbortedError, SdoCommunicationError):
                continue

    def save(self) -> None:
        """Save all parameters (1010h:01). There is no undo after it."""
        self.remote.sdo.RESPONSE_TIMEOUT = SAVING_S
        self._write(SAVE, 1, b"save")
        self.remote.sdo.RESPONSE_TIMEOUT = ANSWER_S
        self._undo.clear()

    def _write(self, index: int, subindex: int, data: bytes) -> None:
        self._told(index, subindex, lambda: self.remote.sdo.download(index, subindex, data))

    def _told(self, index: int, subindex: int, transfer: Callable[[], Any]) -> Any:
        """The transfer; its error in one line."""
        try:
            return transfer()
        except SdoAbortedError as error:
            text = SdoAbortedError.CODES.get(error.code, "unknown abort code")
            raise NetworkError(
                f"{self.setup} {index:04X}:{subindex:02X}: abort {error.code:08X}h, {text}"
            ) from None
        except SdoCommunicationError:
            raise NetworkError(
                f"{self.setup} {index:04X}:{subindex:02X}: no answer; is the node on and its node-ID right?"
            ) from None


class Configuration:
    """All nodes of ``file`` on the canopen ``network``."""

    def __init__(self, network: canopen.Network, file: NetworkFile) -> None:
        self._file = file
        self.remotes: dict[str, Any] = {
            node.name: network.add_node(node.node_id, node.od) for node in file.nodes.values()
        }
        self._written: list[Access] = []

    def check_identity(self) -> None:
        """Every node answers and is the one that the file means. Nothing is written."""
        for access in self._accesses(may_write=False):
            for (index, subindex), wanted in access.setup.expect.items():
                found = access.number(index, subindex)
                if found != wanted:
                    raise NetworkError(
                        f"{access.setup} {index:04X}:{subindex:02X}: another device, "
                        f"{found:08X}h where {wanted:08X}h is expected"
                    )

    def compare(self) -> list[str]:
        """What differs from the file, one line each. Nothing is written."""
        accesses = self._accesses(may_write=False)
        for access in accesses:
            self._bring(access)
        return [line for access in accesses for line in access.differences]

    def apply(self) -> int:
        """Write what differs, in PRE-OPERATIONAL; the number of objects. Undone whole if anything fails."""
        self._written = self._accesses(may_write=True)
        try:
            for access in reversed(self._written):
                access.remote.nmt.state = "PRE-OPERATIONAL"
            for access in self._written:
                self._bring(access)
            for access in self._written:
                if access.setup.save and access.differences:
                    access.save()
        except BaseException:
            self.undo()
            raise
        return sum(len(access.differences) for access in self._written)

    def apply_to(self, name: str) -> None:
        """Write what differs to this node, after its reset. There is no undo."""
        self._bring(Access(self.remotes[name], self._file.nodes[name], may_write=True))

    def undo(self) -> None:
        """Take back what :meth:`apply` has written, unless it was saved."""
        for access in reversed(self._written):
            access.undo()

    def _accesses(self, may_write: bool) -> list[Access]:
        return [Access(self.remotes[name], node, may_write) for name, node in self._file.nodes.items()]

    def _bring(self, access: Access) -> None:
        """One node. Nobody watches anybody while heartbeats change, so that nobody is missed."""
        node = access.setup
        watched = [watched << 16 | time for watched, time in node.watches.items()]
        entries = len(node.od[HEARTBEATS]) - 1 if HEARTBEATS in node.od else 0
        wanted = watched + [0] * (entries - len(watched))
        different = [access.number(HEARTBEATS, n) for n in range(1, entries + 1)] != wanted
        for n in range(1, entries + 1) if different and access.may_write else ():
            access.put_number(HEARTBEATS, n, 0)
        for (index, subindex), data in node.parameters.items():
            access.bring(index, subindex, data)
        if access.has(SYNC_PERIOD):
            access.bring_number(SYNC_PERIOD, 0, self._file.sync_period_us)
        for pdo in node.pdos.values():
            bring_pdo(access, pdo)
        if access.has(HEARTBEAT):
            access.bring_number(HEARTBEAT, 0, node.heartbeat_ms)
        for n, value in enumerate(wanted, 1):
            access.bring_number(HEARTBEATS, n, value)


def bring_pdo(access: Access, pdo: Pdo) -> None:
    """A PDO, in the order of CiA 301 (7.5.2.36): off, no mapping, entries, their number, type, on."""
    now = access.number(pdo.index, 1)
    if pdo.cob_id is None:
        access.bring_number(pdo.index, 1, now | OFF)
        return
    entries = {(pdo.mapping_index, n): entry for n, entry in enumerate(pdo.mapping, 1)}
    kind = {(pdo.index, 2): pdo.kind} | {(pdo.index, subindex): time for subindex, time in pdo.times.items()}
    count, cob_id = {(pdo.mapping_index, 0): len(pdo.mapping)}, {(pdo.index, 1): pdo.cob_id_value}
    wanted = entries | count | kind | cob_id
    different = [
        place for place, value in wanted.items() if access.differs(*place, access.encoded(*place, value))
    ]
    if not different or not access.may_write:
        return  # a PDO that is as it should be is left alone
    access.put_number(pdo.index, 1, now | OFF)
    access.put_number(pdo.mapping_index, 0, 0)
    for place, value in wanted.items():
        access.put_number(*place, value)


def _shown(data: bytes) -> str:
    return f"{int.from_bytes(data, 'little'):0{2 * len(data)}X}h" if len(data) <= 8 else repr(data)
