"""What the page gets, as JSON."""

from __future__ import annotations

import json
import threading
from typing import Any

from canfb.monitoring import lines
from canfb.monitoring.layout import ModuleReading
from canfb.monitoring.lines import Line, MachineUnits
from canfb.monitoring.snapshot import BusSnapshot, ModuleSnapshot, NodeSnapshot
from canfb.scope.page_server import Event, PageServer, event
from canfb.scope.traces import Curve, ModuleTraces


class LivePage:
    """Snapshots become events of a :class:`PageServer` at ``port``."""

    def __init__(self, port: int, units: MachineUnits) -> None:
        self.server = PageServer(port, self.first)
        self._units = units
        self._traces: dict[int, ModuleTraces] = {}
        self._curves: dict[int, Curve] = {}
        self._last: BusSnapshot | None = None
        self._lock = threading.Lock()

    def know(self, reading: ModuleReading) -> None:
        if reading.correction is not None:
            with self._lock:
                self._of(reading.node_id).know(reading.correction)

    def show(self, snapshot: BusSnapshot) -> None:
        with self._lock:
            self._last = snapshot
            for node, module in snapshot.modules:
                self._of(node.node_id).take(snapshot.time_s, module)
            if not self.server.is_seen():
                return
            look = self._look(snapshot)
        self.server.publish(look)

    def first(self) -> Event:
        """Units, points and deviations until now, the last look."""
        with self._lock:
            past = {node: list(traces.points) for node, traces in self._traces.items()}
            units = {"position": self._units.name, "velocity": self._units.speed_name}
            begin = event("past", json.dumps({"units": units, "points": past, "deviations": self._curves}))
            return begin if self._last is None else begin + self._look(self._last)

    def _look(self, snapshot: BusSnapshot) -> Event:
        look = {
            "time_s": snapshot.time_s,
            "bus": [_plain(line) for line in lines.bus_lines(snapshot)],
            "others": lines.other_nodes(snapshot),
            "modules": [self._module(snapshot.time_s, *one) for one in snapshot.modules],
        }
        return event("look", json.dumps(look))

    def _of(self, node_id: int) -> ModuleTraces:
        return self._traces.setdefault(node_id, ModuleTraces(self._units))

    def _module(self, now: float, node: NodeSnapshot, module: ModuleSnapshot) -> dict[str, Any]:
        traces = self._of(node.node_id)
        if (curve := traces.deviation(now)) is not None:
            self._curves[node.node_id] = curve
        names = dict.fromkeys((*module.counters, *module.seen))
        return {
            "node": node.node_id,
            "name": lines.name_of(node),
            "state": lines.state_words(node),
            "mapping": lines.mapping_words(module),
            "tone": lines.tone_of(module),
            "lines": [_plain(line) for line in lines.module_lines(node, module, self._units)],
            "emergencies": [lines.emergency_part(one) for one in node.emergencies],
            "counters": [(name, module.counters.get(name), module.seen.get(name)) for name in names],
            "point": traces.points[-1],
            "tracks": module.tracks_counts,
            "limits": module.amplitude_limits_counts,
            "full_scale": module.full_scale_counts,
            "assumed": module.assumed,
            "deviation": curve,
        }


def _plain(line: Line) -> tuple[str, lines.Parts]:
    return line.label, tuple(part for part in line.parts if part[0])
