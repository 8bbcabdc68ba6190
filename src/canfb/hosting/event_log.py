"""What a program says of the nodes that it serves; what comes too often is counted."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from canfb import objects as od
from canfb.bus.clocks import local_time
from canfb.cia301.datatypes import encode
from canfb.device.core import NEVER
from canfb.device.lss import UNCONFIGURED
from canfb.device.node import Node
from canfb.module.events import DETAILS, Event, NodeEvents
from canfb.module.feedback_module import FeedbackModule
from canfb.module.parameters import configured_defaults

T = TypeVar("T")
BURST = 5  # that pass in a window
WINDOW_S = 1.0
LONGEST_WINDOW_S = 10.0


@dataclass(frozen=True, slots=True)
class Held(Generic[T]):
    """How many were held back in the last ``seconds``, and the last of them."""

    key: Hashable
    count: int
    seconds: float
    last: T


@dataclass(slots=True)
class _Window(Generic[T]):
    """From ``began_s`` on, for ``length_s``."""

    began_s: float
    length_s: float
    passed: int
    held: int = 0
    last: T | None = None


class Throttle(Generic[T]):
    """Lets BURST items of a key pass in WINDOW_S, and counts the rest; the window grows to
    LONGEST_WINDOW_S.
    """

    def __init__(self) -> None:
        self._windows: dict[Hashable, _Window[T]] = {}
        self.deadline = NEVER
        """When :meth:`ended` is to be called next."""

    def admits(self, key: Hashable, item: T, now: float) -> bool:
        """Whether this one passes; else it is counted."""
        window = self._windows.get(key)
        if window is None:
            self._windows[key] = _Window(now, WINDOW_S, 1)
            self.deadline = min(self.deadline, now + WINDOW_S)
            return True
        if window.passed < BURST:
            window.passed += 1
            return True
        window.held += 1
        window.last = item
        return False

    def ended(self, now: float) -> list[Held[T]]:
        """What was held back in windows that have ended by ``now``."""
        if now < self.deadline:
            return []
        over = [key for key, window in self._windows.items() if now >= window.began_s + window.length_s]
        return self._close(over, now, go_on=True)

    def close(self, now: float) -> list[Held[T]]:
        """What is held back at the end."""
        return self._close(list(self._windows), now, go_on=False)

    def _close(self, keys: list[Hashable], now: float, *, go_on: bool) -> list[Held[T]]:
        lines = []
        for key in keys:
            window = self._windows.pop(key)
            if window.last is not None:
                lines.append(Held(key, window.held, now - window.began_s, window.last))
                if go_on:
                    length_s = min(2.0 * window.length_s, LONGEST_WINDOW_S)
                    self._windows[key] = _Window(now, length_s, BURST)
        ends = (window.began_s + window.length_s for window in self._windows.values())
        self.deadline = min(ends, default=NEVER)
        return lines


COUNTERS = {
    "missed": od.COUNTER_MISSED,
    "residual": od.COUNTER_RESIDUAL,
    "amplitude": od.COUNTER_AMPLITUDE,
    "coasted": od.COUNTER_COASTED,
    "lost": od.COUNTER_LOST,
}
"""What the closing line counts."""


class Served(Protocol):
    """A device of ours around a node."""

    @property
    def node(self) -> Node:
        """Its node."""


def name_of(device: Served) -> str:
    """The node-ID that it has, or is going to have; before its start."""
    node = device.node
    node.storage.power_on()  # a node-ID stored by LSS takes precedence over the configuration
    node.lss.power_on()
    node_id = node.lss.pending_node_id
    if node_id == UNCONFIGURED:
        return f"without a node-ID yet (LSS, serial number {_serial_number(node)})"
    return f"{node_id} ({node_id:02X}h)"


def title_of(device: Served) -> str:
    """The node, by the node-ID that it has now."""
    node_id = device.node.node_id
    if node_id == UNCONFIGURED:
        return f"node without a node-ID (serial number {_serial_number(device.node)})"
    return f"node {node_id} ({node_id:02X}h)"


def short_title_of(device: Served) -> str:
    """The same, for a line with figures."""
    node_id = device.node.node_id
    return title_of(device) if node_id == UNCONFIGURED else f"node {node_id}"


def duplicates_of(device: Served) -> str:
    """Frames of another node with the same node-ID, "" for none."""
    duplicates = device.node.counters.duplicate_frames
    return f"; {duplicates} frames of another node with this node-ID" if duplicates else ""


def _serial_number(node: Node) -> int:
    return int(node.dictionary.entry(*od.IDENTITY_SERIAL_NUMBER).value)


def what_is_saved(module: FeedbackModule, name: str) -> list[str]:
    """Which values of the configuration are not used, because others were saved: a line, or none."""
    module.node.storage.restore()  # the start does it again
    changed = []
    for index, subindex in configured_defaults(module.config):
        entry = module.dictionary.entry(index, subindex)
        if encode(entry.data_type, entry.value) != encode(entry.data_type, entry.default):
            changed.append(f"{index:04X}h:{subindex:02X}")
    objects = ", ".join(changed)
    if not changed:
        return []
    return [f"node {name}: saved values take precedence over the configuration: {objects}"]


def speeds_of(modules: Iterable[tuple[FeedbackModule, str]]) -> list[str]:
    """How fast the encoders may turn for a jitter of SYNC."""
    names: dict[str, list[str]] = {}
    for module, name in modules:
        if text := module.speed_limit():
            names.setdefault(text, []).append(name)
    return [f"node {', '.join(those)}: {text}" for text, those in names.items()]


def summary_of(module: FeedbackModule) -> str:
    """Samples and counters of the module, at the end."""
    counts = ", ".join(f"{name} {module.dictionary.entry(*place).value}" for name, place in COUNTERS.items())
    samples = module.dictionary.entry(*od.FEEDBACK_SAMPLES).value
    return f"{short_title_of(module)}: {samples} samples; {counts}{duplicates_of(module)}"


log = logging.getLogger(__name__)

Occurrence = tuple[Served, Event]


class _Noted(NamedTuple):
    at: datetime
    node_id: int
    title: str
    event: Event
    text: str
    more: Mapping[str, Any]


class EventLog:
    """Writes what happens in nodes to the logger; with ``verbose`` single faults, too.

    An event is written by the next :meth:`tick`: no position PDO waits for text. Its record has the attribute
    `event`.
    """

    def __init__(self, verbose: bool = False, wall: Callable[[], datetime] = local_time) -> None:
        self._verbose = verbose
        self._wall = wall
        self._throttle: Throttle[Occurrence] = Throttle()
        self._noted: deque[_Noted] = deque()
        self._begun = False

    def watch(self, device: Served, events: NodeEvents) -> None:
        """Write the events of this device from now on."""
        events.detailed = self._verbose
        events.on_event = lambda event: self._take(device, event)

    def begin(self) -> None:
        """The nodes are on the bus: write what has happened."""
        self._begun = True
        self._write_noted()

    def tick(self, now: float) -> None:
        """Write what has happened, and what was held back, when it is due."""
        self._note_held(self._throttle.ended(now))
        if self._begun:
            self._write_noted()

    def close(self, now: float) -> None:
        """Write all there is, at the end."""
        self._note_held(self._throttle.close(now))
        self.begin()

    def _take(self, device: Served, event: Event) -> None:
        if event.kind in DETAILS and not self._verbose:
            return
        self._note_held(self._throttle.ended(event.time_s))
        if self._throttle.admits((id(device), event.kind), (device, event), event.time_s):
            self._note((device, event), event.text, {})

    def _note_held(self, ended: list[Held[Occurrence]]) -> None:
        for held in ended:
            text = f"{held.count} more in the last {held.seconds:.3g} s; the last: {held.last[1].text}"
            more = {"more": held.count, "seconds": round(held.seconds, 3)}
            self._note(held.last, text, more)

    def _note(self, occurrence: Occurrence, text: str, more: Mapping[str, Any]) -> None:
        device, event = occurrence  # whose node-ID may be another one soon
        noted = _Noted(self._wall(), device.node.node_id, title_of(device), event, text, more)
        self._noted.append(noted)

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
