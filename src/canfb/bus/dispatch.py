"""Which device gets which frame, and which is due first.

A :class:`.Selective` device says which CAN-IDs it listens to; the bus gets the union as acceptance filter, of
any NMT state. When they move, the tables follow before anything is sent: an answer may be what the master
waits for. The earliest deadline is looked for again only if its device has moved it to later (``_stale``).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from canfb.bus.frame_bus import FrameBus
from canfb.cia301.frame import Frame
from canfb.device.core import NEVER, CanIds
from canfb.device.device_protocol import Device, Inhibited, Selective

Ports = tuple["Port", ...]
_NOTHING = CanIds(frozenset(), frozenset(), frozenset(), frozenset())
_NEVER_INHIBITED: Mapping[int | None, Any] = {}


class Port:
    """A device as the runner calls it."""

    __slots__ = (
        "can_ids",
        "deadline",
        "device",
        "due_s",
        "inhibited",
        "moved",
        "number",
        "receive",
        "sent",
    )

    def __init__(self, number: int, device: Device) -> None:
        self.number = number
        self.device = device
        self.receive = device.receive
        self.deadline = device.deadline
        self.inhibited = device.inhibited if isinstance(device, Inhibited) else _NEVER_INHIBITED
        self.sent: Callable[[int, float], None] = getattr(device, "sent", lambda can_id, now: None)
        self.due_s = NEVER
        self.can_ids = _NOTHING
        self.moved = isinstance(device, Selective)


class Dispatch:
    """The devices of a runner by the CAN-IDs that they listen to, and by their deadlines.

    One that listens to other CAN-IDs is ``moved`` until :meth:`follow`, before anything is sent or received.
    """

    def __init__(self, devices: list[Device], bus: FrameBus) -> None:
        self.ports = tuple(Port(number, device) for number, device in enumerate(devices))
        self.moved = True
        self.data: dict[int, Ports] = {}
        """Who gets a data frame; ``everyone`` gets those of other CAN-IDs."""
        self.remote: dict[int, Ports] = {}
        self.everyone = tuple(port for port in self.ports if not port.moved)
        self._bus = bus
        self._accepts_all = bool(self.everyone)
        self._earliest_s = NEVER
        self._stale = True
        for port in self.ports:
            if isinstance(port.device, Selective):
                port.device.follow_can_ids(self._mover(port))

    def due_s(self) -> float:
        """The earliest deadline of all devices, NEVER for none."""
        if self._stale:
            self._stale = False
            self._earliest_s = min([port.due_s for port in self.ports], default=NEVER)
        return self._earliest_s

    def called(self, port: Port) -> None:
        """A method of this device was called."""
        deadline_s = port.deadline()
        if deadline_s is None:
            deadline_s = NEVER
        before_s = port.due_s
        if deadline_s == before_s:
            return
        port.due_s = deadline_s
        if deadline_s < self._earliest_s:
            self._earliest_s = deadline_s
        elif before_s <= self._earliest_s:
            self._stale = True

    def listeners(self, frame: Frame) -> Ports:
        """Who gets this frame."""
        return (self.remote if frame.rtr else self.data).get(frame.can_id, self.everyone)

    def follow(self) -> None:
        """Take over the CAN-IDs of the devices that have moved, and filter."""
        self.moved = False
        for port in self.ports:
            if port.moved and isinstance(port.device, Selective):
                port.moved = False
                port.can_ids = port.device.can_ids()
        self.data = self._table(lambda port: port.can_ids.data)
        self.remote = self._table(lambda port: port.can_ids.remote)
        self._set_filters()

    def accept_all(self, enabled: bool) -> None:
        """Ask the bus for all frames, or for those that are listened to."""
        enabled = enabled or bool(self.everyone)
        if enabled is not self._accepts_all:
            self._accepts_all = enabled
            self._set_filters()

    def _set_filters(self) -> None:
        if self._accepts_all:
            self._bus.accept(None, ())
            return
        data = frozenset[int]().union(*(port.can_ids.any_state for port in self.ports))
        remote = frozenset[int]().union(*(port.can_ids.any_state_remote for port in self.ports))
        self._bus.accept(data, remote)

    def _table(self, can_ids: Callable[[Port], Iterable[int]]) -> dict[int, Ports]:
        """Who gets a frame, by its CAN-ID, in the order of the devices."""
        listening = defaultdict[int, list[Port]](lambda: list(self.everyone))
        for port in self.ports:
            for can_id in can_ids(port):
                listening[can_id].append(port)
        return {
            can_id: tuple(sorted(some, key=lambda port: port.number)) for can_id, some in listening.items()
        }

    def _mover(self, port: Port) -> Callable[[], None]:
        def moved() -> None:
            port.moved = self.moved = True

        return moved
