"""The nodes of the network while it runs: SYNC and heartbeat of the master, NMT, EMCY, who is still there.

Needs python canopen.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from typing import Any

import can
import canopen
from axis import PATIENCE_S, FaultError
from canopen.network import MessageListener
from network_file import NetworkFile
from sync import produce

LOOK_S = 0.002
HEARTBEAT, OPERATIONAL = 0x700, 5
AFTER_BOOT_UP = (0, 127)  # the boot-up itself, then PRE-OPERATIONAL
MISSED_HEARTBEATS = 10  # of a node, before the master calls it lost
ERRORS = {
    0x0000: "no error any more",
    0x7300: "sensor",
    0x7305: "feedback not valid or missing",
    0x7320: "position that cannot be",
    0x8100: "communication",
    0x8130: "heartbeat of another node lost",
    0x8611: "following error",
    0x8700: "no SYNC",
    0xFF1C: "the motor's encoder disagrees",
}  # what canopen has no words for


class Listener(MessageListener):
    """canopen's listener; a bus failure is reported in one line (``network.check``), not by its thread."""

    def on_error(self, exc: Exception) -> None:
        """The reception has ended; python-can keeps the reason."""


class Nodes:
    """Starts the nodes, produces SYNC and heartbeat, watches everybody. Leaves all PRE-OPERATIONAL.

    ``clock``, ``wait`` and ``sync`` are those of the system, but for tests.
    """

    def __init__(
        self,
        network: canopen.Network,
        file: NetworkFile,
        remotes: dict[str, Any],
        clock: Callable[[], float] = time.monotonic,
        wait: Callable[[float], None] = time.sleep,
        sync: Callable[[canopen.Network, NetworkFile], Any] = produce,
    ) -> None:
        self._network, self._file, self._remotes = network, file, remotes
        self._clock, self.wait, self._sync = clock, wait, sync
        self._heard: dict[str, tuple[float, int]] = {}  # time and state of the last heartbeat
        self._emergencies: list[str] = []
        self._tasks: list[Any] = []
        self.on_duty: set[str] = set()  # who must be OPERATIONAL
        for name, remote in remotes.items():
            remote.nmt.add_heartbeat_callback(lambda state, name=name: self._hear(name, state))
            remote.emcy.add_callback(lambda error, name=name: self._note(name, error))
            self._listen(name, remote)

    def start(self) -> None:
        """Heartbeat and SYNC of the master, then the nodes one by one."""
        master = self._file.master_id
        if self._file.master_heartbeat_ms:
            beat = self._file.master_heartbeat_ms / 1000
            self._tasks.append(self._network.send_periodic(HEARTBEAT + master, bytes([OPERATIONAL]), beat))
        self._tasks.append(self._sync(self._network, self._file))
        self.start_nodes()
        print(f"started: {', '.join(self._file.nodes)}")

    def start_nodes(self) -> None:
        """All, one by one."""
        for name in self._file.nodes:
            self._start_node(name)

    def _start_node(self, name: str) -> None:
        """NMT start, and wait for the heartbeat that says so."""
        self._remotes[name].nmt.state = "OPERATIONAL"
        if self._file.nodes[name].heartbeat_ms:
            self.until(lambda: self._state(name) == OPERATIONAL, PATIENCE_S, f"{name} to become OPERATIONAL")
            self.on_duty.add(name)

    def stop_node(self, name: str, state: str) -> None:
        """Take a node out of OPERATIONAL: STOPPED or PRE-OPERATIONAL."""
        self.on_duty.discard(name)
        self._heard.pop(name, None)
        self._remotes[name].nmt.state = state

    def reset_node(self, name: str) -> None:
        """NMT reset node, and wait for its boot-up; the others are PRE-OPERATIONAL, for they watch it."""
        self._stop_all()
        self.stop_node(name, "RESET")
        self.until(lambda: self._state(name) in AFTER_BOOT_UP, PATIENCE_S, f"the boot-up of {name}")

    def _stop_all(self) -> None:
        """Drives first."""
        for name in reversed(list(self._file.nodes)):
            self.stop_node(name, "PRE-OPERATIONAL")

    def close(self) -> None:
        """All nodes PRE-OPERATIONAL, drives first; no SYNC, no heartbeat any more."""
        with contextlib.suppress(can.CanError, OSError):  # the bus may be what has failed
            self._stop_all()
        for task in self._tasks:
            with contextlib.suppress(can.CanError, OSError):
                task.stop()
        self._tasks.clear()
        self._report_emergencies()

    def until(self, true: Callable[[], bool], seconds: float, what: str) -> None:
        """Wait for ``what``; FaultError when it does not come, or when a node fails meanwhile."""
        end = self._clock() + seconds
        while not true():
            self._report_emergencies()
            self._check_nodes()
            self._network.check()  # raises when the bus has failed
            if self._clock() > end:
                raise FaultError(f"waited {seconds:g} s for {what}")
            self.wait(LOOK_S)

    def _check_nodes(self) -> None:
        for name in self.on_duty:
            heard, state = self._heard[name]
            node = self._file.nodes[name]
            if self._clock() - heard > MISSED_HEARTBEATS * node.heartbeat_ms / 1000:
                raise FaultError(f"{node}: no heartbeat any more")
            if state != OPERATIONAL:
                raise FaultError(f"{node}: no longer OPERATIONAL, NMT state {state}")

    def _state(self, name: str) -> int | None:
        return self._heard[name][1] if name in self._heard else None

    def _hear(self, name: str, state: int) -> None:
        self._heard[name] = (self._clock(), state)

    def _note(self, name: str, error: Any) -> None:
        meaning = ERRORS.get(error.code) or error.get_desc() or "see its manual"
        self._emergencies.append(f"  EMCY of {self._file.nodes[name]}: {error.code:04X}h, {meaning}")

    def _report_emergencies(self) -> None:
        while self._emergencies:
            print(self._emergencies.pop(0))

    def _listen(self, name: str, remote: Any) -> None:
        """Give canopen the PDOs of the file, so that it need not read them from the nodes."""
        for pdo in self._file.nodes[name].pdos.values():
            if pdo.cob_id is None:
                continue
            known = (remote.tpdo if pdo.is_tpdo else remote.rpdo)[pdo.number]
            known.clear()
            for entry in pdo.mapping:
                known.add_variable(entry >> 16, entry >> 8 & 0xFF, entry & 0xFF)
            known.cob_id, known.enabled, known.trans_type = pdo.cob_id, True, pdo.kind
            if pdo.is_tpdo:
                known.subscribe()
