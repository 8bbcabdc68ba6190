"""Which device gets which frame, and which is due first.

A :class:`.Selective` device says which CAN-IDs it listens to; the bus gets the union as acceptance filter, of
any NMT state. When they move, the tables follow before anything is sent: an answer may be what the master
waits for. The earliest deadline is looked for again only if its device has moved it to later (``_stale``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
        "device",
        "device_deadline",
        "device_receive",
        "device_sent",
        "due_s",
        "inhibited",
        "is_selective",
        "keeps_deadline",
        "moved",
        "number",
    )

    def __init__(self, number: int, device: Device) -> None:
        self.number = number
        self.device = device
        self.device_receive = device.receive
        self.device_deadline = device.deadline
        self.inhibited = device.inhibited if isinstance(device, Inhibited) else _NEVER_INHIBITED
        self.device_sent: Callable[[int, float], None] = getattr(device, "sent", _never_called)
        self.due_s = NEVER
        """When the device is due, as far as it is known."""
        self.is_selective = isinstance(device, Selective)
        self.keeps_deadline = False
        """Whether ``due_s`` holds until :meth:`Dispatch.called`."""
        self.can_ids = _NOTHING
        self.moved = True


class Dispatch:
    """The devices of a runner by their CAN-IDs, and by their deadlines.

    A device that is not :class:`.Selective` gets every frame; one with other CAN-IDs is ``moved`` until
    :meth:`follow`.
    """

    def __init__(self, devices: list[Device], bus: FrameBus) -> None:
        self.ports = tuple(Port(number, device) for number, device in enumerate(devices))
        self.moved = True
        """Whether :meth:`follow` is to be called, before anything is sent or received."""
        self.accepts_all = False
        """Whether the bus is asked for all frames."""
        self.data: dict[int, Ports] = {}
        """Who gets a data frame; ``everyone`` gets those of other CAN-IDs."""
        self.remote: dict[int, Ports] = {}
        self.everyone = tuple(port for port in self.ports if not port.is_selective)
        self._bus = bus
        self._asked = self.ports if len(self.ports) == 1 else self.everyone
        self._reporting = tuple(port for port in self.ports if port not in self._asked)
        self._earliest_s = NEVER
        self._stale = True
        for port in self._reporting:
            port.keeps_deadline = True
        for port in self.ports:
            if isinstance(port.device, Selective):
                port.device.follow_can_ids(self._mover(port))

    def due_s(self) -> float:
        """The earliest deadline of all devices, NEVER for none."""
        if self._stale:
            self._stale = False
            self._earliest_s = min([port.due_s for port in self._reporting], default=NEVER)
        due_s = self._earliest_s
        for port in self._asked:
            deadline_s = port.device_deadline()
            port.due_s = NEVER if deadline_s is None else deadline_s
            if port.due_s < due_s:
                due_s = port.due_s
        return due_s

    def called(self, port: Port) -> None:
        """A method of a device that keeps its deadline was called."""
        deadline_s = port.device_deadline()
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

    def ask_all(self) -> None:
        """The program may have called devices by itself."""
        for port in self._reporting:
            self.called(port)

    def listeners(self, frame: Frame) -> Ports:
        """Who gets this frame."""
        return (self.remote if frame.rtr else self.data).get(frame.can_id, self.everyone)

    def follow(self) -> None:
        """Take over the CAN-IDs of the devices that have moved, and filter."""
        self.moved = False
        for port in self.ports:
            if port.moved and isinstance(port.device, Selective):
                port.moved = False
                old, port.can_ids = port.can_ids, port.device.can_ids()
                self._change(self.data, port, old.data, port.can_ids.data)
                self._change(self.remote, port, old.remote, port.can_ids.remote)
        self._set_filters()

    def accept_all(self, enabled: bool) -> None:
        """Ask the bus for all frames, or for those that are listened to."""
        if enabled is not self.accepts_all:
            self.accepts_all = enabled
            self._set_filters()

    def _set_filters(self) -> None:
        if self.everyone or self.accepts_all:
            self._bus.accept(None, ())
            return
        data = frozenset[int]().union(*(port.can_ids.any_state for port in self.ports))
        remote = frozenset[int]().union(*(port.can_ids.any_state_remote for port in self.ports))
        self._bus.accept(data, remote)

    def _change(self, table: dict[int, Ports], port: Port, old: frozenset[int], new: frozenset[int]) -> None:
        for can_id in old - new:
            rest = tuple(other for other in table[can_id] if other is not port)
            if rest == self.everyone:
                del table[can_id]
            else:
                table[can_id] = rest
        for can_id in new - old:
            together = (*table.get(can_id, self.everyone), port)
            table[can_id] = tuple(sorted(together, key=lambda one: one.number))

    def _mover(self, port: Port) -> Callable[[], None]:
        def moved() -> None:
            port.moved = self.moved = True

        return moved


def _never_called(can_id: int, now: float) -> None:
    """For a device without inhibit times."""
