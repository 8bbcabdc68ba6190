"""The events of modules as lines of a log: each with its time, and not more than a person can read."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from datetime import datetime
from typing import Any

from canfb.bus.module_lines import title_of
from canfb.bus.throttle import Held, Throttle
from canfb.bus.wall_clock import local_time
from canfb.module.event import DETAILS, Event
from canfb.module.feedback_module import FeedbackModule

log = logging.getLogger(__name__)

Told = tuple[FeedbackModule, Event]


class EventLog:
    """Writes what happens in modules to the logger, as information; with ``verbose`` single faults, too.

    A record has the attribute `event`, a dict of plain values for programs. What a module repeats within a
    second is counted, and reported by :meth:`tick`. What happens before :meth:`begin` waits for it. ``wall``
    is the time of day, for tests.
    """

    def __init__(self, verbose: bool = False, wall: Callable[[], datetime] = local_time) -> None:
        self._verbose = verbose
        self._wall = wall
        self._throttle: Throttle[Told] = Throttle()
        self._waiting: list[tuple[str, dict[str, Any]]] | None = []

    def watch(self, module: FeedbackModule) -> None:
        """Write its events from now on."""
        module.events.detailed = self._verbose
        module.events.on_event = lambda event: self._take(module, event)

    def begin(self) -> None:
        """The modules are on the bus: write what has happened, and all that follows at once."""
        waiting, self._waiting = self._waiting or [], None
        for text, values in waiting:
            log.info("%s", text, extra={"event": values})

    def tick(self, now: float) -> None:
        """Report what was held back, when it is time to; ``now`` as the modules have it."""
        for held in self._throttle.ended(now):
            self._tell_held(held)

    def close(self, now: float) -> None:
        """Report what is held back, at the end."""
        self.begin()
        for held in self._throttle.close(now):
            self._tell_held(held)

    def _take(self, module: FeedbackModule, event: Event) -> None:
        if event.kind in DETAILS and not self._verbose:
            return
        self.tick(event.time_s)
        if self._throttle.admits((id(module), event.kind), (module, event), event.time_s):
            self._write(module, event, event.text, {})

    def _tell_held(self, held: Held[Told]) -> None:
        module, event = held.last
        text = f"{held.count} more in the last {held.seconds:.3g} s; the last: {event.text}"
        self._write(module, event, text, {"more": held.count, "seconds": round(held.seconds, 3)})

    def _write(self, module: FeedbackModule, event: Event, text: str, more: Mapping[str, Any]) -> None:
        now = self._wall()
        head = {
            "time": now.isoformat(timespec="milliseconds"),
            "event": str(event.kind),
            "node": module.node.node_id,
            "text": text,
        }
        values = {**head, **event.values, **more, "monotonic_s": event.time_s}
        time_of_day = now.replace(tzinfo=None).isoformat(" ", "milliseconds")
        line = f"{time_of_day} {title_of(module)}: {text}"
        if self._waiting is None:
            log.info("%s", line, extra={"event": values})
        else:
            self._waiting.append((line, values))
