"""The events of nodes as lines of a log: each with its time, and not more than a person can read."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Mapping
from datetime import datetime
from typing import Any, NamedTuple

from canfb.bus.module_lines import Served, title_of
from canfb.bus.throttle import Held, Throttle
from canfb.bus.wall_clock import local_time
from canfb.module.event import DETAILS, Event
from canfb.module.node_events import NodeEvents

log = logging.getLogger(__name__)

Told = tuple[Served, Event]


class _Noted(NamedTuple):
    at: datetime
    node_id: int
    title: str
    event: Event
    text: str
    more: Mapping[str, Any]


class EventLog:
    """Writes what happens in nodes to the logger, as information; with ``verbose`` single faults, too.

    An event is noted when it happens and written by the next :meth:`tick`: the position PDO of a bad sample
    must not wait for a line of text. A record has the attribute `event`, a dict of plain values for programs.
    What a node repeats within a second is counted, and reported by :meth:`tick`. What happens before
    :meth:`begin` waits for it. ``wall`` is the time of day, for tests.
    """

    def __init__(self, verbose: bool = False, wall: Callable[[], datetime] = local_time) -> None:
        self._verbose = verbose
        self._wall = wall
        self._throttle: Throttle[Told] = Throttle()
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
        """Write what has happened, and what was held back, when it is due; ``now`` is that of the nodes."""
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

    def _note_held(self, ended: list[Held[Told]]) -> None:
        for held in ended:
            text = f"{held.count} more in the last {held.seconds:.3g} s; the last: {held.last[1].text}"
            more = {"more": held.count, "seconds": round(held.seconds, 3)}
            self._note(held.last, text, more)

    def _note(self, told: Told, text: str, more: Mapping[str, Any]) -> None:
        device, event = told  # whose node-ID may be another one soon
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
