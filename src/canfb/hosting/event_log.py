"""The log of a program on its nodes; events that are too frequent are counted."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from canfb import objects as od
from canfb.bus.clocks import local_time
from canfb.cia301.datatypes import encode
from canfb.device.lss import UNCONFIGURED
from canfb.device.node import NodeDevice
from canfb.module.events import Event, NodeEvents
from canfb.module.feedback_module import FeedbackModule
from canfb.module.parameters import configured_defaults

BURST = 5  # items of one key that pass in a window
WINDOW_S = 1.0
LONGEST_WINDOW_S = 10.0


Held = tuple[int, float, Any]  # Number of items held back, in how many seconds, and the last one.


@dataclass(slots=True)
class _Window:
    began_s: float
    length_s: float = WINDOW_S
    count: int = 0
    last: Any = None


class Throttle:
    """Lets BURST items of a key pass in a window of WINDOW_S to LONGEST_WINDOW_S, and counts the others."""

    def __init__(self) -> None:
        self._windows: dict[Hashable, _Window] = {}

    def admits(self, key: Hashable, item: Any, now: float) -> bool:
        window = self._windows.setdefault(key, _Window(now))
        window.count += 1
        window.last = item
        return window.count <= BURST

    def ended(self, now: float, *, closing: bool = False) -> list[Held]:
        """Items held back in windows that are over; ``closing``: in all windows."""
        found = []
        for key, window in list(self._windows.items()):
            if closing or now - window.began_s >= window.length_s:
                del self._windows[key]
                held = window.count - BURST
                if held > 0:
                    found.append((held, now - window.began_s, window.last))
                    length_s = min(2.0 * window.length_s, LONGEST_WINDOW_S)
                    self._windows[key] = _Window(now, length_s, BURST)
        return found


SUMMED_UP = (  # counters in the closing line
    od.COUNTER_MISSED,
    od.COUNTER_RESIDUAL,
    od.COUNTER_AMPLITUDE,
    od.COUNTER_COASTED,
    od.COUNTER_LOST,
)


def name_of(device: NodeDevice) -> str:
    node_id = device.node_id_at_power_on()
    if node_id == UNCONFIGURED:
        return f"without a node-ID yet (LSS, serial number {_serial_number(device)})"
    return f"{node_id} ({node_id:02X}h)"


def title_of(device: NodeDevice) -> str:
    node_id = device.node_id
    if node_id == UNCONFIGURED:
        return f"node without a node-ID (serial number {_serial_number(device)})"
    return f"node {node_id} ({node_id:02X}h)"


def short_title_of(device: NodeDevice) -> str:
    return title_of(device) if device.node_id == UNCONFIGURED else f"node {device.node_id}"


def duplicates_of(device: NodeDevice) -> str:
    duplicates = device.counters.duplicate_frames
    return f"; {duplicates} frames of another node with this node-ID" if duplicates else ""


def warn_of_another(device: NodeDevice, title: Callable[[NodeDevice], str]) -> None:
    device.on_duplicate = lambda can_id, now: log.warning(
        f"{title(device)}: another node on the bus uses this node-ID ({can_id:03X}h)"
    )


def _serial_number(device: NodeDevice) -> int:
    return int(device.dictionary.entry(*od.IDENTITY_SERIAL_NUMBER).value)


def what_is_saved(module: FeedbackModule, name: str) -> list[str]:
    """A line on configured values that saved ones replace; empty if there are none."""
    module.storage.restore()  # read them now; the start restores again
    entries = {place: module.dictionary.entry(*place) for place in configured_defaults(module.config)}
    changed = [
        f"{index:04X}h:{subindex:02X}"
        for (index, subindex), one in entries.items()
        if encode(one.data_type, one.value) != encode(one.data_type, one.default)
    ]
    said = f"node {name}: saved values take precedence over the configuration: {', '.join(changed)}"
    return [said] if changed else []


def speeds_of(modules: Iterable[tuple[FeedbackModule, str]]) -> list[str]:
    names: dict[str, list[str]] = {}
    for module, name in modules:
        if text := module.speed_limit():
            names.setdefault(text, []).append(name)
    return [f"node {', '.join(those)}: {text}" for text, those in names.items()]


def summary_of(module: FeedbackModule) -> str:
    entry = module.dictionary.entry
    counts = ", ".join(f"{od.COUNTERS[place]} {entry(*place).value}" for place in SUMMED_UP)
    return (
        f"{short_title_of(module)}: {entry(*od.FEEDBACK_SAMPLES).current()} samples; {counts}"
        f"{duplicates_of(module)}"
    )


log = logging.getLogger(__name__)


class EventLog:
    """Writes events of nodes to the logger at the next :meth:`tick`; ``verbose``: single faults, too.

    A record has the attribute `event`.
    """

    def __init__(self, verbose: bool = False, wall: Callable[[], datetime] = local_time) -> None:
        self._verbose = verbose
        self._wall = wall
        self._throttle = Throttle()
        self._noted: deque[tuple[datetime, int, str, Event, str, Mapping[str, Any]]] = deque()
        self._begun = False

    def watch(self, device: NodeDevice, events: NodeEvents) -> None:
        events.detailed = self._verbose
        events.on_event = lambda event: self._take(device, event)

    def begin(self) -> None:
        self._begun = True
        self._write_noted()

    def tick(self, now: float) -> None:
        self._note_held(self._throttle.ended(now))
        if self._begun:
            self._write_noted()

    def close(self, now: float) -> None:
        self._note_held(self._throttle.ended(now, closing=True))
        self.begin()

    def _take(self, device: NodeDevice, event: Event) -> None:
        self._note_held(self._throttle.ended(event.time_s))
        if self._throttle.admits((id(device), event.kind), (device, event), event.time_s):
            self._note(device, event, event.text, {})

    def _note_held(self, ended: list[Held]) -> None:
        for number, seconds, (device, event) in ended:
            text = f"{number} more in the last {seconds:.3g} s; the last: {event.text}"
            self._note(device, event, text, {"more": number, "seconds": round(seconds, 3)})

    def _note(self, device: NodeDevice, event: Event, text: str, more: Mapping[str, Any]) -> None:
        self._noted.append((self._wall(), device.node_id, title_of(device), event, text, more))

    def _write_noted(self) -> None:
        while self._noted:
            at, node_id, title, event, text, more = self._noted.popleft()
            head = {
                "time": at.isoformat(timespec="milliseconds"),
                "event": str(event.kind),
                "node": node_id,
                "text": text,
            }
            values = {**head, **event.values, **more, "monotonic_s": event.time_s}
            time_of_day = at.replace(tzinfo=None).isoformat(" ", "milliseconds")
            log.info("%s", f"{time_of_day} {title}: {text}", extra={"event": values})
