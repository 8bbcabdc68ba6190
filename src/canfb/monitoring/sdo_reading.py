"""Reading by SDO of values that no PDO carries, while a viewer is connected.

Values are read every CYCLE_S, mapping, limits and scales every LAYOUT_S; all after a boot-up or a change of
status bit 7; the table when its CRC or conditioning changes.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Sequence
from functools import cache

from canfb import objects as od
from canfb.bus.bus_master import BusMaster
from canfb.bus.shared_bus import SharedBus, beside
from canfb.errors import CanfbError
from canfb.master.access import NodeAccess
from canfb.master.all_or_nothing import active_conditioning, read_active
from canfb.monitoring.layout import ModuleReading, NodeLayout, Origin, layout_of
from canfb.monitoring.lines import is_stale
from canfb.monitoring.snapshot import BusSnapshot, NodeSnapshot
from canfb.signal.correction import Correction
from canfb.view.module_view import Number

CYCLE_S, LAYOUT_S = 2.0, 30.0
QUIET_S = 5.0  # pause after a node has not answered
ANSWER_S = 1.0
LOOK_S = 0.1
# Objects read every CYCLE_S unless a PDO carries them.
REPEATED = (
    od.FEEDBACK_STATUS,
    od.FEEDBACK_AMPLITUDE,
    od.FEEDBACK_VELOCITY,
    od.FEEDBACK_NOISE,
    od.TABLE_ACTIVE_CRC,
    od.COUNTER_LOSS_CAUSE,
    *od.COUNTERS,
)


class ModuleReader:
    """Reads one module (1..127), ``with_table`` also its table."""

    def __init__(self, node_id: int, *, with_table: bool = False) -> None:
        self.node_id = node_id
        self._with_table = with_table
        self._layout: NodeLayout | None = None
        self._correction: Correction | None = None
        self._seen: tuple[int, bool] | None = None
        self._due_s = self._layout_due_s = self._not_before_s = -math.inf

    def due(self, now: float, node: NodeSnapshot | None) -> bool:
        """Whether to read now, given the state of the node on the bus."""
        return now >= self._not_before_s and (now >= self._due_s or _changes(node) != self._seen)

    def read(self, module: NodeAccess, now: float, node: NodeSnapshot | None) -> ModuleReading:
        """Read the module; after CanfbError (no answer) it pauses for QUIET_S."""
        seen = _changes(node)
        self._not_before_s = now + QUIET_S
        if self._layout is None or seen != self._seen or now >= self._layout_due_s:
            self._layout = layout_of(self.node_id, cache(module.read_known), Origin.MODULE)
            self._layout_due_s = now + LAYOUT_S
        heard = node is not None and node.module is not None and not is_stale(node.module)
        pdos = self._layout.tpdos if heard else ()
        carried = {place for pdo in pdos for place in pdo.values(bytes(pdo.length_bytes))}
        values = {place: module.read_known(place) for place in REPEATED if place not in carried}
        found = {place: value for place, value in values.items() if value is not None}
        if self._with_table:
            self._correction = self._active(module, found.get(od.TABLE_ACTIVE_CRC))
        self._seen, self._due_s, self._not_before_s = seen, now + CYCLE_S, now
        return ModuleReading(found, self._layout, self._correction)

    def _active(self, module: NodeAccess, crc32: Number | None) -> Correction:
        known = self._correction
        if known is not None and known.crc32 == crc32 and known.conditioning == active_conditioning(module):
            return known
        return read_active(module)


def _changes(node: NodeSnapshot | None) -> tuple[int, bool] | None:
    return None if node is None or node.module is None else (node.boot_ups, node.module.table_active)


Take = Callable[[ModuleReading], None]


def reading_beside(
    bus: SharedBus,
    readers: Sequence[ModuleReader],
    latest: Callable[[], BusSnapshot | None],
    take: Take,
    wanted: Callable[[], bool],
    failed: Callable[[], None],
) -> contextlib.AbstractContextManager[None]:
    """During the context a thread runs ``readers`` on a branch of ``bus`` while ``wanted()``.

    ``latest`` gives the last snapshot, ``take`` gets each reading, in this thread. ``failed`` is called after
    an error.
    """
    stopped = threading.Event()

    def run() -> None:
        while not stopped.wait(LOOK_S):
            if wanted():
                look(time.monotonic())

    def look(now: float) -> None:
        snapshot = latest()
        nodes = {} if snapshot is None else {node.node_id: node for node in snapshot.nodes}
        due = [reader for reader in readers if reader.due(now, nodes.get(reader.node_id))]
        if not due:
            return
        with BusMaster(bus.branch(), ANSWER_S) as master:
            for reader in due:
                module = NodeAccess(master, reader.node_id, "module")
                with contextlib.suppress(CanfbError):
                    take(reader.read(module, now, nodes.get(reader.node_id)))

    return beside(run, stopped.set, failed)
