"""A bus and its nodes: frames and times in, a snapshot out; memory is bounded.

The NMT state is from heartbeat or boot-up, else from the last NMT command, or OPERATIONAL while PDOs are
received.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from functools import partial

from canfb import objects as od
from canfb.bus.frame_bus import ERROR
from canfb.cia301 import cob
from canfb.cia301.codes import COMMANDED, EMERGENCY, EmergencyCode, NmtState, emergency_text
from canfb.cia301.frame import HIGHEST_ID, LONGEST_DATA, Frame, frame_bits
from canfb.monitoring.layout import NodeLayout, Recognition, assumed_layout
from canfb.monitoring.module_model import LoadMeter, ModuleModel, SyncMeter
from canfb.monitoring.snapshot import BusSnapshot, EmergencySnapshot, NodeSnapshot
from canfb.view.module_view import Pdo

EMERGENCIES = 8  # number of EMCY that are remembered
IN_FLIGHT_S = 0.1  # after an NMT command, PDOs that have waited for the bus may arrive for this long
CAUSE_BYTE = 2  # index in the five bytes of EMCY 7300h: cause as in 2012:10, 0: not lost
# For the state in a frame 700h + id: the state of the node, and how it is known.
HEARD = {int(one): (one, "heartbeat") for one in NmtState} | {0: (NmtState.PRE_OPERATIONAL, "boot-up")}


class NodeModel:
    """Node 1..127; ``module``: None, or a feedback module."""

    def __init__(self, node_id: int) -> None:
        self.node_id = node_id
        self.module: ModuleModel | None = None
        self.received_s: float | None = None
        self._state: NmtState | None = None
        self._source: str | None = None
        self._commanded_s = -IN_FLIGHT_S
        self._boot_ups = 0
        self._emergencies: deque[tuple[float, int, int, bytes]] = deque(maxlen=EMERGENCIES)
        self._emergency_count = 0

    def error_control(self, data: bytes) -> None:
        """Evaluate boot-up, heartbeat, guarding (CiA 301, 7.2.8.3.2)."""
        heard = HEARD.get(data[0] & 0x7F) if len(data) == 1 else None
        if heard is not None:
            self._state, self._source = heard
            self._boot_ups += self._source == "boot-up"

    def commanded(self, command: int, now: float) -> None:
        if command in COMMANDED:
            self._state, self._source, self._commanded_s = COMMANDED[command], "command", now

    def sends_pdos(self, now: float) -> None:
        if self._source != "heartbeat" and not 0.0 <= now - self._commanded_s < IN_FLIGHT_S:
            self._state, self._source = NmtState.OPERATIONAL, "PDO"

    def emergency(self, data: bytes, now: float) -> None:
        """Evaluate an EMCY, if it has 8 bytes."""
        if len(data) == EMERGENCY.size:
            code, register, detail = EMERGENCY.unpack(data)
            self._emergencies.append((now, code, register, detail))
            self._emergency_count += 1
            if self.module is not None and code == EmergencyCode.SENSOR and od.loss_cause(detail[CAUSE_BYTE]):
                self.module.put(od.COUNTER_LOSS_CAUSE, detail[CAUSE_BYTE], now)

    def snapshot(self, now: float, sync_hz: float | None = None) -> NodeSnapshot:
        texts = {} if self.module is None else od.EMERGENCY_TEXTS
        emergencies = [
            EmergencySnapshot(now - at, code, emergency_text(code, texts), register, detail.hex())
            for at, code, register, detail in reversed(self._emergencies)
        ]
        return NodeSnapshot(
            self.node_id,
            None if self._state is None else self._state.name.replace("_", "-"),
            self._source,
            None if self.received_s is None else max(0.0, now - self.received_s),
            self._boot_ups,
            emergencies,
            self._emergency_count,
            None if self.module is None else self.module.snapshot(now, sync_hz),
        )


SENT = (cob.EMERGENCY, *cob.TPDOS, cob.SDO_RESPONSE, cob.ERROR_CONTROL)
BACK_S = 1.0  # if a time is earlier by this, the clock was set
Take = Callable[[bytes, float], None]


class BusModel:
    """Processes each frame of a bus; no frame raises an exception.

    ``layouts`` of known modules. ``bit_rate`` in bit/s. ``only_known``: do not recognise other modules.
    """

    def __init__(
        self,
        layouts: Iterable[NodeLayout] = (),
        bit_rate: int | None = None,
        *,
        only_known: bool = False,
    ) -> None:
        self._recognition = Recognition()
        self._only_known = only_known
        self._bit_rate = bit_rate
        self._nodes: dict[int, NodeModel] = {}
        self._error_frames = 0
        self._now: float | None = None
        self._restart()
        for layout in layouts:
            self.learn(layout)

    def learn(self, layout: NodeLayout) -> ModuleModel:
        node = self._node(layout.node_id)
        if node.module is None:
            node.module = ModuleModel(layout)
        node.module.layout = layout
        self._route()
        return node.module

    def receive(self, frame: Frame, now: float) -> None:
        """A frame, flagged as by :func:`.flagged_id`; if not CANopen, it only counts for the load."""
        can_id, data = frame.can_id, frame.data
        if can_id & ERROR:
            self._error_frames += 1
            return
        now = self._at(now)
        data_bytes = 0 if frame.rtr else min(len(data), LONGEST_DATA)
        self._load.frame(frame_bits(data_bytes, extended=can_id > HIGHEST_ID), now)
        if frame.rtr or not 0 <= can_id <= HIGHEST_ID:
            return
        if can_id in self._sync_ids or (can_id == cob.SYNC and not self._sync_ids):
            self._sync.sync(now)
            return
        for take in self._routes.get(can_id, ()):
            take(data, now)
        self._by_function(can_id, data, now)

    def snapshot(self, now: float | None = None) -> BusSnapshot:
        """State of the bus at ``now``, by default the time of the last frame."""
        now = max(self._now or 0.0, self._now or 0.0 if now is None else now)
        shown = [
            node for _, node in sorted(self._nodes.items()) if node.module is not None or not self._only_known
        ]
        sync = self._sync.snapshot(now)
        return BusSnapshot(
            now,
            sync,
            self._load.snapshot(now),
            [node.snapshot(now, sync.rate_hz) for node in shown],
            self._error_frames,
        )

    def _at(self, now: float) -> float:
        """Monotonic time; after a step of the clock all measurements restart."""
        if self._now is not None and now < self._now:
            if now < self._now - BACK_S:
                self._restart()
            else:
                now = self._now
        self._now = now
        return now

    def _restart(self) -> None:
        self._sync, self._load = SyncMeter(), LoadMeter(self._bit_rate)
        for node in self._nodes.values():
            if node.module is not None:
                node.module = ModuleModel(node.module.layout)
        self._route()

    def _node(self, node_id: int) -> NodeModel:
        if node_id not in self._nodes:
            self._nodes[node_id] = NodeModel(node_id)
        return self._nodes[node_id]

    def _route(self) -> None:
        self._routes: dict[int, list[Take]] = {}
        self._sync_ids: set[int] = set()
        for node in self._nodes.values():
            module = node.module
            if module is None:
                continue
            self._sync_ids.add(module.layout.sync_id)
            self._routes.setdefault(module.layout.emcy_id, []).append(node.emergency)
            for pdo in module.layout.inputs:
                self._routes.setdefault(pdo.can_id, []).append(partial(module.sampled, pdo))
            for pdo in module.layout.tpdos:
                self._routes.setdefault(pdo.can_id, []).append(partial(_sent, node, module, pdo))

    def _by_function(self, can_id: int, data: bytes, now: float) -> None:
        """Evaluate a frame by the predefined connection set (CiA 301, 7.3.5)."""
        if can_id == cob.NMT:
            for node in self._nodes.values():
                if len(data) == 2 and data[1] in (0, node.node_id):
                    node.commanded(data[0], now)
            return
        function, node_id = can_id & ~0x7F, can_id & 0x7F
        if node_id not in cob.NODES or function not in SENT:
            return
        node = self._node(node_id)
        node.received_s = now
        if function == cob.ERROR_CONTROL:
            node.error_control(data)
        elif function == cob.EMERGENCY and can_id not in self._routes:
            node.emergency(data, now)
        elif function in cob.TPDOS:
            node.sends_pdos(now)
            if not self._only_known and node.module is None and can_id not in self._routes:
                found = self._recognition.found(can_id, data)
                if found is not None:
                    self.learn(assumed_layout(found))


def _sent(node: NodeModel, module: ModuleModel, pdo: Pdo, data: bytes, now: float) -> None:
    node.received_s = now
    if module.sent(pdo, data, now):
        node.sends_pdos(now)
