"""A node of the bus: NMT state, errors, and its feedback if it is a module."""

from __future__ import annotations

import struct
from collections import deque
from typing import NamedTuple

from canfb import objects as od
from canfb.cia301.codes import EmergencyCode, emergency_text
from canfb.cia301.nmt import NmtCommand, NmtState
from canfb.monitoring.module_model import ModuleModel
from canfb.monitoring.snapshot import EmergencySnapshot, NodeSnapshot

EMERGENCIES = 8  # that are remembered
EMERGENCY = struct.Struct("<HB5s")
CAUSE_BYTE = 2  # of the five of EMCY 7300h: as 2012:10, 0 while it is not lost
POSITION_PDO = struct.Struct("<IHH")
ALIKE = 16  # PDOs in a row that look like those of a module
LARGEST_RESIDUAL = 0x8000
NO_STATUS = 0xC000  # bits that no status word has
HEARD_STATES = {int(state): state for state in NmtState}
COMMANDED = {
    NmtCommand.START: NmtState.OPERATIONAL,
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
    NmtCommand.RESET_NODE: NmtState.INITIALISING,
    NmtCommand.RESET_COMMUNICATION: NmtState.INITIALISING,
}


class _Emergency(NamedTuple):
    time_s: float
    code: int
    register: int
    detail: bytes


class NodeModel:
    """Takes the frames of one node (1..127). ``module`` is set once it is known to be a feedback module."""

    def __init__(self, node_id: int, module: ModuleModel | None = None) -> None:
        self.node_id = node_id
        self.module = module
        self._heard_s: float | None = None
        self._state: NmtState | None = None
        self._source: str | None = None
        self._boot_ups = 0
        self._emergencies: deque[_Emergency] = deque(maxlen=EMERGENCIES)
        self._emergency_count = 0
        self._alike = 0

    def heard(self, now: float) -> None:
        """A frame of its own."""
        self._heard_s = now

    def error_control(self, data: bytes, now: float) -> None:
        """Boot-up, heartbeat or the answer of node guarding (CiA 301, 7.2.8.3.2)."""
        state = HEARD_STATES.get(data[0] & 0x7F) if len(data) == 1 else None
        if state is NmtState.INITIALISING:
            self._boot_ups += 1
            self._state, self._source = NmtState.PRE_OPERATIONAL, "boot-up"
        elif state is not None:
            self._state, self._source = state, "heartbeat"

    def commanded(self, command: int) -> None:
        """The master gives it an NMT command."""
        if command in COMMANDED:
            self._state, self._source = COMMANDED[NmtCommand(command)], "command"

    def sends_pdos(self) -> None:
        """It sends PDOs, which it does in OPERATIONAL alone; a heartbeat knows better."""
        if self._source != "heartbeat":
            self._state, self._source = NmtState.OPERATIONAL, "PDO"

    def emergency(self, data: bytes, now: float) -> None:
        """An EMCY, if it is one."""
        if len(data) == EMERGENCY.size:
            self._emergencies.append(_Emergency(now, *EMERGENCY.unpack(data)))
            self._emergency_count += 1
            code, _, detail = EMERGENCY.unpack(data)
            if self.module is not None and code == EmergencyCode.SENSOR and od.loss_cause(detail[CAUSE_BYTE]):
                self.module.put(od.COUNTER_LOSS_CAUSE, detail[CAUSE_BYTE], now)

    def is_like_a_module(self, data: bytes) -> bool:
        """Whether its TPDO1 was that of a module ALIKE times: position, status word, residual."""
        if len(data) == POSITION_PDO.size:
            _, status, residual = POSITION_PDO.unpack(data)
            self._alike += 1
            if status & NO_STATUS or residual > LARGEST_RESIDUAL:
                self._alike = 0
        else:
            self._alike = 0
        return self._alike >= ALIKE

    def snapshot(self, now: float, sync_hz: float | None = None) -> NodeSnapshot:
        """What is known by ``now``."""
        emergencies = [
            EmergencySnapshot(
                now - one.time_s,
                one.code,
                emergency_text(one.code, {} if self.module is None else od.EMERGENCY_TEXTS),
                one.register,
                one.detail.hex(),
            )
            for one in reversed(self._emergencies)
        ]
        return NodeSnapshot(
            self.node_id,
            None if self._state is None else self._state.name.replace("_", "-"),
            self._source,
            None if self._heard_s is None else max(0.0, now - self._heard_s),
            self._boot_ups,
            emergencies,
            self._emergency_count,
            None if self.module is None else self.module.snapshot(now, sync_hz),
        )
