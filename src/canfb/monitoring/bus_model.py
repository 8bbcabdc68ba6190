"""Everything that is heard of a bus: frames and times in, a snapshot out."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial

from canfb.cia301 import cob
from canfb.cia301.frame import HIGHEST_ID, LONGEST_DATA, Frame, frame_bits
from canfb.monitoring.layout import NodeLayout, PdoMap
from canfb.monitoring.meters import LoadMeter, SyncMeter
from canfb.monitoring.module_model import ModuleModel
from canfb.monitoring.node_model import NodeModel
from canfb.monitoring.snapshot import BusSnapshot
from canfb.objects import Multiplexer
from canfb.view.pdo_map import Number

NODES = range(1, 128)
NMT_COMMAND = 0x000
TPDOS = (cob.TPDO1, cob.TPDO2, cob.TPDO3, cob.TPDO4)
SENT = (cob.EMERGENCY, *TPDOS, cob.SDO_RESPONSE, cob.ERROR_CONTROL)
BACK_S = 1.0  # a time that is so much earlier is of another clock
Take = Callable[[bytes, float], None]


class BusModel:
    """Takes each frame of a bus; no frame raises, and what is remembered is bounded.

    ``layouts`` are the modules that are known beforehand. ``assume`` gives the layout of a node that looks
    like a module; None: nothing is assumed. ``bit_rate`` in bit/s is for the load. ``only_known``: other
    nodes are not shown.
    """

    def __init__(
        self,
        layouts: Iterable[NodeLayout] = (),
        assume: Callable[[int], NodeLayout] | None = None,
        bit_rate: int | None = None,
        *,
        only_known: bool = False,
    ) -> None:
        self._assume = assume
        self._only_known = only_known
        self._bit_rate = bit_rate
        self._nodes: dict[int, NodeModel] = {}
        self._routes: dict[int, list[Take]] = {}
        self._sync_ids: set[int] = set()
        self._error_frames = 0
        self._now: float | None = None
        self._restart()
        for layout in layouts:
            self.learn(layout)

    @property
    def now(self) -> float | None:
        """The time of the last frame, seconds; None before the first."""
        return self._now

    def learn(self, layout: NodeLayout) -> None:
        """Take, or replace, what is known of a module."""
        node = self._node(layout.node_id)
        if node.module is None:
            node.module = ModuleModel(layout)
        node.module.layout = layout
        self._route()

    def put(self, node_id: int, place: Multiplexer, value: Number, now: float) -> None:
        """A value of a known module that came by SDO."""
        module = self._node(node_id).module
        if module is not None:
            module.put(place, value, now)

    def error_frame(self) -> None:
        """The bus driver reports an error."""
        self._error_frames += 1

    def other_frame(self, data_bytes: int, now: float) -> None:
        """A frame with a 29-bit identifier, which is no CANopen and only counts for the load."""
        self._load.frame(frame_bits(min(data_bytes, LONGEST_DATA), extended=True), self._at(now))

    def receive(self, frame: Frame, now: float) -> None:
        """A frame at ``now``: when it was received, seconds."""
        now = self._at(now)
        can_id, data = frame.can_id, frame.data
        self._load.frame(frame_bits(0 if frame.rtr else min(len(data), LONGEST_DATA)), now)
        if frame.rtr or not 0 <= can_id <= HIGHEST_ID:
            return
        if can_id in self._sync_ids or (can_id == cob.SYNC and not self._sync_ids):
            self._sync.sync(now)
            return
        for take in self._routes.get(can_id, ()):
            take(data, now)
        self._by_function(can_id, data, now)

    def snapshot(self, now: float | None = None) -> BusSnapshot:
        """All of it by ``now``, by default the time of the last frame."""
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
        """Time does not go back, unless the clock was set: then all that is measured begins again."""
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
        node = self._nodes.get(node_id)
        if node is None:
            node = self._nodes[node_id] = NodeModel(node_id)
        return node

    def _route(self) -> None:
        """Which frames are understood, by the layouts of the modules."""
        self._routes, self._sync_ids = {}, set()
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
        """By the predefined connection set (CiA 301, 7.3.5)."""
        if can_id == NMT_COMMAND:
            if len(data) == 2:
                self._command(data[0], data[1])
            return
        function, node_id = can_id & ~0x7F, can_id & 0x7F
        if node_id not in NODES or function not in SENT:
            return
        node = self._node(node_id)
        node.heard(now)
        if function == cob.ERROR_CONTROL:
            node.error_control(data, now)
        elif function == cob.EMERGENCY and can_id not in self._routes:
            node.emergency(data, now)
        elif function in TPDOS:
            node.sends_pdos()
            if function == cob.TPDO1 and node.module is None and can_id not in self._routes:
                self._look_at(node, data)

    def _command(self, command: int, node_id: int) -> None:
        for node in self._nodes.values():
            if node_id in (0, node.node_id):
                node.commanded(command)

    def _look_at(self, node: NodeModel, data: bytes) -> None:
        """A node that sends what a module sends is taken for one."""
        if self._assume is not None and node.is_like_a_module(data):
            self.learn(self._assume(node.node_id))


def _sent(node: NodeModel, module: ModuleModel, pdo: PdoMap, data: bytes, now: float) -> None:
    """A PDO of a module, under whichever CAN-ID."""
    node.heard(now)
    if module.sent(pdo, data, now):
        node.sends_pdos()
